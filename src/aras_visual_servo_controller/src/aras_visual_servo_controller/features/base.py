"""Base class of visual features: s, s*, their difference, and the interaction matrix."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
import scipy

from aras_visual_servo_base.registry import Registry
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.undistortion import CameraModel

from ..errors import ConfigurationError, MeasurementError
from ..goals.goal import Goal
from ..kinematics.task import ALL_DIRECTIONS
from ..observation.observation import Need, Observation

# rad: the rounding of a turn by pi; a turn that is so much short of -pi counts as one by +pi.
HALF_TURN_TOLERANCE = 1e-6
NEAR_HALF = 0.375  # part of the period from which on angles count as near half a turn


class DepthFraction(float):
    """A tolerance of a length, as a part of the target's depth at the goal."""


def scale_tolerances(tolerances: Sequence[float], goal: Goal) -> tuple[float, ...]:
    """Tolerances (k,) at this goal: lengths in m."""
    return tuple(
        float(t) * goal.distance if isinstance(t, DepthFraction) else float(t) for t in tolerances
    )


@dataclass(frozen=True, eq=False)
class FeatureMeasurement:
    """The value of a feature in one image: s, s*, their difference, and the interaction matrix.

    With the twist v = (vx, vy, vz, wx, wy, wz) of the camera in its own optical frame (m/s, rad/s),
    ds/dt = L v for a target at rest, and d(s - s*)/dt = L v + rate otherwise.

    Source: F. Chaumette and S. Hutchinson, Visual servo control, part I, IEEE Robotics and
    Automation Magazine 13(4), 2006.

    Attributes:
        s, desired: (k,) measured and desired values, s and s*.
        error: (k,) s - s*; differences of angles are wrapped.
        L: (k, 6) interaction matrix at the current view, with all six columns.
        rate: (k,) part of d(s - s*)/dt that the camera does not cause, 1/s times the unit of s: a
            moving target or goal.
        up_to: camera motion that the error cannot show, as text ('180°'); empty if there is none.
        judged: (m,) what is published and judged instead of the error of a whole image, one number
            for each name of the feature; None: the error itself.
        notes: texts for the state of the loop.
    """

    s: np.ndarray
    desired: np.ndarray
    error: np.ndarray
    L: np.ndarray
    error_drift: np.ndarray | float = 0.0
    ambiguity: str = ""
    error_summary: np.ndarray | None = None
    notes: tuple[str, ...] = field(default=())


class Feature(ABC):
    """A visual feature s: what is compared with its value s* at the goal. Base class of all.

    A feature has k components, such as the normalised coordinates of four points, k = 8. It knows
    s, s* and its interaction matrix L (k, 6) with ds/dt = L v; control law, joint limits and
    singularities are not its concern. `check_interaction_matrix` compares L with finite
    differences.

    A subclass implements `measure`. It is constructed without arguments, and its name as a scheme
    is 'package.module:Class'.

    Attributes (of the class or of the instance):
        name: key under which goal files hold what the feature taught.
        needs: what has to be measured in the image.
        cameras: names of the cameras that it reads; none: the first one, the control camera, alone.
        reads: number of cameras, if the scheme names them.
        names, tolerances, units: (k,) of the components; |error| below the tolerance counts as
            reached. A DepthFraction among the tolerances is a part of the target's depth.
        directions: (6,) bool, camera directions vx ... wz that it controls; the others are held.
        weights: (k,) of the components in the least squares; None: all equal.
        geometric: whether s follows from the image positions of the target's points. The output of
            a network does not, so that a deviation from L says nothing about the camera.
        stackable: whether it can be a part of a Stack. False if it is judged by other numbers than
            those that the law gets (FeatureMeasurement.judged).
    """

    name: ClassVar[str] = ""
    is_geometric: bool = True
    is_stackable: bool = True
    camera_count: ClassVar[int] = 1
    needs: frozenset[Need] = frozenset((Need.MOMENTS,))
    cameras: tuple[str, ...] = ()
    names: tuple[str, ...]
    tolerances: Sequence[float]
    units: Sequence[str] = ()
    directions: Sequence[bool] = ALL_DIRECTIONS
    weights: np.ndarray | None = None

    def __init_subclass__(cls, **options: Any) -> None:
        """A feature without a name is called as its class."""
        super().__init_subclass__(**options)
        if not cls.name or cls.name == cls.__base__.__name__:
            cls.name = cls.__name__

    @abstractmethod
    def measure(self, observation: Observation, goal: Goal) -> FeatureMeasurement:
        """Measure the feature in one image.

        Args:
            observation: what is known of the image: what `needs` asks for, camera, joints, pose.
            goal: what the camera sees at its goal.

        Raises:
            MeasurementError: it cannot be measured in this observation; the arm holds still.
        """

    def get_needs(self, *cameras: str) -> frozenset[Need]:
        """Of the image of the camera with these names; '' is a name of the control camera."""
        return self.needs

    def desired_interaction(self, goal: Goal) -> np.ndarray:
        """L (k, 6) at the goal, for laws with the desired or the mean interaction matrix.

        Raises:
            ConfigurationError: the feature knows none.
        """
        raise ConfigurationError(
            f"{type(self).__name__} has no interaction matrix at the goal: use "
            "interaction 'current', or give it desired_interaction(goal)"
        )

    def accuracy(self, observation: Observation, goal: Goal) -> np.ndarray | float | None:
        """How exactly s is measured in the image that was measured last.

        A direction of the camera is servoed where this tells it better than UNCERTAIN (arm/task),
        and it bounds how far from its goal a camera that has arrived may be.

        Returns:
            (k, m): the effects on s of m independent errors, one standard deviation each; or one
            standard deviation of all components, independent of each other; None where s is exact.
        """
        return None

    def check(self, goal: Goal) -> None:
        """Refuse a goal that this feature cannot servo to, before anything moves.

        Raises:
            ConfigurationError: what the goal lacks; here, what `teach` would have kept.
        """
        if type(self).teach is not Feature.teach and self.name not in goal.features:
            raise ConfigurationError(
                f"{goal.name} holds nothing of the feature '{self.name}': teach it (rosrun "
                "aras_visual_servo_controller teach --scheme ...)"
            )

    def teach(self, observation: Observation) -> Mapping[str, Any]:
        """What to keep of the view at the goal; plain numbers, lists and strings for YAML.

        It comes back as `goal.features[name]`. Moments, kernel features, joints, camera and pose
        are kept for all, without being asked for.
        """
        return {}

    def reset(self) -> None:
        """Forget earlier images."""


FEATURES = Registry("feature", __package__, (Feature,), ConfigurationError)
FEATURES.__doc__ = "All built-in features by name; `create(name)` makes one."


class Stack(Feature):
    """Several features as one: s, s*, e and L are stacked, each feature with its weight.

    Attributes:
        features: the parts, in order.
    """

    def __init__(self, features: Sequence[Feature], weights: Sequence[float] | None = None) -> None:
        """`weights`: one a feature, >= 0.

        Raises:
            ConfigurationError: no feature, one that cannot be stacked, or as many weights as
                features are needed.
        """
        self.features = tuple(features)
        if not self.features:
            raise ConfigurationError("a stack of features needs at least one")
        for feature in self.features:
            _check_stackable(feature, feature.is_stackable)
        weights = [1.0] * len(self.features) if weights is None else list(weights)
        if len(weights) != len(self.features) or not all(
            isinstance(w, int | float | np.number) and np.isfinite(w) and w >= 0.0 for w in weights
        ):
            raise ConfigurationError(
                f"weights {weights}: one number >= 0 for each of {len(self.features)} features"
            )
        if not any(weights):
            raise ConfigurationError(f"weights {weights}: one at least has to be above 0")
        self.needs = frozenset().union(*(f.needs for f in self.features))
        read = [name for f in self.features for name in f.cameras or ("",)]
        self.cameras = () if not any(read) else tuple(dict.fromkeys(read))
        self.is_geometric = all(f.is_geometric for f in self.features)
        self._parts = tuple(weights)
        self._combine_descriptions()

    def _combine_descriptions(self) -> None:
        """Put the parts' descriptions together; a part may learn its size from the goal."""
        self.names = tuple(n for f in self.features for n in f.names)
        self.tolerances = tuple(t for f in self.features for t in f.tolerances)
        self.units = tuple(u for f in self.features for u in f.units or [""] * len(f.names))
        self.directions = tuple(np.any([f.directions for f in self.features], axis=0).tolist())
        self.weights = np.concatenate([
            w * (np.ones(len(f.names)) if f.weights is None else np.asarray(f.weights, float))
            for f, w in zip(self.features, self._parts, strict=True)
        ])

    def get_needs(self, *cameras: str) -> frozenset[Need]:
        """Return what the feature needs of one camera's image."""
        return frozenset().union(*(
            f.get_needs(*cameras) for f in self.features
            if not {*cameras}.isdisjoint(f.cameras or ("",))
        ))  # fmt: skip

    def measure(self, observation: Observation, goal: Goal) -> FeatureMeasurement:
        """See Feature.measure; the parts one under the other."""
        parts = [f.measure(observation, goal) for f in self.features]
        for feature, part in zip(self.features, parts, strict=True):
            _check_stackable(feature, part.error_summary is None)
        rates = [np.broadcast_to(p.error_drift, np.shape(p.s)) for p in parts]
        # One part that sees the whole motion is enough.
        blind = {p.ambiguity for p in parts}
        return FeatureMeasurement(
            s=np.concatenate([p.s for p in parts]),
            desired=np.concatenate([p.desired for p in parts]),
            error=np.concatenate([p.error for p in parts]),
            L=np.vstack([p.L for p in parts]),
            error_drift=np.concatenate(rates),
            ambiguity="" if "" in blind else ", ".join(sorted(blind)),
            notes=tuple(note for p in parts for note in p.notes),
        )

    def desired_interaction(self, goal: Goal) -> np.ndarray:
        """Return the interaction matrix L (k, 6) at the goal."""
        return np.vstack([f.desired_interaction(goal) for f in self.features])

    def accuracy(self, observation: Observation, goal: Goal) -> np.ndarray | float | None:
        """See Feature.accuracy; errors of one part are none of another's."""
        parts = [f.accuracy(observation, goal) for f in self.features]
        if all(part is None for part in parts):
            return None
        return scipy.linalg.block_diag(*(
            np.zeros((len(f.names), 0)) if part is None else
            part * np.eye(len(f.names)) if np.ndim(part) == 0 else part
            for f, part in zip(self.features, parts, strict=True)
        ))  # fmt: skip

    def check(self, goal: Goal) -> None:
        """Refuse a goal that this feature cannot servo to."""
        for feature in self.features:
            feature.check(goal)
        self._combine_descriptions()

    def reset(self) -> None:
        """Forget earlier images."""
        for feature in self.features:
            feature.reset()


def _check_stackable(feature: Feature, stackable: bool) -> None:
    if not stackable:
        name = feature.name or type(feature).__name__
        raise ConfigurationError(
            f"{name} is judged by other numbers than those the law gets and cannot be stacked: "
            "use it alone, without weights"
        )


def get_plane(observation: Observation) -> Plane:
    """The target's plane in this view.

    Raises:
        MeasurementError: nothing tells it.
    """
    if observation.plane is not None:
        return observation.plane
    if observation.depth is not None:
        raise MeasurementError("the depth image knows no depth at the target")
    raise MeasurementError(
        "nothing tells the target's plane in this view: it is worked out from the goal's depth and "
        "the camera's pose"
    )


def compare_cameras(width: int, height: int, K: np.ndarray, camera: CameraModel) -> str:
    """How a camera differs from one of this size (pixels) and K (3, 3), in words; empty where it is
    the same one."""
    here = np.reshape(camera.K, (3, 3))
    size = (camera.width, camera.height)
    if size == (width, height) and np.allclose(here, K, rtol=1e-3, atol=0.6):
        return ""
    return (
        f"{width}x{height}, fx {K[0, 0]:.2f}; this one is {size[0]}x{size[1]}, fx {here[0, 0]:.2f}"
    )


def wrap(angle: np.ndarray | float, period: float = 2.0 * np.pi) -> np.ndarray | float:
    """The angle (rad) modulo the period, in [-period/2, period/2)."""
    return (angle + 0.5 * period) % period - 0.5 * period


def wrap_together(is_angle: np.ndarray, period: float = 2.0 * np.pi) -> np.ndarray:
    """Angles (k,) modulo the period; near half a turn all within half a period of their common one.

    There rounding would send some of them one way round and some the other, and what they ask for
    together would be no turn at all. Their common angle is that of the sum of their unit vectors;
    where it is half a turn to rounding, it is taken as +.
    """
    unit = np.exp(2j * np.pi / period * is_angle).sum(axis=0)
    common = float(np.angle(unit)) * period / (2.0 * np.pi)
    if abs(common) < NEAR_HALF * period:
        return wrap(is_angle, period)
    if common < HALF_TURN_TOLERANCE - 0.5 * period:
        common += period
    return common + wrap(is_angle - common, period)
