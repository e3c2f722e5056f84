"""Quantities of a run: metrics, statistics, summaries."""
