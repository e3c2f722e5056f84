"""Kinematics of the arm: chain, limits, differential inverse kinematics and secondary tasks."""

from typing import TYPE_CHECKING

from aras_visual_servo_base.lazy_imports import lazy_exports

if TYPE_CHECKING:
    from .arm import Arm as Arm
    from .command_limits import CommandLimits as CommandLimits
    from .differential_ik import DifferentialIK as DifferentialIK
    from .differential_ik import IKSettings as IKSettings
    from .ik_solution import IKSolution as IKSolution
    from .joint_sample import JointSample as JointSample
    from .secondary_tasks import JointLimitAvoidance as JointLimitAvoidance
    from .secondary_tasks import PostureTask as PostureTask
    from .secondary_tasks import SecondaryTask as SecondaryTask
    from .secondary_tasks import SingularityAvoidance as SingularityAvoidance

_PLACES = {
    "Arm": ".arm",
    "JointSample": ".joint_sample",
    "CommandLimits": ".command_limits",
    "IKSolution": ".ik_solution",
    **dict.fromkeys(("DifferentialIK", "IKSettings"), ".differential_ik"),
    **dict.fromkeys(("JointLimitAvoidance", "PostureTask", "SecondaryTask", "SingularityAvoidance"),
                    ".secondary_tasks"),
}  # fmt: skip
__all__ = sorted(_PLACES)
# Type checkers must not see __getattr__: they accept any name of a module that has it.
if not TYPE_CHECKING:
    __getattr__, __dir__ = lazy_exports(__name__, _PLACES)
