"""The node as a process: its thread, clock, pace, and the graph it lives on."""
