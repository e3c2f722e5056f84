"""Features by name."""

from __future__ import annotations

from aras_visual_servo_base.names import construct, find_class

from ..errors import ConfigurationError
from .base import Feature
from .corners import (
    Depth,
    Lines,
    NormalisedSegments,
    NumberedPoints,
    Points3D,
    PolarPoints,
    Segments,
    VanishingPoints,
)
from .kernel import Kernel
from .luminance import Luminance, LuminanceDamped, LuminanceDCT, LuminancePCA, PhotometricMoments
from .matches import Matches, MatchesORB, MatchesPose
from .moment_features import (
    Alpha,
    Area,
    BasicMoments,
    CentredMoments,
    Ellipse,
    GravityCentre,
    Invariants,
    MomentsPitch,
    MomentsSix,
    NormalisedArea,
    NormalisedGravityCentre,
    Skewness,
    Symmetry,
)
from .moments import ImageMoments
from .points import Points
from .pose import (
    ModelPose,
    PoseCamera,
    PoseInGoalFrame,
    ThetaU,
    Translation,
    TranslationCamera,
    TwoAndHalfD,
)
from .stereo import StereoPoints, StereoPose

FEATURES: dict[str, type[Feature]] = {
    "moments": ImageMoments,
    "kernel": Kernel,
    "points": Points,
    **{
        feature.name: feature
        for feature in (
            NumberedPoints, PolarPoints, Points3D, Depth, Lines, Segments, NormalisedSegments,
            VanishingPoints, ThetaU, Translation, TranslationCamera, PoseInGoalFrame, PoseCamera,
            ModelPose, TwoAndHalfD,
            BasicMoments, CentredMoments, GravityCentre, NormalisedGravityCentre, Area,
            NormalisedArea, Alpha, Ellipse, Invariants, Skewness, Symmetry, MomentsPitch,
            MomentsSix, Luminance, LuminanceDamped, LuminanceDCT, LuminancePCA, PhotometricMoments,
            Matches, MatchesORB, MatchesPose, StereoPoints, StereoPose,
        )
    },
}


def create_feature(name: str) -> Feature:
    """The feature of a short name or of 'package.module:Class'.

    Raises:
        ConfigurationError: unknown feature, or what its constructor raised.
    """
    cls = find_class("feature", name, FEATURES, (Feature,), ConfigurationError)
    return construct("feature", name, cls, ConfigurationError)
