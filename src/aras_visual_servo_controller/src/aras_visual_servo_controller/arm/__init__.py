"""The arm: kinematics of any chain from its description, limits, resolver, secondary tasks."""

from typing import TYPE_CHECKING

from aras_visual_servo_base.lazy import lazy_exports

if TYPE_CHECKING:
    from .arm import Arm as Arm
    from .joint_sample import JointSample as JointSample
    from .limits import Limits as Limits
    from .resolution import Resolution as Resolution
    from .resolver import Resolver as Resolver
    from .resolver import ResolverSettings as ResolverSettings
    from .secondary import JointLimitAvoidance as JointLimitAvoidance
    from .secondary import Posture as Posture
    from .secondary import SecondaryTask as SecondaryTask
    from .secondary import SingularityAvoidance as SingularityAvoidance

_PLACES = {
    "Arm": ".arm",
    "JointSample": ".joint_sample",
    "Limits": ".limits",
    "Resolution": ".resolution",
    **dict.fromkeys(("Resolver", "ResolverSettings"), ".resolver"),
    **dict.fromkeys(("JointLimitAvoidance", "Posture", "SecondaryTask", "SingularityAvoidance"),
                    ".secondary"),
}  # fmt: skip
__all__ = sorted(_PLACES)
if not TYPE_CHECKING:  # a type checker would take any name for one that there is
    __getattr__, __dir__ = lazy_exports(__name__, _PLACES)
