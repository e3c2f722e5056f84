"""The simulator's process: node, simulation thread, clock, pacing, publishers and services."""
