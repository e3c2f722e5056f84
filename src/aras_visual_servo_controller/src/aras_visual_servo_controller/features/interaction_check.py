"""Check of a feature's interaction matrix against finite differences."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from aras_visual_servo_base.poses import Pose
from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_camera.interaction import Plane

from ..errors import ConfigurationError, InteractionMatrixError, SchemeError
from ..goals.goal import Goal
from ..interaction_check_defaults import STEP, TOLERANCE
from ..kinematics.task import DIRECTIONS
from ..observation.feature_observer import FeatureObserver
from ..observation.observation import Need, Observation
from .base import FEATURES, Feature, FeatureMeasurement

Observe = Callable[[np.ndarray], Observation]

# Corners of a hexagon without symmetry, 7 cm wide, in the plane z = 0 of the world.
CORNERS = np.array([(-0.03, -0.036, 0.0), (0.0, -0.036, 0.0), (0.004, 0.012, 0.0),
                    (0.034, 0.01, 0.0), (0.03, 0.036, 0.0), (-0.034, 0.034, 0.0)])  # fmt: skip
# world_T_camera at the goal, 0.3 m above the hexagon CORNERS.
GOAL_POSE = Pose.from_rpy((0.01, 0.005, 0.3), (np.pi, 0.0, 0.1)).matrix()
# Default views: tilted by 14 degrees to different sides, rotated, and 5 to 9 cm from the goal.
# Several views are needed, because a coordinate close to 0 may hide a wrong sign in a single view.
TEST_POSES = np.array([
    Pose.from_rpy((0.03, -0.04, 0.28), (np.pi - 0.2, 0.15, 0.4)).matrix(),
    Pose.from_rpy((-0.03, 0.04, 0.33), (np.pi + 0.2, -0.15, -0.3)).matrix(),
    Pose.from_rpy((-0.05, -0.035, 0.36), (np.pi - 0.15, -0.2, 0.9)).matrix(),
])  # fmt: skip
CAMERA = CameraModel(640, 480, (600.0, 0.0, 319.5, 0.0, 600.0, 239.5, 0.0, 0.0, 1.0))
# Measurements that an exact camera provides without an image.
EXACT_NEEDS = frozenset((Need.MOMENTS, Need.CONTOUR, Need.CORNERS))
MAX_ROWS = 12  # largest number of rows in the printed table


@dataclass(frozen=True, eq=False, repr=False)
class InteractionCheck:
    """Comparison of an interaction matrix L with finite differences, printed as a table.

    The feature has k components and was checked at p poses.

    Attributes:
        feature: name of the feature, as given.
        names: (k,) names of its components.
        poses: (p, 4, 4) poses world_T_camera at which L was checked.
        L, differences: (p, k, 6) interaction matrices, and finite differences of the error.
        units: (6,) units of the motions: depth at the goal (m) three times, and 1 rad three times.
        tolerance: largest relative error of a correct row.
    """

    feature: str
    names: tuple[str, ...]
    poses: np.ndarray
    L: np.ndarray
    differences: np.ndarray
    units: np.ndarray
    tolerance: float

    @cached_property
    def _relative(self) -> np.ndarray:
        """Relative error (p, k) of each row of L at each pose; inf if a value is not finite."""
        L, differences = self.L * self.units, self.differences * self.units
        off = np.linalg.norm(L - differences, axis=2)
        size = np.maximum(np.linalg.norm(L, axis=2), np.linalg.norm(differences, axis=2))
        relative = np.divide(off, size, out=np.zeros(off.shape), where=size != 0.0)
        return np.nan_to_num(relative, nan=np.inf)

    @property
    def errors(self) -> np.ndarray:
        """Relative error (k,) of each row of L, at the pose where it is largest."""
        return self._relative.max(axis=0)

    @property
    def is_correct(self) -> bool:
        """True if no row of L differs from the finite differences by more than the tolerance."""
        return bool((self.errors <= self.tolerance).all())

    def find_worst_entry(self, row: int | None = None) -> tuple[int, int, int]:
        """Find the entry of L that contributes most to the error of a row.

        Args:
            row: index of the row; None for the row with the largest relative error.

        Returns:
            The indices of the pose, the row and the column.
        """
        if row is None:
            row = int(np.argmax(self.errors))
        pose = int(np.argmax(self._relative[:, row]))
        off = np.abs((self.L - self.differences)[pose, row] * self.units)
        return pose, row, int(np.argmax(np.nan_to_num(off, nan=np.inf)))

    def describe_entry(self, pose: int, row: int, column: int) -> str:
        """Describe an entry: names of row and column, both values, and the pose of the camera."""
        found = Pose.from_matrix(self.poses[pose])
        xyz, rpy = (", ".join(f"{value:.3g}" for value in part) for part in (found.xyz, found.rpy))
        return (
            f"row '{self.names[row]}', column {DIRECTIONS[column]}: L is "
            f"{self.L[pose, row, column]:.4g}, finite differences "
            f"{self.differences[pose, row, column]:.4g}, with the camera at xyz ({xyz}) m, "
            f"rpy ({rpy}) rad in the world"
        )

    def __repr__(self) -> str:
        """Describe the worst entry, and list the rows with the largest errors."""
        order = np.argsort(-self.errors, kind="stable")
        width = max(len(self.names[row]) for row in order[:MAX_ROWS])
        lines = [
            f"  {self.names[row]:<{width}}  {_format_percent(self.errors[row]):>8} %  "
            f"{'ok' if self.errors[row] <= self.tolerance else 'WRONG'}"
            for row in order[:MAX_ROWS]
        ]
        if len(order) > MAX_ROWS:
            lines.append(f"  and {len(order) - MAX_ROWS} rows with smaller errors")
        count = int((self.errors > self.tolerance).sum())
        wrong = f"L is wrong in {count} of {len(order)} rows"
        verdict = "L is correct" if self.is_correct else wrong
        return "\n".join([
            f"{self.feature}: {verdict} (tolerance {_format_percent(self.tolerance)} %, "
            f"{len(self.poses)} pose{'s' if len(self.poses) > 1 else ''})", *lines,
            f"  largest error: {self.describe_entry(*self.find_worst_entry())}",
        ])  # fmt: skip


def check_interaction_matrix(
    feature: Feature | type[Feature] | str,
    observe: Observe | None = None,
    world_T_camera: np.ndarray | None = None,
    goal: Goal | None = None,
    step: float = STEP,
    tolerance: float = TOLERANCE,
) -> InteractionCheck:
    """Compare the interaction matrix L of a feature with finite differences of its error.

    The target is at rest, so de/dt = L v. For each of the six camera directions j,

        L[:, j] D[j] = (e(+step) - e(-step)) / (2 step),   D = (depth, depth, depth, 1, 1, 1)

    where e(h) is the error after the camera has moved by h D[j] along (m) or about (rad) axis j of
    its optical frame. A row of L is correct if the norm of its difference, in these units, is at
    most `tolerance` times the norm of the row.

    Args:
        feature: the feature, its class, 'package.module:Class', or the name of a built-in feature.
            All six columns of L are checked, also those of directions that the feature does not
            control.
        observe: function that returns the observation of a camera at the pose world_T_camera (4,
            4). The default is a pinhole camera about 0.3 m above a hexagon 7 cm wide, with exact
            moments, contour, corners and plane. It is required for a feature that needs images or
            several cameras.
        world_T_camera: (4, 4) or (p, 4, 4), poses of the optical frame in the world at which L is
            checked. The default is three poses, 5 to 9 cm from the goal, tilted by 14 degrees and
            rotated.
        goal: goal of the feature. By default it is taught 0.3 m above the hexagon.
        step: motion h of the finite differences, in units of D.
        tolerance: largest relative error of a correct row. Finite differences of exact observations
            are correct to about 1e-6; those of images need a larger `step` and `tolerance`.

    Returns:
        The relative errors of the rows, and all values of both matrices. When printed, the check
        lists the rows and the worst entry.

    Raises:
        InteractionMatrixError: a row is wrong. The message names the row, the column, both values
            and the pose; the attribute `check` contains all values.
        SchemeError: L has a wrong shape.
        ConfigurationError: there is no such feature, the default camera does not provide what it
            needs, or the feature cannot servo to the goal.
        MeasurementError: the feature cannot be measured in one of the views.
    """
    label = ""
    if isinstance(feature, str):
        label, feature = feature, FEATURES.create(feature)
    elif isinstance(feature, type):
        label, feature = feature.__name__, feature()
    label = label or feature.name
    if observe is None:
        observe = _make_exact_observer(feature)
    poses = np.array(TEST_POSES if world_T_camera is None else world_T_camera, float)
    if goal is None:
        observation = observe(GOAL_POSE)
        goal = replace(
            Goal.teach(None, observation), features={feature.name: feature.teach(observation)}
        )
    feature.check(goal)
    units = np.array([goal.distance] * 3 + [1.0] * 3)
    poses = poses.reshape(-1, 4, 4)
    pairs = [_compute_both(feature, observe, pose, goal, step * units, step) for pose in poses]
    count = {len(L) for L, _ in pairs}
    if len(count) > 1:
        raise ConfigurationError(
            f"{feature.name} has {' or '.join(map(str, sorted(count)))} components at different "
            "poses: check one pose at a time, by world_T_camera"
        )
    L, differences = (np.array(matrices) for matrices in zip(*pairs, strict=True))
    check = InteractionCheck(
        label, _name_rows(feature, L.shape[1]), poses, L, differences / units, units,
        tolerance,
    )  # fmt: skip
    if check.is_correct:
        return check
    pose, row, column = check.find_worst_entry()
    raise InteractionMatrixError(
        f"{label}: row '{check.names[row]}' of L is off by "
        f"{_format_percent(check.errors[row])} % (tolerance {_format_percent(tolerance)} %), most "
        f"in {check.describe_entry(pose, row, column)}",
        check,
    )


def _compute_both(
    feature: Feature, observe: Observe, pose: np.ndarray, goal: Goal, motions: np.ndarray,
    step: float,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Compute L (k, 6) at a pose, and the finite differences (k, 6) per unit of motion.

    Args:
        feature: feature to check.
        observe: function that returns the observation at a pose.
        pose: (4, 4) world_T_camera.
        goal: goal of the feature.
        motions: (6,) step of the finite difference along (m) or about (rad) each camera axis.
        step: this step in the units of the result, target depths or rad.
    """
    here = feature.measure(observe(pose), goal)
    columns = []
    for axis in range(6):
        ahead, behind = (
            feature.measure(observe(pose @ _make_motion(axis, h)), goal)
            for h in (motions[axis], -motions[axis])
        )
        columns.append(
            (_compute_error(feature, ahead, here) - _compute_error(feature, behind, here))
            / (2 * step)
        )
    L, differences = np.asarray(here.L, float), np.stack(columns, axis=1)
    if not len(differences):
        raise ConfigurationError(f"{feature.name} has no components: give it names and an error")
    if L.shape != differences.shape:
        raise SchemeError(
            f"{feature.name}: L has shape {L.shape}, and its {len(differences)} components need "
            f"{differences.shape}"
        )
    return L, differences


def _name_rows(feature: Feature, count: int) -> tuple[str, ...]:
    """Return the names of the rows of L; a row without its own name has its number."""
    names = (feature.names,) if isinstance(feature.names, str) else tuple(feature.names)
    return names if len(names) == count else tuple(map(str, range(count)))


def _format_percent(part: float) -> str:
    """Return a fraction in percent with two digits, and without an exponent above 100 %."""
    return f"{100.0 * part:.2g}" if part < 0.995 else f"{100.0 * part:.0f}"


def _make_exact_observer(feature: Feature) -> Observe:
    """Return a function that computes exact observations of the default target, a hexagon.

    Raises:
        ConfigurationError: the feature needs other measurements.
    """
    more = sorted(need.value for need in feature.needs - EXACT_NEEDS)
    if more or feature.camera_count > 1 or any(feature.cameras):
        what = f"needs {', '.join(more)}" if more else "reads cameras by name"
        raise ConfigurationError(
            f"{feature.name} {what}: pass as observe a function that returns the Observation of a "
            "camera at the pose world_T_camera (4, 4)"
        )

    def observe(world_T_camera: np.ndarray) -> Observation:
        points = (CORNERS - world_T_camera[:3, 3]) @ world_T_camera[:3, :3]
        plane = Plane(*(-world_T_camera[2, :3] / world_T_camera[2, 3]).tolist())
        return FeatureObserver(None, feature.needs).observe_exact_features(
            0.0, CAMERA, world_T_camera=world_T_camera, contour=points[:, :2] / points[:, 2:],
            plane=plane,
        )  # fmt: skip

    return observe


def _make_motion(axis: int, amount: float) -> np.ndarray:
    """Compute the motion (4, 4) along (m) or about (rad) one axis of the camera frame."""
    motion = np.eye(4)
    if axis < 3:
        motion[axis, 3] = amount
    else:
        motion[:3, :3] = Rotation.from_rotvec(amount * np.eye(3)[axis - 3]).as_matrix()
    return motion


def _compute_error(
    feature: Feature, measured: FeatureMeasurement, reference: FeatureMeasurement
) -> np.ndarray:
    """Return the error (k,) of a measurement.

    Raises:
        ConfigurationError: the error has another number of components than that of `reference`.
    """
    if np.shape(measured.error) != np.shape(reference.error):
        raise ConfigurationError(
            f"{feature.name} has {np.size(reference.error)} components in one view and "
            f"{np.size(measured.error)} in the next: L cannot be checked by finite differences"
        )
    return np.asarray(measured.error, float)
