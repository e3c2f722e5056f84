"""Studies: many runs of an experiment with different settings, and their results."""
