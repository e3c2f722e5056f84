"""Figures: one style, curves, views, and those of studies."""
