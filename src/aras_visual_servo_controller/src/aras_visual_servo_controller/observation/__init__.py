"""Observations: what is known of each image, its joint states, and the target's geometry."""
