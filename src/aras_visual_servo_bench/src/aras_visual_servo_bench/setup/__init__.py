"""From an experiment to what is run: plant, goal and loop."""
