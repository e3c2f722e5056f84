"""Schemes and features with neural networks that are trained on simulated data."""
