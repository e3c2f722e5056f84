"""The physics world. Only this package calls the dynamics of Bullet."""

from aras_visual_servo_base.lazy_imports import lazy_exports

_PLACES = {
    "GraspFix": ".grasping", "Model": ".model", "World": ".world",
    **dict.fromkeys(("Pose", "Twist"), "aras_visual_servo_base.poses"),
}  # fmt: skip
__all__ = sorted(_PLACES)
__getattr__, __dir__ = lazy_exports(__name__, _PLACES)
