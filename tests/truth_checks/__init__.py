"""What `tests/truth` compares: ours against Pinocchio, MuJoCo, OpenCV, SciPy and closed forms."""
