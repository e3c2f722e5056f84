"""Construction of schemes by name."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aras_visual_servo_base.registry import construct

from ..errors import ConfigurationError
from ..features.base import Feature
from ..laws import Law
from ..observation.observation import Need
from .base import SCHEMES, JointController, Scheme
from .feature_scheme import FeatureScheme


def create_scheme(
    name: str | Sequence[str],
    law: Law | None = None,
    weights: Sequence[float] | None = None,
    **options: object,
) -> Scheme | JointController:
    """Create a scheme from its name, 'package.module:Class', or the names of several features.

    A feature with a law f is the scheme L v = f(e). Several features are combined by concatenating
    their s, e and L.

    Args:
        name: name of a scheme, of a feature, or of several features (as a list, or joined by '+').
            If a feature uses other cameras than the control camera, their names follow an '@':
            'points@right', 'stereo_points@left,right'.
        law: control law; None for the proportional law. Joint controllers do not use it.
        weights: one weight for each feature, applied to its rows of e and L.
        options: options of features: `interaction` ('current', 'desired', 'mean' or 'estimated')
            and `smoothing` (time constant of a low-pass filter on the error, s).

    Returns:
        The scheme, or the joint controller.

    Raises:
        ConfigurationError: the name is unknown, the constructor failed, or an option does not apply
            to the scheme.
    """
    names = name.split("+") if isinstance(name, str) else list(name)
    parts = [part.partition("@") for part in names]
    names, cameras = [p[0].strip() for p in parts], [_split_camera_names(p[2]) for p in parts]
    for part, read in zip(parts, cameras, strict=True):
        if part[1] and not (part[2].strip() and all(read)):
            raise ConfigurationError(f"scheme '{name}': the name of a camera is missing after @")
    found = [SCHEMES.find(part) for part in names]
    if len(found) == 1 and not issubclass(found[0], Feature):
        cls = found[0]
        given = {k: v for k, v in options.items() if v not in (None, "", "current", 0.0)}
        if given or weights is not None:
            raise ConfigurationError(
                f"scheme '{name}' takes no {', '.join(given) or 'weights'}, which only features use"
            )
        own = (law,) if issubclass(cls, Scheme) else ()
        made = check_scheme(construct("scheme", names[0], cls, ConfigurationError, *own), names[0])
        if cameras[0]:
            if len(cameras[0]) > 1:
                raise ConfigurationError(
                    f"scheme '{names[0]}' reads one camera, but '{name}' names "
                    f"{len(cameras[0])}"
                )
            made.cameras = cameras[0]
        return made
    if wrong := [n for n, cls in zip(names, found, strict=True) if not issubclass(cls, Feature)]:
        raise ConfigurationError(
            f"scheme '{wrong[0]}' is not a feature and cannot be combined with features: use it "
            "alone"
        )
    features = [
        construct("scheme", n, cls, ConfigurationError)
        for n, cls in zip(names, found, strict=True)
    ]
    for i, (feature, part) in enumerate(zip(features, names, strict=True)):
        features[i] = _assign_cameras(check_scheme(feature, part), part, cameras[i])
    if len(features) == 1 and weights is None:
        options.setdefault("ratio", getattr(features[0], "ratio", None))
    return construct(
        "scheme",
        str(name),
        FeatureScheme,
        ConfigurationError,
        features,
        law,
        weights=weights,
        **options,
    )


def _split_camera_names(text: str) -> tuple[str, ...]:
    """Split the camera names of a text at its commas; an empty text contains none."""
    return tuple(part.strip() for part in text.split(",")) if text else ()


def _assign_cameras(feature: Feature, name: str, cameras: tuple[str, ...]) -> Feature:
    """Set the cameras of the feature and return it; without `cameras`, keep the feature's own.

    Raises:
        ConfigurationError: the feature uses another number of cameras.
    """
    count = max(feature.camera_count, len(feature.cameras))
    if cameras and len(cameras) != count or not cameras and count > max(len(feature.cameras), 1):
        example = ",".join(("left", "right", "third", "fourth")[:count])
        raise ConfigurationError(
            f"scheme '{name}' reads {count} camera{'s' if count > 1 else ''}: name "
            f"{'them' if count > 1 else 'one'}, for example {name}@{example}"
        )
    if not cameras:
        return feature
    if count == 1:
        from ..features.remote_camera_feature import RemoteCameraFeature

        return RemoteCameraFeature(feature, cameras[0])
    feature.cameras = cameras
    return feature


def check_scheme(scheme: object, name: str) -> object:
    """Return the scheme or feature with its attributes checked and converted.

    Raises:
        ConfigurationError: `names`, `tolerances` or `needs` are missing or do not fit together.
    """
    for attribute in ("names", "tolerances", "needs"):
        if not hasattr(scheme, attribute):
            raise ConfigurationError(
                f"scheme '{name}': {type(scheme).__name__} has no {attribute}; define it"
            )
    for attribute, single in (("names", str), ("units", str), ("needs", Need)):
        if isinstance(getattr(scheme, attribute), single):  # make a tuple of a single value
            value = getattr(scheme, attribute)
            setattr(scheme, attribute, (value,) if value else ())
    if np.ndim(scheme.tolerances) == 0 and isinstance(scheme.tolerances, int | float):
        scheme.tolerances = (scheme.tolerances,) * len(scheme.names)
    try:
        tolerances = [float(t) for t in scheme.tolerances]
        count = len(tuple(scheme.names))
        scheme.needs = frozenset(scheme.needs)
    except (TypeError, ValueError) as error:
        raise ConfigurationError(f"scheme '{name}': {error}") from error
    if len(tolerances) != count or count == 0 or not all(t > 0.0 for t in tolerances):
        raise ConfigurationError(
            f"scheme '{name}' has {count} names but the tolerances {tolerances}; give one "
            "number above 0 for each name"
        )
    return scheme
