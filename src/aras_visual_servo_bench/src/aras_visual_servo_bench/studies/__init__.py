"""Studies: many runs of an experiment with varied settings, and their results."""
