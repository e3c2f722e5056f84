"""Image moments of the target as features: base class, and the features xn, yn, an and alpha.

With the centre of gravity (xg, yg) in normalised coordinates and the area a = m00:

    an = Z* sqrt(a*/a),   xn = an xg,   yn = an yg,   alpha = 1/2 atan2(2 mu11, mu20 - mu02)

For a camera parallel to the target, (xn, yn, an) is the position of the target in front of it, m.
alpha covers the full turn if the third-order moments of the target give it a direction. Otherwise
alpha is ambiguous by half a turn, which the measurement reports. The features do not control the
tilt of the camera; the inverse kinematics keeps it constant. L has all six columns. It is computed
for the plane of the target, whose depth follows from the area.

Reference: O. Tahri and F. Chaumette, Point-based and region-based image moments for visual
servoing of planar objects, IEEE Transactions on Robotics 21(6), 2005.
"""

from __future__ import annotations

from functools import cached_property
from math import hypot, sqrt
from typing import ClassVar

import numpy as np

from aras_visual_servo_camera import moment_feature_values as camera_features
from aras_visual_servo_camera.errors import VisionError
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.moments import Moments

from ..errors import ConfigurationError, MeasurementError
from ..goals.goal import Goal
from ..observation.observation import Need, Observation
from .base import FEATURES, DepthRelativeTolerance, Feature, FeatureMeasurement, wrap

# Of the six camera directions vx ... wz, the features control vx, vy, vz and wz.
LEVEL_CAMERA = (True, True, True, False, False, True)
ALPHA, FULL_ALPHA = "alpha", "alpha_full"
# Order of the moments that are needed for alpha over the full turn, and for its L.
FULL_ALPHA_ORDER = 4
# The error of a measured outline is modelled by HARMONICS independent displacements. Their rms
# amplitude is OUTLINE_ACCURACY / width, in px, for a target with this width in px. Measured on 80
# outlines of 9 to 45 px at goals computed from the geometry: 0.003 for centre and area, 0.007 for
# alpha.
OUTLINE_ACCURACY = 0.0075
# If the same camera measured goal and image, their errors are partly equal and cancel in the
# difference. This fraction of the error remains (measured on 63 outlines: 0.3 to 0.6).
SAME_CAMERA_PART = 0.5
# A target is nearly round if the relative difference of its second moments is below this. Single
# pixels then change alpha, so even with the same camera the errors of alpha in goal and image are
# independent.
ROUND_TOLERANCE = 0.1
# Number of displacements of the outline: 1, cos phi, sin phi, ... cos 4 phi, sin 4 phi, where phi
# is the direction from the outline's centre.
HARMONICS = 9
PARTS_PER_SIDE = 16  # number of points per side of the outline in the numerical integration
# Tolerance of the features xn and yn: 0.5 mm for the laboratory's target at 0.2 m.
CENTRE_TOLERANCE = DepthRelativeTolerance(0.0025)
# Tolerance of the feature an: 1 mm for the target at 0.2 m.
DEPTH_TOLERANCE = DepthRelativeTolerance(0.005)
STEP = 1e-5  # displacement of the outline for finite differences, in normalised coordinates
class _GoalMoments:
    """Quantities of one goal that the formulas of moments need, computed once."""

    def __init__(self, goal: Goal, formulas: tuple[str, ...], tolerance: float) -> None:
        if goal.moments is None:
            raise ConfigurationError(f"{goal.name} holds no moments: teach it again")
        goal.check_depth()
        self.goal, self._tolerance = goal, tolerance
        self.plane = goal.plane or Plane.fronto_parallel(goal.depth)
        try:
            self.reference = camera_features.Reference.from_moments(
                goal.moments, goal.depth, self.plane
            )
            orientation = self.reference.orientation
            self._has_direction = orientation is not None and not orientation.is_symmetric
            self._formulas = formulas
            self._full_formulas = tuple(FULL_ALPHA if n == ALPHA else n for n in formulas)
            found = camera_features.compute_moment_features(
                goal.moments,
                self.select_formulas(goal.moments),
                self.plane,
                self.reference,
                tolerance,
            )
        except VisionError as error:
            raise ConfigurationError(f"{goal.name}: {error}") from error
        if found.degenerate:
            name, reason = next(iter(found.degenerate.items()))
            raise ConfigurationError(f"feature {name} is undefined at {goal.name}: {reason}")
        self.s, self.L = found.values, found.L
        # Normal of the target's plane in the camera frame. If the pose of the camera is known, the
        # normal is also computed in the base frame.
        self.camera_normal = np.array(self.plane) / np.linalg.norm(self.plane)
        pose = goal.world_T_camera
        self.normal = None if pose is None else pose[:3, :3] @ self.camera_normal
        # On the ray (x, y, 1) to the target's centre, a patch of area A with the normal n at depth
        # Z has the image area a = A (n . ray) / Z^2. This is solved for A.
        ray = (goal.moments.xg, goal.moments.yg, 1.0)
        depth = 1.0 / self.plane.inverse_depth(*ray[:2])
        self.patch_area = goal.moments.area * depth**2 / float(self.camera_normal @ ray)

    @cached_property
    def slopes(self) -> np.ndarray:
        """Derivatives (k, HARMONICS) of the features for displacements of the goal's outline.

        `compute_displacement_moments` describes the displacements.
        """
        moments, columns = self.goal.moments, []
        formulas = self.select_formulas(moments)
        for change in compute_displacement_moments(self.goal.compute_outline(), moments.order):
            high, low = (
                camera_features.compute_feature_values(
                    moments.add(step * change), formulas, self.plane, self.reference,
                    self._tolerance,
                )
                for step in (STEP, -STEP)
            )  # fmt: skip
            columns.append([
                0.5 * wrap(2.0 * change, np.pi) if formula.startswith("alpha") else change
                for formula, change in zip(formulas, 0.5 * (high - low), strict=True)
            ])  # fmt: skip
        return np.transpose(columns) / STEP

    def select_formulas(self, moments: Moments) -> tuple[str, ...]:
        """Return the formulas; alpha covers the full turn if the shape has a known direction."""
        if not self._has_direction or moments.order < FULL_ALPHA_ORDER:
            return self._formulas
        return self._full_formulas


class MomentFeature(Feature):
    """Base class of features that are formulas of moments.

    A subclass sets `formulas`, the name of a function in
    `aras_visual_servo_camera.moment_feature_values` for each component. If the third-order moments
    of the goal give the target a direction, the angle `alpha` is replaced by `alpha_full`, which
    covers the full turn.

    Attributes:
        anisotropy: smallest relative difference of the second moments for which a shape has an
            angle alpha. It is above 0, because pixels give even a square a small difference.
    """

    formulas: ClassVar[tuple[str, ...]]
    needs = frozenset((Need.MOMENTS,))
    anisotropy: ClassVar[float] = 1e-2

    def __init__(self) -> None:
        self._goal_moments: _GoalMoments | None = None

    def check(self, goal: Goal) -> None:
        """Refuse a goal that this feature cannot servo to."""
        self._prepare_goal(goal)

    def measure(self, observation: Observation, goal: Goal) -> FeatureMeasurement:
        """Measure s, s*, the error and L in one image."""
        goal_moments = self._prepare_goal(goal)
        moments = observation.moments
        if moments is None:
            raise MeasurementError(
                "this observation has no moments, which require a segmented target"
            )
        formulas = goal_moments.select_formulas(moments)
        try:
            found = camera_features.compute_moment_features(
                moments, formulas, self._estimate_plane(observation, moments, goal_moments),
                goal_moments.reference,
                self.anisotropy,
            )  # fmt: skip
        except (VisionError, ArithmeticError) as error:
            raise MeasurementError(str(error)) from error
        if found.degenerate:
            name, reason = next(iter(found.degenerate.items()))
            raise MeasurementError(f"feature {name} is undefined: {reason}")
        error = found.values - goal_moments.s
        ambiguity = ""
        for i, formula in enumerate(formulas):
            if formula == FULL_ALPHA:
                error[i] = wrap(error[i])
            elif formula == ALPHA:
                error[i], ambiguity = wrap(error[i], np.pi), "180°"
        return FeatureMeasurement(found.values, goal_moments.s, error, found.L, ambiguity=ambiguity)

    def desired_interaction(self, goal: Goal) -> np.ndarray:
        """Return the interaction matrix L (k, 6) at the goal."""
        return self._prepare_goal(goal).L

    def accuracy(self, observation: Observation, goal: Goal) -> np.ndarray | None:
        """Return the accuracy of s for random displacements of the goal's outline."""
        goal_moments = self._prepare_goal(goal)
        if not observation.pixel_count:
            # An exact camera counts no pixels; only the noise of the corners changes its outline.
            noise = observation.corner_accuracy
            is_known = noise and observation.moments is not None
            return noise * goal_moments.slopes if is_known else None
        size = OUTLINE_ACCURACY / sqrt(observation.pixel_count) / observation.camera.K[0]
        if goal.camera != observation.camera:
            return size * goal_moments.slopes
        found = size * SAME_CAMERA_PART * goal_moments.slopes
        mu20, mu11, mu02 = goal.moments.second
        if hypot(mu20 - mu02, 2.0 * mu11) < ROUND_TOLERANCE * (mu20 + mu02):
            for i, formula in enumerate(goal_moments.select_formulas(goal.moments)):
                if formula.startswith("alpha"):
                    found[i] /= SAME_CAMERA_PART
        return found

    def _prepare_goal(self, goal: Goal) -> _GoalMoments:
        if self._goal_moments is None or self._goal_moments.goal is not goal:
            self._goal_moments = _GoalMoments(goal, self.formulas, self.anisotropy)
        return self._goal_moments

    @staticmethod
    def _estimate_plane(
        observation: Observation, moments: Moments, goal_moments: _GoalMoments
    ) -> Plane:
        """Return the target's plane: the measured one, or an estimate by kinematics and area.

        The estimate has the orientation that follows from kinematics, and the depth that follows
        from the target's area.
        """
        plane = observation.plane
        if observation.is_plane_measured and plane.inverse_depth(moments.xg, moments.yg) > 0.0:
            return plane
        normal = goal_moments.camera_normal
        if goal_moments.normal is not None and observation.world_T_camera is not None:
            normal = observation.world_T_camera[:3, :3].T @ goal_moments.normal
        A, B, C = normal.tolist()
        facing = A * moments.xg + B * moments.yg + C
        if facing < 0.05:
            raise MeasurementError(
                "the camera views the target's plane edge-on or from behind"
            )
        scale = facing * sqrt(goal_moments.patch_area * facing / moments.area)
        return Plane(A / scale, B / scale, C / scale)


@FEATURES.register("moments")
class ImageMoments(MomentFeature):
    """s = xn, yn, an (m) and alpha (rad), which control vx, vy, vz and wz of the camera."""

    formulas = names = camera_features.PAPER_FEATURES
    # Tolerances of the mean error over 1 s. They exceed the errors due to joint friction, and are
    # ten times the errors due to camera noise.
    tolerances = (CENTRE_TOLERANCE, CENTRE_TOLERANCE, DEPTH_TOLERANCE, 0.005)
    units = ("m", "m", "m", "rad")
    directions = LEVEL_CAMERA


def compute_displacement_moments(outline: np.ndarray, order: int) -> np.ndarray:
    """Compute how moments (order + 1, order + 1) change if an outline (n, 2) is displaced outwards.

    The displacement at a point is 1, cos phi, sin phi, cos 2 phi, ..., where phi is the direction
    from the outline's centre to the point. Return the derivative for each of these HARMONICS
    functions.
    """
    start, step = outline, np.roll(outline, -1, axis=0) - outline
    parts = (np.arange(PARTS_PER_SIDE) + 0.5) / PARTS_PER_SIDE
    places = (start[:, None] + parts[:, None] * step[:, None]).reshape(-1, 2)
    lengths = np.repeat(np.linalg.norm(step, axis=1), PARTS_PER_SIDE) / PARTS_PER_SIDE
    x, y = places.T
    dx, dy = (places - outline.mean(axis=0)).T
    phi, orders = np.arctan2(dy, dx), np.arange(1, HARMONICS // 2 + 1)
    waves = [np.ones_like(phi)]
    for m in orders:
        waves += [np.cos(m * phi), np.sin(m * phi)]
    powers = np.arange(order + 1)
    return np.einsum(
        "hn,in,jn->hij", waves * lengths, x ** powers[:, None], y ** powers[:, None]
    )
