"""Features that are functions of image moments.

Each feature lists the names of its functions. The module
`aras_visual_servo_camera.moment_feature_values` computes their values and interaction matrices. To
define your own feature, list other names in a subclass of MomentFeature.

References: F. Chaumette, Image moments: a general and useful set of features for visual servoing,
IEEE T-RO 20(4), 2004; O. Tahri and F. Chaumette, Point-based and region-based image moments for
visual servoing of planar objects, IEEE T-RO 21(6), 2005.
"""

from __future__ import annotations

from .base import FEATURES
from .moments import ALPHA, CENTRE_TOLERANCE, DEPTH_TOLERANCE, LEVEL_CAMERA, MomentFeature


@FEATURES.register("basic_moments")
class BasicMoments(MomentFeature):
    """s = m00, m10, m01, m20, m11, m02 about the principal point; vpFeatureMomentBasic in ViSP."""

    formulas = names = ("m00", "m10", "m01", "m20", "m11", "m02")
    tolerances, units = (1e-4, 1e-4, 1e-4, 1e-5, 1e-5, 1e-5), ("",) * 6


@FEATURES.register("centred_moments")
class CentredMoments(MomentFeature):
    """s = mu20, mu11, mu02, mu30, mu21, mu12, mu03; vpFeatureMomentCentered in ViSP."""

    formulas = names = ("mu20", "mu11", "mu02", "mu30", "mu21", "mu12", "mu03")
    tolerances, units = (1e-5,) * 3 + (1e-6,) * 4, ("",) * 7


@FEATURES.register("gravity_centre")
class GravityCentre(MomentFeature):
    """s = xg, yg, the centre of gravity; vpFeatureMomentGravityCenter in ViSP."""

    formulas = names = ("xg", "yg")
    tolerances, units = (0.001, 0.001), ("", "")
    directions = (True, True, False, False, False, False)


@FEATURES.register("gravity_centre_normalised")
class NormalisedGravityCentre(MomentFeature):
    """s = an (xg, yg) with an of `NormalisedArea`, m.

    If the image plane is parallel to the target, s is linear in the camera's x and y.
    """

    formulas = names = ("xn", "yn")
    tolerances, units = (CENTRE_TOLERANCE, CENTRE_TOLERANCE), ("m", "m")
    directions = (True, True, False, False, False, False)


@FEATURES.register("area")
class Area(MomentFeature):
    """s = a, the target's area in normalised coordinates; vpFeatureMomentArea in ViSP."""

    formulas = names = ("area",)
    tolerances, units = (1e-4,), ("",)
    directions = (False, False, True, False, False, False)


@FEATURES.register("area_normalised")
class NormalisedArea(MomentFeature):
    """s = an = Z* sqrt(a* / a), m, which is the depth if the target is parallel to the image."""

    formulas = names = ("an",)
    tolerances, units = (DEPTH_TOLERANCE,), ("m",)
    directions = (False, False, True, False, False, False)


@FEATURES.register("alpha")
class Alpha(MomentFeature):
    """s = alpha, the orientation, rad; it covers the full turn if the shape has a direction."""

    formulas = names = (ALPHA,)
    tolerances, units = (0.005,), ("rad",)
    directions = (False, False, False, False, False, True)


@FEATURES.register("ellipse")
class Ellipse(MomentFeature):
    """s = xg, yg, n20, n11, n02 of an ellipse or circle, with n = mu / m00.

    For an ellipse whose axes are parallel to x and y, n20 and n02 are a quarter of the squared
    semi-axes. n20, n11 and n02 are defined for any region. A rotation about the axis of symmetry
    does not change s. ViSP calls this feature vpFeatureEllipse.
    """

    formulas = ("xg", "yg", "mu20 / m00", "mu11 / m00", "mu02 / m00")
    names = ("xg", "yg", "n20", "n11", "n02")
    tolerances, units = (0.001, 0.001, 1e-5, 1e-5, 1e-5), ("",) * 5


@FEATURES.register("invariants")
class Invariants(MomentFeature):
    """s = C1 ... C10 of Tahri and Chaumette 2005, invariant to rotation, shift and scale.

    These invariants depend on the two tilts of the target; vpFeatureMomentCInvariant in ViSP.
    """

    formulas = names = tuple(f"C{k}" for k in range(1, 11))
    tolerances, units = (0.01,) * 10, ("",) * 10
    directions = (False, False, False, True, True, False)


@FEATURES.register("sx_sy")
class Skewness(MomentFeature):
    """s = Sx, Sy of Chaumette 2004, which control the two tilts of a target without symmetry."""

    formulas = names = ("Sx", "Sy")
    tolerances, units = (0.001, 0.001), ("", "")
    directions = (False, False, False, True, True, False)


@FEATURES.register("px_py")
class Symmetry(MomentFeature):
    """s = Px, Py of Chaumette 2004, which control the two tilts of a symmetric target."""

    formulas = names = ("Px", "Py")
    tolerances, units = (0.001, 0.001), ("", "")
    directions = (False, False, False, True, True, False)


@FEATURES.register("moments_pitch")
class MomentsPitch(MomentFeature):
    """s = xn, yn, an, Sy, alpha: the feature `moments`, and Sy to control the pitch."""

    formulas = names = ("xn", "yn", "an", "Sy", ALPHA)
    tolerances = (CENTRE_TOLERANCE, CENTRE_TOLERANCE, DEPTH_TOLERANCE, 0.001, 0.005)
    units = ("m", "m", "m", "", "rad")
    directions = (*LEVEL_CAMERA[:4], True, True)


@FEATURES.register("moments_six")
class MomentsSix(MomentFeature):
    """s = xn, yn, an, Sx, Sy, alpha: all six camera directions, for a target without symmetry."""

    formulas = names = ("xn", "yn", "an", "Sx", "Sy", ALPHA)
    tolerances = (CENTRE_TOLERANCE, CENTRE_TOLERANCE, DEPTH_TOLERANCE, 0.001, 0.001, 0.005)
    units = ("m", "m", "m", "", "", "rad")
