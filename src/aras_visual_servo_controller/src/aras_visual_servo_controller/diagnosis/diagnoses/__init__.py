"""Diagnoses of a run, one class per file; `base.ORDER` defines their order."""
