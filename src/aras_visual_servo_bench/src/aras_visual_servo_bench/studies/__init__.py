"""Studies: an experiment, what is varied of it, and how its runs are carried out and kept."""
