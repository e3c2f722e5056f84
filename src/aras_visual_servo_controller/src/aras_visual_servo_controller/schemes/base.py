"""Base classes of schemes and joint controllers, and their output for one image."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from aras_visual_servo_base.registry import Registry

from ..errors import ConfigurationError
from ..features.base import FEATURES, Feature
from ..goals.goal import Goal
from ..kinematics.joint_sample import JointSample
from ..kinematics.task import Task
from ..laws import Law
from ..laws.proportional import Proportional
from ..observation.observation import Need, Observation

if TYPE_CHECKING:
    from ..kinematics import Arm


@dataclass(eq=False)
class SchemeOutput:
    """Output of a scheme or joint controller for one image; k is the number of components.

    A `Scheme` returns a task, L v = e_dot, from which the joint velocities are computed. A
    `JointController` returns no task. The other fields are published and used for diagnosis.

    Attributes:
        names: names of the k components.
        features, desired: (k,) s and s*.
        error: (k,) measured error s - s*, with wrapped angles. It is published and compared with
            the tolerances.
        task: desired motion of the camera; None for a JointController.
        L: (k, 6) interaction matrix that the law uses, for the record; None if there is none.
        residual: (m,) full error, for example of all pixels, if `error` is only a summary of it; L
            is then (m, 6). None if `error` is the full error.
        error_drift: (k,) rate of change of the error that is not caused by the camera, for example
            by a moving target; in units of the features per second.
        filtered_error: (k,) low-pass filtered error that the law uses; None without a filter.
        ambiguity: camera rotation that the error cannot show, as text ('180°'); empty if there is
            none.
        notes: texts that are added to the state of the loop.
    """

    names: tuple[str, ...]
    features: np.ndarray
    desired: np.ndarray
    error: np.ndarray
    task: Task | None = None
    L: np.ndarray | None = None
    residual: np.ndarray | None = None
    error_drift: np.ndarray | float = 0.0
    filtered_error: np.ndarray | None = None
    ambiguity: str = ""
    notes: tuple[str, ...] = field(default=())


class SchemeBase(ABC):
    """Common base of schemes and joint controllers.

    Attributes (of the class or of the instance):
        needs: quantities that have to be measured in the image.
        cameras: names of the cameras whose images it uses; '' or an empty tuple denotes the control
            camera.
        names, units: (k,) name and unit of each component of the error.
        tolerances: (k,) tolerance of each component of the error; a component has converged if its
            absolute value is below its tolerance.
    """

    needs: frozenset[Need] = frozenset((Need.MOMENTS,))
    cameras: tuple[str, ...] = ()
    names: tuple[str, ...]
    tolerances: Sequence[float]
    units: Sequence[str] = ()

    def check(self, goal: Goal) -> None:
        """Raise an error for a goal that this scheme cannot servo to.

        The method is called before the arm moves.

        Raises:
            ConfigurationError: the goal lacks data; the message names them.
        """

    def get_needs(self, *cameras: str) -> frozenset[Need]:
        """Return the measurements that the scheme needs from one camera's image.

        The name '' denotes the control camera.
        """
        return self.needs

    def accuracy(self, observation: Observation, goal: Goal) -> np.ndarray | None:
        """Return the accuracy of the features in the latest image; see Feature.accuracy."""
        return None

    def teach(self, observation: Observation) -> Mapping[str, Mapping[str, Any]]:
        """Return the data that the goal file stores for each feature, from the view at the goal."""
        return {}


class Scheme(SchemeBase):
    """Base class of schemes, including user-defined ones, constructed as `YourScheme(law)`.

    A scheme maps an observation to a task of the camera, L v = e_dot, with v in the camera's
    optical frame (m/s, rad/s). Most schemes are one `Feature` with a law. They need no class of
    their own, only the name of the feature. Derive from `Scheme` if the twist does not follow from
    e and L alone, as in partitioned or predictive control.

    A subclass implements `compute`.

    Attributes (of the class or of the instance), in addition to those of SchemeBase:
        law: control law; its gains can be changed while the loop runs.
        can_check_camera: whether the camera calibration can be checked by comparing the measured
            rate of the error with L v.
    """

    can_check_camera: bool = True

    def __init__(self, law: Law | None = None) -> None:
        self.law = law if law is not None else Proportional()

    @abstractmethod
    def compute(self, observation: Observation, goal: Goal, t: float) -> SchemeOutput:
        """Compute the features of an image and the task that follows from them.

        Args:
            observation: measurements of the image. It is not `valid` if the segmentation found no
                target.
            goal: goal with its desired features.
            t: time since servoing started, or restarted after the target was lost, s.

        Returns:
            The output, with a task.

        Raises:
            MeasurementError: this image cannot be used for control; the arm stays where it is.
        """

    def reset(self) -> None:
        """Forget all earlier images."""
        self.law.reset()


class JointController(SchemeBase):
    """Base class of controllers that compute joint commands themselves, such as MPC.

    `process_image` is called for each image. `update` is called for each joint state and returns
    positions, velocities or accelerations of the n joints in the order of `arm.names`. The
    position, speed and acceleration limits and the watchdog apply as for schemes.

    A subclass implements `process_image` and `update`, and is constructed without arguments.
    `self.arm` is set by `reset` before the first image.

    Attributes (of the class or of the instance), in addition to those of SchemeBase:
        output: quantity that `update` returns: 'position' (rad, m), 'velocity' or 'acceleration'.
    """

    output: str = "velocity"

    @abstractmethod
    def process_image(self, observation: Observation, goal: Goal, t: float) -> SchemeOutput:
        """Process one image.

        Args:
            observation: measurements of the image.
            goal: goal with its desired features.
            t: time since servoing started, or restarted after the target was lost, s.

        Returns:
            The output, without a task; it is published and used for diagnosis.

        Raises:
            MeasurementError: this image cannot be used for control; the arm stays where it is.
        """

    @abstractmethod
    def update(self, t: float, dt: float, joints: JointSample) -> np.ndarray:
        """Compute the positions, velocities or accelerations (n,) of the joints.

        Args:
            t: time since servoing started, s.
            dt: time since the previous call, s.
            joints: measured joint positions (rad or m) and velocities (rad/s or m/s).

        Returns:
            An array (n,) of the quantity that `output` names: positions (rad or m), velocities
            (rad/s or m/s) or accelerations (rad/s² or m/s²).
        """

    def reset(self, arm: Arm) -> None:
        """Restart with this arm and forget all images."""
        self.arm = arm


# The name of a feature also denotes the scheme that consists of this feature alone.
SCHEMES = Registry(
    "scheme", __package__, (Scheme, JointController, Feature), ConfigurationError, (FEATURES,)
)
