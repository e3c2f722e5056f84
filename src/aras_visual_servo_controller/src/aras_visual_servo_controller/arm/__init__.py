"""The arm: kinematics of any chain from its description, limits, resolver, secondary tasks."""

from .arm import Arm
from .joint_sample import JointSample
from .limits import Limits
from .resolution import Resolution
from .resolver import Resolver, ResolverSettings
from .secondary import JointLimitAvoidance, Posture, SecondaryTask, SingularityAvoidance

__all__ = [
    "Arm",
    "JointLimitAvoidance",
    "JointSample",
    "Limits",
    "Posture",
    "Resolution",
    "Resolver",
    "ResolverSettings",
    "SecondaryTask",
    "SingularityAvoidance",
]
