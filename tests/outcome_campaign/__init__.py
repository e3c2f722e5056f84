"""Outcome campaign: runs with injected faults, compared with the outcomes of the loop."""
