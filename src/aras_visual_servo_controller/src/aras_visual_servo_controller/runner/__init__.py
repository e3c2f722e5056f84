"""Execution of the loop: stamped joint states and images are processed, and commands are sent."""
