"""Schemes that are learned from simulated data."""
