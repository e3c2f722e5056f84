"""Image moments of the target: formulas over them, and the paper's features.

With xg, yg the centre of gravity in normalised coordinates and a = m00 the area:

    an = Z* sqrt(a*/a),   xn = an xg,   yn = an yg,   alpha = 1/2 atan2(2 mu11, mu20 - mu02)

xn, yn and an are metres: the place of the target before a camera parallel to it. alpha is taken
over the full turn where the target's third-order moments give it a direction; where they do not,
the error is known up to half a turn and says so. The attitude but for alpha is not modelled: the
resolver holds it. L has all six columns all the same, for the target's plane as the camera is
held over it, at the depth that its area tells.

Reference: O. Tahri and F. Chaumette, Point-based and region-based image moments for visual
servoing of planar objects, IEEE Transactions on Robotics 21(6), 2005.
"""

from __future__ import annotations

from functools import cached_property
from math import hypot, sqrt
from typing import ClassVar

import numpy as np

from aras_visual_servo_camera import features as camera_features
from aras_visual_servo_camera.errors import VisionError
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.moments import Moments

from ..errors import ConfigurationError, MeasurementError
from ..goals.goal import Goal
from ..observation.observation import Need, Observation
from .base import FEATURES, DepthFraction, Feature, FeatureMeasurement, wrap

LEVEL_CAMERA = (True, True, True, False, False, True)  # vx, vy, vz, wz
ALPHA, FULL_ALPHA = "alpha", "alpha_full"
FULL_ALPHA_ORDER = 4  # of moments that tell alpha over the whole turn, with its L
# px, times the target's width in px: what each of HARMONICS displacements of its outline amounts
# to, rms; of a goal that this camera has shown the picture is nearly the same, and FRESH is left of
# it. Measured on squares of 15 to 55 px, drawn with and without physics (0.01 to 0.04).
OUTLINE_ACCURACY, SAME_CAMERA_PART = 0.03, 0.12
# Difference of the outline's widths, part of their sum of squares, below which pixels make as much
# of alpha as the target's own shape: alpha is then as if another camera had shown the goal.
ROUND_TOLERANCE = 0.1
HARMONICS = 9  # 1, cos phi, sin phi, ... cos 4 phi, sin 4 phi, of the direction from the middle
PARTS_PER_SIDE = 16  # of each side of an outline
# Tolerances of xn and yn, and of an: 0.5 and 1 mm before the laboratory's target, at 0.2 m.
CENTRE_TOLERANCE, DEPTH_TOLERANCE = DepthFraction(0.0025), DepthFraction(0.005)
STEP = 1e-5  # normalised; displacement by which the features' slopes are taken


class _GoalMoments:
    """What one goal means for formulas over moments, worked out once."""

    def __init__(self, goal: Goal, formulas: tuple[str, ...], tolerance: float) -> None:
        if goal.moments is None:
            raise ConfigurationError(f"{goal.name} holds no moments: teach it anew")
        if goal.depth is None:
            raise ConfigurationError(f"{goal.name} does not say the target's depth (m)")
        self.goal, self._tolerance = goal, tolerance
        self.plane = goal.plane or Plane.fronto_parallel(goal.depth)
        try:
            self.reference = camera_features.Reference.from_moments(
                goal.moments, goal.depth, self.plane
            )
            orientation = self.reference.orientation
            self._has_direction = orientation is not None and not orientation.is_symmetric
            self._formulas = formulas
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
            raise ConfigurationError(f"{goal.name}: feature {name} is undefined there: {reason}")
        self.s, self.L = found.values, found.L
        # In the camera's frame, and in the base's where the camera's pose is known.
        self.camera_normal = np.array(self.plane) / np.linalg.norm(self.plane)
        pose = goal.world_T_camera
        self.normal = None if pose is None else pose[:3, :3] @ self.camera_normal
        # A patch of area A at depth Z shows a = A (n . r) / Z^2 along the ray r = (x, y, 1).
        ray = (goal.moments.xg, goal.moments.yg, 1.0)
        depth = 1.0 / self.plane.inverse_depth(*ray[:2])
        self.patch_area = goal.moments.area * depth**2 / float(self.camera_normal @ ray)

    @cached_property
    def slopes(self) -> np.ndarray:
        """By how much the features (k, HARMONICS) change where the goal's outline is displaced; see
        `compute_displacement_moments`."""
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
        """Those that these moments tell: alpha over the whole turn where the goal's shape has a
        direction and the moments' order shows it."""
        if not self._has_direction or moments.order < FULL_ALPHA_ORDER:
            return self._formulas
        return tuple(FULL_ALPHA if name == ALPHA else name for name in self._formulas)


class MomentFeature(Feature):
    """Base: give `formulas`, one a component, as the camera package's features are written.

    An `alpha` becomes `alpha_full`, over the whole turn, where the goal's third-order moments
    give it a direction.

    Attributes:
        anisotropy: below this a shape is a square, without angle: pixels leave it some.
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
        at = self._prepare_goal(goal)
        moments = observation.moments
        if moments is None:
            raise MeasurementError("no moments in this observation: is it the segmented target's?")
        formulas = at.select_formulas(moments)
        try:
            found = camera_features.compute_moment_features(
                moments, formulas, self._estimate_plane(observation, moments, at), at.reference,
                self.anisotropy,
            )  # fmt: skip
        except (VisionError, ArithmeticError) as error:
            raise MeasurementError(str(error)) from error
        if found.degenerate:
            name, reason = next(iter(found.degenerate.items()))
            raise MeasurementError(f"feature {name} is undefined: {reason}")
        error = found.values - at.s
        up_to = ""
        for i, formula in enumerate(formulas):
            if formula == FULL_ALPHA:
                error[i] = wrap(error[i])
            elif formula == ALPHA:
                error[i], up_to = wrap(error[i], np.pi), "180°"
        return FeatureMeasurement(found.values, at.s, error, found.L, ambiguity=up_to)

    def desired_interaction(self, goal: Goal) -> np.ndarray:
        """Return the interaction matrix L (k, 6) at the goal."""
        return self._prepare_goal(goal).L

    def accuracy(self, observation: Observation, goal: Goal) -> np.ndarray | None:
        """See Feature.accuracy; of displacements of the goal's outline, by differences."""
        at = self._prepare_goal(goal)
        if not observation.pixel_count:
            noise = observation.corner_accuracy  # of an exact outline whose corners have noise
            return noise * at.slopes if noise and observation.moments is not None else None
        size = OUTLINE_ACCURACY / sqrt(observation.pixel_count) / observation.camera.K[0]
        if goal.camera != observation.camera:
            return size * at.slopes
        found = size * SAME_CAMERA_PART * at.slopes
        mu20, mu11, mu02 = goal.moments.second
        if hypot(mu20 - mu02, 2.0 * mu11) < ROUND_TOLERANCE * (mu20 + mu02):
            for i, formula in enumerate(at.select_formulas(goal.moments)):
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
        """The observation's where it is measured; else its attitude by kinematics, its depth by
        the area."""
        plane, centre = observation.plane, (moments.xg, moments.yg)
        if observation.is_plane_measured and plane.inverse_depth(*centre) > 0.0:
            return plane
        normal = goal_moments.camera_normal
        if goal_moments.normal is not None and observation.world_T_camera is not None:
            normal = observation.world_T_camera[:3, :3].T @ goal_moments.normal
        facing = float(normal @ (*centre, 1.0))
        if facing < 0.05:
            raise MeasurementError("the camera looks along the target's plane, not on it")
        depth = sqrt(goal_moments.patch_area * facing / moments.area)
        return Plane(*(normal / (facing * depth)).tolist())


@FEATURES.register("moments")
class ImageMoments(MomentFeature):
    """xn, yn, an (m) and alpha (rad), for vx, vy, vz and wz."""

    formulas = names = camera_features.PAPER_FEATURES
    # The means of a second: a friction of the joints leaves less, the noisy camera a tenth.
    tolerances = (CENTRE_TOLERANCE, CENTRE_TOLERANCE, DEPTH_TOLERANCE, 0.005)
    units = ("m", "m", "m", "rad")
    directions = LEVEL_CAMERA


def compute_displacement_moments(outline: np.ndarray, order: int) -> np.ndarray:
    """Raw moments (HARMONICS, order + 1, order + 1) of what is gained where an outline (n, 2) is
    displaced outwards by 1, cos phi, sin phi, ... of the direction phi from its middle."""
    begin, step = outline, np.roll(outline, -1, axis=0) - outline
    parts = (np.arange(PARTS_PER_SIDE) + 0.5) / PARTS_PER_SIDE
    places = (begin[:, None] + parts[:, None] * step[:, None]).reshape(-1, 2)
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
