"""The order in which an image is diagnosed; the first outcome counts."""

ORDER = (
    "scheme_failed",
    "stopped",
    "camera_retreat",
    "joints_do_not_follow",
    "target_lost",
    "wrong_object",
    "features_contradict",
    "target_moves",
    "wrong_camera_model",
    "converged",
    "not_converging",
)
