"""Comparisons of the simulator with Pinocchio, MuJoCo, OpenCV, SciPy and closed forms."""
