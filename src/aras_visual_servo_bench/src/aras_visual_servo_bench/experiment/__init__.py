"""Settings of an experiment: plant, robot, cameras, target, start, goal and control loop."""
