"""Figures of runs and studies: style, time plots, views and study figures."""
