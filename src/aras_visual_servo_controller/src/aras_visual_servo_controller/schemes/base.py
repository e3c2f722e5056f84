"""Base classes of schemes and joint controllers, and their answer to an image."""

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


@dataclass(frozen=True, eq=False)
class SchemeOutput:
    """Answer to one image; k is the number of features.

    A `Scheme` answers with a task, L v = e_dot, from which the joint velocities are computed; a
    `JointController` answers without one. The rest is published and diagnosed.

    Attributes:
        names: of the features.
        features, desired: (k,) s and s*.
        error: (k,) s - s* as measured, angles wrapped: what is published and judged.
        task: what the camera shall do; None for a controller that answers joints itself.
        L: (k, 6) as used by the law, for the record; None where there is none.
        residual: (m,) what L, then (m, 6), belongs to where `error` is a summary of it, as of a
            whole image; None: the error itself.
        rate: (k,) of the error that is not the camera's doing, as a target that moves; 1/s.
        filtered_error: (k,) error that the law gets, if it is filtered; None: as measured.
        up_to: camera motion that the error cannot show, as text ('180°'); empty if there is none.
        notes: texts for the state of the loop.
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
    """What schemes and joint controllers have in common.

    Attributes (of the class or of the instance):
        needs: of the image.
        cameras: names of those that it reads; none, or '': the first, the control camera.
        names, tolerances, units: (k,) of the features; |error| below it counts as reached.
    """

    needs: frozenset[Need] = frozenset((Need.MOMENTS,))
    cameras: tuple[str, ...] = ()
    names: tuple[str, ...]
    tolerances: Sequence[float]
    units: Sequence[str] = ()

    def check(self, goal: Goal) -> None:
        """Refuse a goal that this one cannot servo to, before anything moves.

        Raises:
            ConfigurationError: what the goal lacks.
        """

    def get_needs(self, *cameras: str) -> frozenset[Need]:
        """Of the image of the camera with these names: see Feature.needs_of."""
        return self.needs

    def accuracy(self, observation: Observation, goal: Goal) -> np.ndarray | None:
        """How well the features of this image, the last one, are measured: see Feature.accuracy."""
        return None

    def teach(self, observation: Observation) -> Mapping[str, Mapping[str, Any]]:
        """What to keep of the view at the goal, by feature's name: see Feature.teach."""
        return {}


class Scheme(SchemeBase):
    """Base of all schemes, also of a user's own: constructed as `YourScheme(law)`.

    A scheme maps an observation to a task of the camera, L v = e_dot, with v in the camera's
    optical frame (m/s, rad/s). Most schemes are one `Feature` with a law and need no class of their
    own: the name of the feature's class is enough. Derive from `Scheme` where the twist does not
    follow from e and L alone, as in partitioned or predictive control.

    A subclass implements `compute`.

    Attributes (of the class or of the instance), besides those of SchemeBase:
        law: as given; `gains` of it may be changed while it runs.
        judges_camera: whether the errors have to move as L says if the camera is as believed.
    """

    can_check_camera: bool = True

    def __init__(self, law: Law | None = None) -> None:
        self.law = law if law is not None else Proportional()

    @abstractmethod
    def compute(self, observation: Observation, goal: Goal, t: float) -> SchemeOutput:
        """Compute the features of an image and the task that follows from them.

        Args:
            observation: what is known of the image; not `valid` where the segmentation found no
                target.
            goal: what the camera sees at its goal.
            t: time since servoing started, or restarted after the target was lost, s.

        Returns:
            The decision, with a task.

        Raises:
            MeasurementError: this image cannot be servoed on; the arm holds still.
        """

    def reset(self) -> None:
        """Forget earlier images."""
        self.law.reset()


class JointController(SchemeBase):
    """A controller that answers the joints itself: MPC, second order. Constructed as `Yours()`.

    `process_image` takes in an image, and `update` returns positions, velocities or accelerations
    of the n joints, in the order of `arm.names`, at every joint state between images. Limits of
    position,
    speed and acceleration and the watchdog apply as to any scheme.

    A subclass implements `process_image` and `update`. `self.arm` is set by `reset` before the
    first image.

    Attributes (of the class or of the instance), besides those of SchemeBase:
        output: what `update` answers: 'position' (rad, m), 'velocity' or 'acceleration'.
    """

    output: str = "velocity"

    @abstractmethod
    def process_image(self, observation: Observation, goal: Goal, t: float) -> SchemeOutput:
        """Take in one image.

        Args:
            observation: what is known of the image.
            goal: what the camera sees at its goal.
            t: time since servoing started, or restarted after the target was lost, s.

        Returns:
            The decision, without a task; it is published and diagnosed.

        Raises:
            MeasurementError: this image cannot be servoed on; the arm holds still.
        """

    @abstractmethod
    def update(self, t: float, dt: float, joints: JointSample) -> np.ndarray:
        """Compute the positions, velocities or accelerations (n,) of the joints from now on.

        Args:
            t: time since servoing started, s.
            dt: time since the previous tick, s.
            joints: as measured, rad or m.

        Returns:
            What `output` says: rad or m, per s, or per s².
        """

    def reset(self, arm: Arm) -> None:
        """Start again with this arm, without any image."""
        self.arm = arm


# The name of a feature is also that of the scheme of this feature alone.
SCHEMES = Registry(
    "scheme", __package__, (Scheme, JointController, Feature), ConfigurationError, (FEATURES,)
)
