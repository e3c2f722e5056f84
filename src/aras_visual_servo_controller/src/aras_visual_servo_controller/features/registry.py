"""Features by name."""

from __future__ import annotations

from aras_visual_servo_base.lazy import LazyClasses
from aras_visual_servo_base.names import construct, find_class

from ..errors import ConfigurationError
from .base import Feature

FEATURES = LazyClasses(__package__, {
    "moments": ".moments:ImageMoments",
    "kernel": ".kernel:Kernel",
    "points": ".points:Points",
    "numbered_points": ".corners:NumberedPoints",
    "polar_points": ".corners:PolarPoints",
    "points_3d": ".corners:Points3D",
    "depth": ".corners:Depth",
    "lines": ".corners:Lines",
    "segments": ".corners:Segments",
    "normalised_segments": ".corners:NormalisedSegments",
    "vanishing_points": ".corners:VanishingPoints",
    "theta_u": ".pose:ThetaU",
    "translation": ".pose:Translation",
    "translation_camera": ".pose:TranslationCamera",
    "pose": ".pose:PoseInGoalFrame",
    "pose_camera": ".pose:PoseCamera",
    "model": ".pose:ModelPose",
    "two_and_half_d": ".pose:TwoAndHalfD",
    "basic_moments": ".moment_features:BasicMoments",
    "centred_moments": ".moment_features:CentredMoments",
    "gravity_centre": ".moment_features:GravityCentre",
    "gravity_centre_normalised": ".moment_features:NormalisedGravityCentre",
    "area": ".moment_features:Area",
    "area_normalised": ".moment_features:NormalisedArea",
    "alpha": ".moment_features:Alpha",
    "ellipse": ".moment_features:Ellipse",
    "invariants": ".moment_features:Invariants",
    "sx_sy": ".moment_features:Skewness",
    "px_py": ".moment_features:Symmetry",
    "moments_pitch": ".moment_features:MomentsPitch",
    "moments_six": ".moment_features:MomentsSix",
    "luminance": ".luminance:Luminance",
    "luminance_lm": ".luminance:LuminanceDamped",
    "luminance_dct": ".luminance:LuminanceDCT",
    "luminance_pca": ".luminance:LuminancePCA",
    "photometric_moments": ".luminance:PhotometricMoments",
    "matches": ".matches:Matches",
    "matches_orb": ".matches:MatchesORB",
    "matches_pose": ".matches:MatchesPose",
    "stereo_points": ".stereo:StereoPoints",
    "stereo_pose": ".stereo:StereoPose",
})  # fmt: skip


def create_feature(name: str) -> Feature:
    """The feature of a short name or of 'package.module:Class'.

    Raises:
        ConfigurationError: unknown feature, or what its constructor raised.
    """
    cls = find_class("feature", name, FEATURES, (Feature,), ConfigurationError)
    return construct("feature", name, cls, ConfigurationError)
