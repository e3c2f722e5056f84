"""Observations from images and joint states: pairing by stamps, and the target's geometry."""
