"""Diagnoses of a run, grouped by what they find; `base.ORDER` defines their order."""
