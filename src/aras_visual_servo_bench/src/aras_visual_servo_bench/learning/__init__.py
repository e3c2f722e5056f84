"""Schemes and features that are learned from simulated data."""
