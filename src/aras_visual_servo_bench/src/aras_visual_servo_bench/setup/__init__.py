"""Build the parts of a run from an experiment: plant, goal and control loop."""
