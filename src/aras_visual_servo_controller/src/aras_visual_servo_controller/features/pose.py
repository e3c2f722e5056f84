"""Features of the pose between goal and camera, computed from numbered points of a plane.

The goal's points and their plane give 3-D points. The pose follows from a homography and is refined
by Gauss-Newton on the image points. No model of the target is needed. Frames: c is the current
camera, g the camera at the goal, o the centroid of the points; a_R_b maps b to a.

References: F. Chaumette and S. Hutchinson, Visual servo control, part I, IEEE RAM 13(4), 2006
(position-based control in both frames); E. Malis, F. Chaumette and S. Boudet, 2 1/2 D visual
servoing, IEEE Transactions on Robotics and Automation 15(2), 1999.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from aras_visual_servo_base.poses import exponential, rotation_vector, rotation_vector_rate, skew
from aras_visual_servo_camera.interaction import point_interaction

from ..errors import ConfigurationError, MeasurementError
from ..goals.goal import Goal
from ..observation.observation import Observation
from .base import FEATURES, DepthRelativeTolerance, FeatureMeasurement
from .corners import NumberedPoints
from .points import TOLERANCE
from .points import backproject as places_of

MAX_ITERATIONS, CONVERGED_STEP = 10, 1e-13
# Points are collinear if the ratio of their second to their largest singular value is below this.
PLANARITY_TOLERANCE = 1e-9


class PoseFeature(NumberedPoints):
    """Base class of pose features; a subclass implements `compute_from_pose`.

    Attributes:
        components: name, tolerance and unit of each component.
    """

    components: ClassVar[tuple[tuple[str, float, str], ...]]

    def compute_from_pose(
        self, c_T_g: np.ndarray, origin: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute s (k,) and L (k, 6) from the pose of the goal camera.

        Args:
            c_T_g: (4, 4) pose of the goal camera in the current camera frame.
            origin: (3,) centroid of the points in the goal camera frame, m.
        """
        raise NotImplementedError

    def check(self, goal: Goal) -> None:
        """Refuse a goal that this feature cannot servo to."""
        super().check(goal)
        places = self._backproject_goal(goal)
        if len(places) < 4 or are_collinear(places):
            raise ConfigurationError(
                f"{goal.name}: a pose needs four points that are not on one line; the goal has "
                f"{len(places)} points"
            )

    def measure(self, observation: Observation, goal: Goal) -> FeatureMeasurement:
        """Measure s, s*, the error and L in one image."""
        places = self._backproject_goal(goal)
        points, ambiguity = self._match_to_goal(observation, self.read_desired_points(goal))
        c_T_g = estimate_planar_pose(places, points)
        origin = places.mean(axis=0)
        s, L = self.compute_from_pose(c_T_g, origin)
        desired, _ = self.compute_from_pose(np.eye(4), origin)
        return FeatureMeasurement(s, desired, s - desired, L, ambiguity=ambiguity)

    def accuracy(self, observation: Observation, goal: Goal) -> np.ndarray | None:
        """Return the accuracy of s, which is propagated from that of the points by least squares.
        """
        points = super().accuracy(observation, goal)
        if points is None:
            return None
        desired = self.read_desired_points(goal)
        L = point_interaction(desired, self._compute_goal_inverse_depth(goal, desired))
        return self.desired_interaction(goal) @ np.linalg.pinv(L) @ points

    def desired_interaction(self, goal: Goal) -> np.ndarray:
        """Return the interaction matrix L (k, 6) at the goal."""
        return self.compute_from_pose(np.eye(4), self._backproject_goal(goal).mean(axis=0))[1]

    def _backproject_goal(self, goal: Goal) -> np.ndarray:
        """Return the goal's points (n, 3) in the goal camera frame, m."""
        desired = self.read_desired_points(goal)
        return places_of(desired, self._compute_goal_inverse_depth(goal, desired))

    def _set_count(self, count: int) -> None:
        self.count = count
        self.names, self.tolerances, self.units = zip(*self.components, strict=True)


TRANSLATION_COMPONENTS = tuple(
    (name, DepthRelativeTolerance(TOLERANCE), "m") for name in ("tx", "ty", "tz")
)
ROTATION_COMPONENTS = tuple((name, 0.003, "rad") for name in ("ux", "uy", "uz"))


@FEATURES.register("theta_u")
class ThetaU(PoseFeature):
    """s = theta u, the rotation vector of the camera in the goal frame, rad.

    L = (0, J), where J is the inverse right Jacobian of the rotation.
    """

    components = ROTATION_COMPONENTS
    directions = (False, False, False, True, True, True)

    def compute_from_pose(
        self, c_T_g: np.ndarray, origin: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute s (k,) and L (k, 6) from the pose c_T_g (4, 4)."""
        return _compute_rotation(c_T_g)


@FEATURES.register("translation")
class Translation(PoseFeature):
    """s = g_t_c, the camera's position in the goal frame, m; L = (g_R_c, 0).

    The camera moves on a straight line.
    """

    components = TRANSLATION_COMPONENTS
    directions = (True, True, True, False, False, False)

    def compute_from_pose(
        self, c_T_g: np.ndarray, origin: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute s (k,) and L (k, 6) from the pose c_T_g (4, 4)."""
        return _compute_translation(c_T_g)


@FEATURES.register("translation_camera")
class TranslationCamera(PoseFeature):
    """s = c_t_o, the position of the points' centroid in the camera frame, m.

    The centroid moves on a straight line in the image. L = (-1, [c_t_o]x).
    """

    components = TRANSLATION_COMPONENTS

    def compute_from_pose(
        self, c_T_g: np.ndarray, origin: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute s (k,) and L (k, 6) from the pose c_T_g (4, 4)."""
        place = c_T_g[:3, :3] @ origin + c_T_g[:3, 3]
        return place, np.hstack([-np.eye(3), skew(place)])


@FEATURES.register("pose")
class PoseInGoalFrame(PoseFeature):
    """Position-based servoing: s = (g_t_c, theta u), the camera's pose in the goal frame."""

    components = TRANSLATION_COMPONENTS + ROTATION_COMPONENTS

    def compute_from_pose(
        self, c_T_g: np.ndarray, origin: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute s (k,) and L (k, 6) from the pose c_T_g (4, 4)."""
        return compute_goal_frame_feature(c_T_g)


@FEATURES.register("model")
class ModelPose(PoseInGoalFrame):
    """Position-based servoing on the pose of a known mesh, which the tracker `model` measures."""



@FEATURES.register("pose_camera")
class PoseCamera(PoseFeature):
    """Position-based servoing: s = (c_t_o, theta u), with the translation in the camera frame."""

    components = TRANSLATION_COMPONENTS + ROTATION_COMPONENTS

    def compute_from_pose(
        self, c_T_g: np.ndarray, origin: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute s (k,) and L (k, 6) from the pose c_T_g (4, 4)."""
        place = TranslationCamera.compute_from_pose(self, c_T_g, origin)
        return _stack(place, _compute_rotation(c_T_g))


@FEATURES.register("two_and_half_d")
class TwoAndHalfD(PoseFeature):
    """2 1/2 D servoing: s = (x, y, log Z, theta u), with x, y and Z of the points' centroid."""

    components = (("x", 0.001, ""), ("y", 0.001, ""), ("log_Z", 0.005, ""), *ROTATION_COMPONENTS)

    def compute_from_pose(
        self, c_T_g: np.ndarray, origin: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute s (k,) and L (k, 6) from the pose c_T_g (4, 4)."""
        X, Y, Z = c_T_g[:3, :3] @ origin + c_T_g[:3, 3]
        x, y = X / Z, Y / Z
        turn, L_turn = _compute_rotation(c_T_g)
        L_point = point_interaction(np.array([[x, y]]), np.array([1.0 / Z]))
        L_depth = np.array([[0.0, 0.0, -1.0 / Z, -y, x, 0.0]])
        return np.array([x, y, np.log(Z), *turn]), np.vstack([L_point, L_depth, L_turn])


def estimate_planar_pose(
    object_points: np.ndarray, points: np.ndarray, iterations: int = MAX_ITERATIONS
) -> np.ndarray:
    """Compute the pose c_T_g (4, 4) of coplanar points.

    Args:
        object_points: (n, 3) points in frame g, m.
        points: (n, 2) their normalised image points.
        iterations: maximum number of refinements; 0 for the pose of the homography alone.

    Raises:
        MeasurementError: the points do not determine a pose.
    """
    if are_collinear(points):
        raise MeasurementError(
            "the points of the target give no pose: they lie on one line; use other points"
        )
    middle = object_points.mean(axis=0)
    basis = np.linalg.svd(object_points - middle)[2]
    flat = (object_points - middle) @ basis[:2].T
    size = np.abs(flat).max()
    H = _estimate_homography(flat / size, points)
    H[:, :2] /= size
    if H[2, 2] < 0.0:
        H = -H
    H = H / np.sqrt(np.linalg.norm(H[:, 0]) * np.linalg.norm(H[:, 1]))
    normal = np.cross(basis[0], basis[1])
    frame = np.column_stack([basis[0], basis[1], normal])
    U, _, Vt = np.linalg.svd(np.column_stack([H[:, 0], H[:, 1], np.cross(H[:, 0], H[:, 1])]))
    # R is a rotation, because the decomposed matrix has a positive determinant
    R = U @ Vt @ frame.T
    return refine_pose(R, H[:, 2] - R @ middle, object_points, points, iterations)


def _estimate_homography(plane_points: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Estimate H (3, 3) by the direct linear transform.

    H maps (plane_points, 1) to points, up to scale.
    """
    p = np.column_stack([plane_points, np.ones(len(plane_points))])
    A = np.zeros((2 * len(p), 9))
    A[0::2, 0:3] = A[1::2, 3:6] = p
    A[0::2, 6:9] = -points[:, :1] * p
    A[1::2, 6:9] = -points[:, 1:] * p
    return np.linalg.svd(A)[2][-1].reshape(3, 3)


def refine_pose(
    R: np.ndarray, t: np.ndarray, object_points: np.ndarray, points: np.ndarray,
    iterations: int = MAX_ITERATIONS,
) -> np.ndarray:  # fmt: skip
    """Refine a pose c_T_g (4, 4) by minimising the squared distances in the image."""
    for _ in range(iterations):
        P = object_points @ R.T + t
        if not (P[:, 2] > 0.0).all():
            raise MeasurementError("the points of the target give a pose behind the camera")
        projected = P[:, :2] / P[:, 2:]
        # Here the target moves instead of the camera, so L has the opposite sign.
        L = -point_interaction(projected, 1.0 / P[:, 2])
        step = np.linalg.lstsq(L, (points - projected).ravel(), rcond=None)[0]
        turned = exponential(step)[:3, :3]
        R, t = turned @ R, turned @ t + step[:3]
        if np.abs(step).max() < CONVERGED_STEP:
            break
    c_T_g = np.eye(4)
    c_T_g[:3, :3], c_T_g[:3, 3] = R, t
    return c_T_g


def are_collinear(points: np.ndarray) -> bool:
    """Return whether points (n, 2) or (n, 3) are on one line, or all coincide."""
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return not spread[1] > PLANARITY_TOLERANCE * spread[0]


def compute_goal_frame_feature(c_T_g: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute s (6,) and L (6, 6) of the feature s = (g_t_c, theta u of g_R_c), m and rad."""
    return _stack(_compute_translation(c_T_g), _compute_rotation(c_T_g))


def _compute_translation(c_T_g: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute s = g_t_c (3,), m, and its L (3, 6)."""
    g_R_c = c_T_g[:3, :3].T
    return -g_R_c @ c_T_g[:3, 3], np.hstack([g_R_c, np.zeros((3, 3))])


def _compute_rotation(c_T_g: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute s = theta u of g_R_c (3,), rad, and its L (3, 6)."""
    turn = rotation_vector(c_T_g[:3, :3].T)
    return turn, np.hstack([np.zeros((3, 3)), rotation_vector_rate(turn)])


def _stack(*parts: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Concatenate the values s of several features, and stack the rows of their L."""
    return np.concatenate([s for s, _ in parts]), np.vstack([L for _, L in parts])
