"""Base class of visual features: s, s*, their difference, and the interaction matrix."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
import scipy

from aras_visual_servo_base.registry import Registry
from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_camera.interaction import Plane

from ..errors import ConfigurationError, MeasurementError
from ..goals.goal import Goal
from ..kinematics.task import ALL_DIRECTIONS
from ..observation.observation import Need, Observation

# Rounding error of a rotation by pi, rad. An angle this close to -pi is treated as +pi.
HALF_TURN_TOLERANCE = 1e-6
NEAR_HALF = 0.375  # an angle above this fraction of its period is close to half a turn


class DepthRelativeTolerance(float):
    """A tolerance for a length, as a fraction of the target's depth at the goal."""


def scale_tolerances(tolerances: Sequence[float], goal: Goal) -> tuple[float, ...]:
    """Return the tolerances (k,) for this goal; a DepthRelativeTolerance is converted to m."""
    return tuple(
        float(t) * goal.distance if isinstance(t, DepthRelativeTolerance) else float(t)
        for t in tolerances
    )


@dataclass(eq=False)
class FeatureMeasurement:
    """Measurement of a feature in one image: s, s*, their difference, and the interaction matrix.

    With the twist v = (vx, vy, vz, wx, wy, wz) of the camera in its own optical frame (m/s, rad/s),
    ds/dt = L v for a target at rest, and d(s - s*)/dt = L v + error_drift otherwise.

    Source: F. Chaumette and S. Hutchinson, Visual servo control, part I, IEEE Robotics and
    Automation Magazine 13(4), 2006.

    Attributes:
        s, desired: (k,) measured and desired values, s and s*.
        error: (k,) s - s*; differences of angles are wrapped.
        L: (k, 6) interaction matrix at the current view, with all six columns.
        error_drift: (k,) part of d(s - s*)/dt that the camera does not cause, for example the
            effect of a moving target or goal, in units of s per second.
        ambiguity: camera rotation that the error cannot show, as text ('180°'); empty if there is
            none.
        error_summary: (m,) values that are published and compared with the tolerances instead of
            the error, one for each of the feature's `names`. An example is the root mean square
            over all pixels of an image. None if the error itself is used.
        notes: texts that are added to the state of the loop.
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
    """Base class of visual features s, which are compared with their values s* at the goal.

    A feature has k components, such as the normalised coordinates of four points, k = 8. It
    computes s, s* and its interaction matrix L (k, 6) with ds/dt = L v. Control law, joint limits
    and singularities are handled by other classes. `check_interaction_matrix` compares L with
    finite differences.

    A subclass implements `measure` and is constructed without arguments. To use it as a scheme,
    give the name 'package.module:Class'.

    Attributes (of the class or of the instance):
        name: key of the feature's taught data in goal files.
        needs: measurements of the image that the feature needs.
        cameras: names of the cameras whose images the feature uses; empty for only the control
            camera.
        camera_count: number of cameras that the user has to name for this feature in the scheme.
        names, units: (k,) name and unit of each component.
        tolerances: (k,) tolerance of each component, which has converged if |error| is below it. A
            DepthRelativeTolerance is a tolerance relative to the target's depth.
        directions: (6,) whether the feature controls each of the camera directions vx ... wz. The
            arm's kinematics hold the others constant.
        weights: (k,) weight of each component in the least squares; None if all are equal.
        is_geometric: whether s is computed from image positions of the target's points. If such a
            feature does not move as L predicts, the camera model is wrong. False for the output of
            a network.
        is_stackable: whether the feature can be combined with others in a Stack. False if its
            measurements have an `error_summary`.
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
        """Set `name` to the name of the class, unless the subclass defines another name."""
        super().__init_subclass__(**options)
        if not cls.name or cls.name == cls.__base__.__name__:
            cls.name = cls.__name__

    @abstractmethod
    def measure(self, observation: Observation, goal: Goal) -> FeatureMeasurement:
        """Measure the feature in one image.

        Args:
            observation: measurements of the image, as listed in `needs`, with camera, joints and
                pose.
            goal: goal with its desired features.

        Raises:
            MeasurementError: the feature cannot be measured in this image; the arm stays where it
                is.
        """

    def get_needs(self, *cameras: str) -> frozenset[Need]:
        """Return the measurements that the feature needs from the image of one camera.

        Args:
            cameras: all names of this camera; the control camera is also named ''.
        """
        return self.needs

    def desired_interaction(self, goal: Goal) -> np.ndarray:
        """Return L (k, 6) at the goal, for the desired and the mean interaction matrix.

        Raises:
            ConfigurationError: the feature cannot compute L at the goal.
        """
        raise ConfigurationError(
            f"{type(self).__name__} has no interaction matrix at the goal: use "
            "interaction 'current', or implement its method desired_interaction(goal)"
        )

    def accuracy(self, observation: Observation, goal: Goal) -> np.ndarray | float | None:
        """Return the accuracy of s in the last image.

        Camera directions that s determines too inaccurately are not servoed (`Task.uncertainty`).
        The accuracy also bounds the distance of a converged camera from its goal.

        Returns:
            An array (k, m) with the effects on s of m independent errors of one standard deviation
            each; or one number, the standard deviation of all components if they are independent;
            or None if s is exact.
        """
        return None

    def check(self, goal: Goal) -> None:
        """Raise an error for a goal that this feature cannot servo to.

        The method is called before the arm moves.

        Raises:
            ConfigurationError: the goal does not contain the data that `teach` returns. Subclasses
                may require other data.
        """
        if type(self).teach is not Feature.teach and self.name not in goal.features:
            raise ConfigurationError(
                f"{goal.name} holds no data of the feature '{self.name}': teach it (rosrun "
                "aras_visual_servo_controller teach --scheme ...)"
            )

    def teach(self, observation: Observation) -> Mapping[str, Any]:
        """Return the data that the goal file stores for this feature, from the view at the goal.

        The values are numbers, lists and strings, which can be written as YAML. When the goal is
        read again, they are in `goal.features[name]`. The goal itself stores moments, joints,
        camera and pose.
        """
        return {}

    def reset(self) -> None:
        """Forget all earlier images."""


FEATURES = Registry("feature", __package__, (Feature,), ConfigurationError)
FEATURES.__doc__ = "All built-in features by name; `create(name)` makes one."


class Stack(Feature):
    """Combination of several features: s, s*, e and L are concatenated, each with its weight.

    Attributes:
        features: the combined features, in order.
    """

    def __init__(self, features: Sequence[Feature], weights: Sequence[float] | None = None) -> None:
        """Combine the features, with one weight >= 0 for each of them.

        Raises:
            ConfigurationError: there is no feature, a feature cannot be combined with others, or
                the numbers of features and weights differ.
        """
        self.features = tuple(features)
        if not self.features:
            raise ConfigurationError("a combination of features needs at least one feature")
        for feature in self.features:
            _check_stackable(feature, feature.is_stackable)
        weights = [1.0] * len(self.features) if weights is None else list(weights)
        if len(weights) != len(self.features) or not all(
            isinstance(w, int | float | np.number) and np.isfinite(w) and w >= 0.0 for w in weights
        ):
            raise ConfigurationError(
                f"weights is {weights}, must be one number >= 0 for each of the "
                f"{len(self.features)} features"
            )
        if not any(weights):
            raise ConfigurationError(f"weights is {weights}; at least one weight must be above 0")
        self.needs = frozenset().union(*(f.needs for f in self.features))
        read = [name for f in self.features for name in f.cameras or ("",)]
        self.cameras = () if not any(read) else tuple(dict.fromkeys(read))
        self.is_geometric = all(f.is_geometric for f in self.features)
        self._parts = tuple(weights)
        self._combine_descriptions()

    def _combine_descriptions(self) -> None:
        """Combine names, tolerances, units and weights, which can depend on the goal."""
        self.names = tuple(n for f in self.features for n in f.names)
        self.tolerances = tuple(t for f in self.features for t in f.tolerances)
        self.units = tuple(u for f in self.features for u in f.units or [""] * len(f.names))
        self.directions = tuple(np.any([f.directions for f in self.features], axis=0).tolist())
        self.weights = np.concatenate([
            w * (np.ones(len(f.names)) if f.weights is None else np.asarray(f.weights, float))
            for f, w in zip(self.features, self._parts, strict=True)
        ])

    def get_needs(self, *cameras: str) -> frozenset[Need]:
        """Return the measurements that the features need from one camera's image."""
        return frozenset().union(*(
            f.get_needs(*cameras) for f in self.features
            if not {*cameras}.isdisjoint(f.cameras or ("",))
        ))  # fmt: skip

    def measure(self, observation: Observation, goal: Goal) -> FeatureMeasurement:
        """Measure all features in one image and concatenate the results."""
        parts = [f.measure(observation, goal) for f in self.features]
        for feature, part in zip(self.features, parts, strict=True):
            _check_stackable(feature, part.error_summary is None)
        rates = [np.broadcast_to(p.error_drift, np.shape(p.s)) for p in parts]
        # The combined features determine the camera's rotation uniquely if one of them does.
        ambiguities = {p.ambiguity for p in parts}
        return FeatureMeasurement(
            s=np.concatenate([p.s for p in parts]),
            desired=np.concatenate([p.desired for p in parts]),
            error=np.concatenate([p.error for p in parts]),
            L=np.vstack([p.L for p in parts]),
            error_drift=np.concatenate(rates),
            ambiguity="" if "" in ambiguities else ", ".join(sorted(ambiguities)),
            notes=tuple(note for p in parts for note in p.notes),
        )

    def desired_interaction(self, goal: Goal) -> np.ndarray:
        """Return the interaction matrix L (k, 6) at the goal."""
        return np.vstack([f.desired_interaction(goal) for f in self.features])

    def accuracy(self, observation: Observation, goal: Goal) -> np.ndarray | float | None:
        """Return the accuracy of all features as a block diagonal matrix, for independent errors.
        """
        parts = [f.accuracy(observation, goal) for f in self.features]
        if all(part is None for part in parts):
            return None
        return scipy.linalg.block_diag(*(
            np.zeros((len(f.names), 0)) if part is None else
            part * np.eye(len(f.names)) if np.ndim(part) == 0 else part
            for f, part in zip(self.features, parts, strict=True)
        ))  # fmt: skip

    def check(self, goal: Goal) -> None:
        """Raise an error for a goal that one of the features cannot servo to."""
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
            f"{name} publishes other errors than the law uses and cannot be combined with other "
            "features: use it alone, without weights"
        )


def get_plane(observation: Observation) -> Plane:
    """Return the plane of the target in this view.

    Raises:
        MeasurementError: the plane is not known.
    """
    if observation.plane is not None:
        return observation.plane
    if observation.depth is not None:
        raise MeasurementError("the depth image has no depth at the target")
    raise MeasurementError(
        "the target's plane is not known in this view: the depth of the goal and the pose of the "
        "camera are required"
    )


def compare_cameras(width: int, height: int, K: np.ndarray, camera: CameraModel) -> str:
    """Describe how `camera` differs from a camera with this image size (px) and matrix K (3, 3).

    Return '' if size and K are the same.
    """
    here = np.reshape(camera.K, (3, 3))
    size = (camera.width, camera.height)
    if size == (width, height) and np.allclose(here, K, rtol=1e-3, atol=0.6):
        return ""
    return (
        f"{width}x{height} px, fx {K[0, 0]:.2f}; this camera has {size[0]}x{size[1]} px, fx "
        f"{here[0, 0]:.2f}"
    )


def wrap(angle: np.ndarray | float, period: float = 2.0 * np.pi) -> np.ndarray | float:
    """Wrap one or several angles (rad) modulo the period to the range [-period/2, period/2)."""
    return (angle + 0.5 * period) % period - 0.5 * period


def wrap_together(is_angle: np.ndarray, period: float = 2.0 * np.pi) -> np.ndarray:
    """Wrap angles (k,) modulo the period; angles close to half a period all get the same sign.

    If each angle were wrapped separately, rounding would give some of them the sign + and others -,
    and their effects would cancel. Therefore all angles are wrapped to within half a period of
    their common angle, which is the angle of the sum of their unit vectors. A common angle of half
    a period is taken as positive.
    """
    unit = np.exp(2j * np.pi / period * is_angle).sum(axis=0)
    common = float(np.angle(unit)) * period / (2.0 * np.pi)
    if abs(common) < NEAR_HALF * period:
        return wrap(is_angle, period)
    if common < HALF_TURN_TOLERANCE - 0.5 * period:
        common += period
    return common + wrap(is_angle - common, period)
