"""Check of a feature's interaction matrix against finite differences."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from aras_visual_servo_base.poses import Pose
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.undistortion import CameraModel

from ..errors import ConfigurationError, SchemeError
from ..goals.goal import Goal
from ..kinematics.task import DIRECTIONS
from ..observation.feature_observer import FeatureObserver
from ..observation.observation import Need, Observation
from .base import Feature, FeatureMeasurement

Observe = Callable[[np.ndarray], Observation]

# Corners of a hexagon without symmetry, 7 cm wide, in the plane z = 0 of the world.
CORNERS = np.array([(-0.03, -0.036, 0.0), (0.0, -0.036, 0.0), (0.004, 0.012, 0.0),
                    (0.034, 0.01, 0.0), (0.03, 0.036, 0.0), (-0.034, 0.034, 0.0)])  # fmt: skip
# world_T_camera at the goal, 0.3 m above the hexagon, and at the view in which L is checked, which
# is tilted and turned.
GOAL_POSE = Pose.from_rpy((0.01, 0.005, 0.3), (np.pi, 0.0, 0.1)).matrix()
TEST_POSE = Pose.from_rpy((0.03, -0.04, 0.28), (np.pi - 0.2, 0.15, 0.4)).matrix()
CAMERA = CameraModel(640, 480, (600.0, 0.0, 319.5, 0.0, 600.0, 239.5, 0.0, 0.0, 1.0))
# Measurements that exist without images.
EXACT_NEEDS = frozenset((Need.MOMENTS, Need.CONTOUR, Need.CORNERS))
# Motion in rad, or as a fraction of the depth. The finite differences are then exact to about 1e-7.
STEP = 1e-4
TOLERANCE = 1e-3


def check_interaction_matrix(
    feature: Feature,
    observe: Observe | None = None,
    world_T_camera: np.ndarray | None = None,
    goal: Goal | None = None,
    step: float = STEP,
    tolerance: float = TOLERANCE,
) -> np.ndarray:
    """Compare the interaction matrix L of a feature with finite differences of its own error.

    The target is at rest, so de/dt = L v. For each of the six directions j of the camera, in its
    optical frame, with D = (depth, depth, depth, 1, 1, 1) as the unit of a motion,

        L[:, j] D[j] = (e(+step) - e(-step)) / (2 step)

    where e(h) is the error after a motion by h D[j] along or about axis j. A row of L passes if the
    norm of its difference, in these units, is at most `tolerance` times the norm of the row.

    Args:
        feature: feature to check. All six columns of its L are checked, including those of
            directions that the feature does not control, because the camera moves in these
            directions, too.
        observe: function that returns the observation of a camera at world_T_camera (4, 4). The
            default is a pinhole camera 0.28 m above a hexagon of 7 cm, with exact moments, contour,
            corners and plane. A feature that needs images or several cameras needs its own
            function.
        world_T_camera: (4, 4) optical frame at which L is checked, in the world. The default is
            tilted by 14 degrees, 5 cm from the goal, and turned by 17 degrees about the optical
            axis.
        goal: goal of the feature. The default is taught 0.3 m above the hexagon.
        step: half the distance between the two views, as a fraction of the depth for translations,
            in rad for rotations.
        tolerance: largest relative error of a row. Finite differences of exact observations are
            correct to about 1e-6; differences of images need a larger `step` and `tolerance`.

    Returns:
        (k,) relative error of each row.

    Raises:
        SchemeError: a row is wrong; the message names the row and the column, with both values.
        ConfigurationError: the default target does not offer what the feature needs, or the feature
            refuses the goal.
        MeasurementError: the feature cannot be measured in one of the views.
    """
    if observe is None:
        observe = _make_exact_observer(feature)
    pose = TEST_POSE if world_T_camera is None else np.array(world_T_camera, float)
    if goal is None:
        observation = observe(GOAL_POSE)
        goal = replace(
            Goal.teach(None, observation), features={feature.name: feature.teach(observation)}
        )
    feature.check(goal)
    here = feature.measure(observe(pose), goal)
    L = np.asarray(here.L, float)
    units = np.array([goal.distance] * 3 + [1.0] * 3)
    columns = []
    for axis in range(6):
        ahead, behind = (
            feature.measure(observe(pose @ _make_motion(axis, h * units[axis])), goal)
            for h in (step, -step)
        )
        columns.append(
            (_compute_error(feature, ahead, here) - _compute_error(feature, behind, here))
            / (2 * step)
        )
    differences = np.stack(columns, axis=1)
    return _compare_rows(feature, L * units, differences, units, tolerance)


def _make_exact_observer(feature: Feature) -> Observe:
    """Return a function that computes exact observations of the hexagon.

    Raises:
        ConfigurationError: the feature needs other measurements.
    """
    more = sorted(need.value for need in feature.needs - EXACT_NEEDS)
    if more or feature.camera_count > 1 or any(feature.cameras):
        what = f"needs {', '.join(more)}" if more else "reads cameras by name"
        raise ConfigurationError(
            f"{feature.name} {what}: give observe, a function that returns the Observation of a "
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
    """Return the measured error (k,).

    Raises:
        ConfigurationError: the error has another number of components than the reference.
    """
    if np.shape(measured.error) != np.shape(reference.error):
        raise ConfigurationError(
            f"{feature.name} has {np.size(reference.error)} components in one view and "
            f"{np.size(measured.error)} in the next: L cannot be checked by finite differences"
        )
    return np.asarray(measured.error, float)


def _compare_rows(
    feature: Feature, L: np.ndarray, differences: np.ndarray, units: np.ndarray, tolerance: float
) -> np.ndarray:
    """Return the relative errors (k,) of the rows of L.

    Raises:
        SchemeError: the error of a row exceeds the tolerance, or L has a wrong shape.
    """
    if L.shape != differences.shape:
        raise SchemeError(
            f"{feature.name}: L has shape {L.shape}, must have {differences.shape} for "
            f"{len(differences)} components"
        )
    off = np.linalg.norm(L - differences, axis=1)
    size = np.maximum(np.linalg.norm(L, axis=1), np.linalg.norm(differences, axis=1))
    relative = np.divide(off, size, out=np.zeros(len(off)), where=size != 0.0)
    if not (relative <= tolerance).all():
        row = int(np.argmax(np.nan_to_num(relative, nan=np.inf)))
        column = int(np.argmax(np.abs(np.nan_to_num(L - differences, nan=np.inf)[row])))
        actual, found = L[row, column] / units[column], differences[row, column] / units[column]
        name = feature.names[row] if row < len(feature.names) else str(row)
        raise SchemeError(
            f"{feature.name}: row '{name}' of L is off by {100.0 * relative[row]:.2g} % (tolerance "
            f"{100.0 * tolerance:.2g} %), most in column {DIRECTIONS[column]}: L is "
            f"{actual:.4g}, finite differences {found:.4g}"
        )
    return relative
