"""Features that are formulas over image moments, each by a list of the camera package's names.

Their values and interaction matrices are those of `aras_visual_servo_camera.features`: F.
Chaumette, Image moments: a general and useful set of features for visual servoing, IEEE T-RO
20(4), 2004; O. Tahri and F. Chaumette, Point-based and region-based image moments for visual
servoing of planar objects, IEEE T-RO 21(6), 2005. A user's own is a subclass with formulas.
"""

from __future__ import annotations

from typing import ClassVar, NamedTuple

import numpy as np

from aras_visual_servo_camera import features as camera_features
from aras_visual_servo_camera.errors import VisionError
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.moments import Moments

from ..arm.task import ALL_DIRECTIONS
from ..errors import ConfigurationError, MeasurementError
from ..goals.goal import Goal
from ..seeing.observation import Need, Observation
from .base import Measured, wrap
from .moments import LEVEL_CAMERA, ImageMoments

ALPHA, FULL_ALPHA = "alpha", "alpha_full"


class _GoalView(NamedTuple):
    """What one goal means for moments. camera_normal, normal: of the target's plane (3,), in the
    camera's frame and in the base's, where that is known. patch: area that is A n.r / Z^2."""

    goal: Goal
    reference: camera_features.Reference
    plane: Plane
    formulas: tuple[str, ...]
    s: np.ndarray
    L: np.ndarray
    camera_normal: np.ndarray
    normal: np.ndarray | None
    patch: float


class MomentFeature(ImageMoments):
    """Base: give `formulas`, one a component, as the camera package's features are written.

    An `alpha` becomes `alpha_full`, over the whole turn, where the goal's third-order moments
    give it a direction.
    """

    formulas: ClassVar[tuple[str, ...]]
    needs = frozenset((Need.MOMENTS,))
    directions = ALL_DIRECTIONS

    def __init__(self) -> None:
        self._view: _GoalView | None = None

    def check(self, goal: Goal) -> None:
        """See Feature.check."""
        self._at(goal)

    def measure(self, observation: Observation, goal: Goal) -> Measured:
        """See Feature.measure."""
        at = self._at(goal)
        moments = observation.moments
        if moments is None:
            raise MeasurementError("no moments in this observation: is it the segmented target's?")
        try:
            plane = self._plane(observation, moments, at)
            found = camera_features.compute(
                moments, at.formulas, plane, at.reference, self.anisotropy
            )
        except (VisionError, ArithmeticError) as error:
            raise MeasurementError(str(error)) from error
        if found.degenerate:
            name, reason = next(iter(found.degenerate.items()))
            raise MeasurementError(f"feature {name} is undefined: {reason}")
        error = found.values - at.s
        up_to = ""
        for i, formula in enumerate(at.formulas):
            if formula == FULL_ALPHA:
                error[i] = wrap(error[i])
            elif formula == ALPHA:
                error[i], up_to = wrap(error[i], np.pi), "180°"
        return Measured(found.values, at.s, error, found.L, up_to=up_to)

    @staticmethod
    def _formulas(at: _GoalView) -> tuple[str, ...]:
        return at.formulas

    def desired_interaction(self, goal: Goal) -> np.ndarray:
        """See Feature.desired_interaction."""
        return self._at(goal).L

    def _at(self, goal: Goal) -> _GoalView:
        if self._view is None or self._view.goal is not goal:
            self._view = self._known(goal)
        return self._view

    def _known(self, goal: Goal) -> _GoalView:
        if goal.moments is None:
            raise ConfigurationError(f"{goal.name} holds no moments: teach it anew")
        if goal.depth is None:
            raise ConfigurationError(f"{goal.name} does not say the target's depth (m)")
        plane = goal.plane or Plane.fronto_parallel(goal.depth)
        try:
            reference = camera_features.Reference.from_moments(goal.moments, goal.depth, plane)
            formulas = self._directed(goal.moments, reference)
            found = camera_features.compute(
                goal.moments, formulas, plane, reference, self.anisotropy
            )
        except VisionError as error:
            raise ConfigurationError(f"{goal.name}: {error}") from error
        if found.degenerate:
            name, reason = next(iter(found.degenerate.items()))
            raise ConfigurationError(f"{goal.name}: feature {name} is undefined there: {reason}")
        camera_normal = np.array(plane) / np.linalg.norm(plane)
        pose = goal.world_T_camera
        normal = None if pose is None else pose[:3, :3] @ camera_normal
        ray = (goal.moments.xg, goal.moments.yg, 1.0)
        depth = 1.0 / plane.inverse_depth(*ray[:2])
        patch = goal.moments.area * depth**2 / float(camera_normal @ ray)
        return _GoalView(
            goal, reference, plane, formulas, found.values, found.L, camera_normal, normal, patch
        )

    def _directed(
        self, moments: Moments, reference: camera_features.Reference
    ) -> tuple[str, ...]:
        """The formulas, alpha over the whole turn where this shape has a direction."""
        orientation = reference.orientation
        if orientation is None or orientation.symmetric or moments.order < 4:
            return self.formulas
        return tuple(FULL_ALPHA if formula == ALPHA else formula for formula in self.formulas)


class BasicMoments(MomentFeature):
    """s = m00, m10, m01, m20, m11, m02 about the principal point: ViSP's vpFeatureMomentBasic."""

    name = "basic_moments"
    formulas = names = ("m00", "m10", "m01", "m20", "m11", "m02")
    tolerances, units = (1e-4, 1e-4, 1e-4, 1e-5, 1e-5, 1e-5), ("",) * 6


class CentredMoments(MomentFeature):
    """s = mu20, mu11, mu02, mu30, mu21, mu12, mu03: ViSP's vpFeatureMomentCentered."""

    name = "centred_moments"
    formulas = names = ("mu20", "mu11", "mu02", "mu30", "mu21", "mu12", "mu03")
    tolerances, units = (1e-5,) * 3 + (1e-6,) * 4, ("",) * 7


class GravityCentre(MomentFeature):
    """s = xg, yg: ViSP's vpFeatureMomentGravityCenter."""

    name = "gravity_centre"
    formulas = names = ("xg", "yg")
    tolerances, units = (0.001, 0.001), ("", "")
    directions = (True, True, False, False, False, False)


class NormalisedGravityCentre(MomentFeature):
    """s = xn, yn = an (xg, yg), m: linear in the translation."""

    name = "gravity_centre_normalised"
    formulas = names = ("xn", "yn")
    tolerances, units = (0.0005, 0.0005), ("m", "m")
    directions = (True, True, False, False, False, False)


class Area(MomentFeature):
    """s = a, the target's area in the normalised image: ViSP's vpFeatureMomentArea."""

    name = "area"
    formulas = names = ("area",)
    tolerances, units = (1e-4,), ("",)
    directions = (False, False, True, False, False, False)


class NormalisedArea(MomentFeature):
    """s = an = Z* sqrt(a* / a), m: the depth of a target square on."""

    name = "area_normalised"
    formulas = names = ("an",)
    tolerances, units = (0.001,), ("m",)
    directions = (False, False, True, False, False, False)


class Alpha(MomentFeature):
    """s = alpha, rad, the orientation; over the whole turn where the shape has a direction."""

    name = "alpha"
    formulas = names = (ALPHA,)
    tolerances, units = (0.005,), ("rad",)
    directions = (False, False, False, False, False, True)


class Ellipse(MomentFeature):
    """s = xg, yg, n20, n11, n02 with n = mu / m00: of an ellipse or a circle, vpFeatureEllipse.

    n20, n11, n02 are a quarter of the squared semi-axes of the ellipse, so they fit any region.
    A turn about its axis of symmetry is not seen.
    """

    name = "ellipse"
    formulas = ("xg", "yg", "mu20 / m00", "mu11 / m00", "mu02 / m00")
    names = ("xg", "yg", "n20", "n11", "n02")
    tolerances, units = (0.001, 0.001, 1e-5, 1e-5, 1e-5), ("",) * 5


class Invariants(MomentFeature):
    """s = C1 ... C10 of Tahri and Chaumette 2005: a turn, a shift, a scale leave them alone.

    They tell the two tilts: ViSP's vpFeatureMomentCInvariant.
    """

    name = "invariants"
    formulas = names = tuple(f"C{k}" for k in range(1, 11))
    tolerances, units = (0.01,) * 10, ("",) * 10
    directions = (False, False, False, True, True, False)


class Skewness(MomentFeature):
    """s = Sx, Sy of Chaumette 2004: the two tilts of a target without symmetry."""

    name = "sx_sy"
    formulas = names = ("Sx", "Sy")
    tolerances, units = (0.001, 0.001), ("", "")
    directions = (False, False, False, True, True, False)


class Symmetry(MomentFeature):
    """s = Px, Py of Chaumette 2004: the two tilts of a target with a symmetry."""

    name = "px_py"
    formulas = names = ("Px", "Py")
    tolerances, units = (0.001, 0.001), ("", "")
    directions = (False, False, False, True, True, False)


class MomentsPitch(MomentFeature):
    """xn, yn, an, alpha, and Sy for the pitch: the paper's moments with a fifth direction."""

    name = "moments_pitch"
    formulas = names = ("xn", "yn", "an", "Sy", ALPHA)
    tolerances = (0.0005, 0.0005, 0.001, 0.001, 0.005)
    units = ("m", "m", "m", "", "rad")
    directions = (*LEVEL_CAMERA[:4], True, True)


class MomentsSix(MomentFeature):
    """xn, yn, an, Sx, Sy, alpha: all six directions, of a target without symmetry."""

    name = "moments_six"
    formulas = names = ("xn", "yn", "an", "Sx", "Sy", ALPHA)
    tolerances = (0.0005, 0.0005, 0.001, 0.001, 0.001, 0.005)
    units = ("m", "m", "m", "", "", "rad")
