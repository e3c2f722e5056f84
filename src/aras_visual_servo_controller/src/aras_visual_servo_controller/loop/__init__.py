"""Servo loop: from an observation to joint commands."""
