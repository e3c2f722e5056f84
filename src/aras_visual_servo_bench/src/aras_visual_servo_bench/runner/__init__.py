"""Run an experiment: the closed control loop, and a Gymnasium environment."""
