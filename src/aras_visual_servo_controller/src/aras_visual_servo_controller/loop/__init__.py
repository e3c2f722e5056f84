"""Servo loop: from an observation to the joint commands of every tick."""
