"""Control laws: how fast each error should shrink."""

from aras_visual_servo_base.lazy import lazy_exports

_PLACES = {
    **dict.fromkeys(("LAWS", "create_law"), ".registry"),
    **dict.fromkeys(("Adaptive", "Diagonal", "Proportional"), ".proportional"),
    **dict.fromkeys(("ContinuousStart", "Ramp"), ".wrappers"),
    **dict.fromkeys(("ProportionalIntegral", "SlidingMode"), ".dynamic"),
    "Law": ".base",
}
__all__ = sorted(_PLACES)
__getattr__ = lazy_exports(__name__, _PLACES)
