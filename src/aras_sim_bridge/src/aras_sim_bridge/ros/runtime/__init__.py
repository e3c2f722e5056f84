"""Node, simulation thread, clock, pacing, publishers and services of the simulator."""
