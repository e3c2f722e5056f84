"""The arm: kinematics of any chain from its description, limits, resolver, secondary tasks."""

from ..joint_sample import JointSample
from .arm import Arm

__all__ = ["Arm", "JointSample"]
