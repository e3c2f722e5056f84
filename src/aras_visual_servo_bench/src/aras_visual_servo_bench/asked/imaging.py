"""How the cameras of an experiment take their images: which effects act, and which cannot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from aras_sim_bridge.camera.config import CameraConfig
from aras_sim_bridge.camera.effects import Effects
from aras_visual_servo_base.settings import merge

from ..errors import ExperimentError, require
from .cameras import Eye, config_of
from .experiment import FLYING, Experiment

# Effects that are drawn by chance, which a goal is taught without.
CHANCE = {"noise_stddev", "shot_noise", "sensor", "drop_probability"}
# Effects on exact features: when rows are exposed, and which images are lost. The others are on the
# light of an image.
ON_FEATURES = {"row_time", "rows_together", "drop_probability"}
# What the ideal camera, which sees at one instant, cannot have.
OVER_TIME = ("row_time", "exposure_time")
RENDERED = ("near", "far")  # of a renderer
IN_LINK = ("xyz", "rpy")


def imaging_settings(eye: Eye, experiment: Experiment, exactly: bool) -> dict[str, Any]:
    """Settings of a camera of an experiment with what the experiment itself says of its noise.

    exactly: as for teaching a goal, at rest and without what is drawn by chance: one image teaches
        it, and its noise would stay in it.
    """
    return _with_noise(eye.settings, experiment, exactly)


def drawn_settings(eye: Eye, experiment: Experiment, exactly: bool) -> dict[str, Any]:
    """The same of a camera whose images are rendered, to lie over the robot's description."""
    settings = _with_noise(eye.overrides, experiment, exactly)
    settings.pop("latency", None)  # the loop delays images by it, on every plant
    return settings


def _with_noise(
    settings: Mapping[str, Any], experiment: Experiment, exactly: bool
) -> dict[str, Any]:
    found = dict(settings)
    if exactly:
        found.pop("shake", None)
        effects = found.get("effects", {})
        found["effects"] = {k: v for k, v in effects.items() if k not in CHANCE}
    elif experiment.noise:
        found = merge(found, {"effects": {"noise_stddev": experiment.noise}})
    return found


def check_imaging(eye: Eye, experiment: Experiment) -> None:
    """ExperimentError where a setting of a camera has nothing to act on in an experiment."""
    plant, where = experiment.plant, f"camera '{eye.name}': "
    changed = _changed(eye.overrides)
    require(
        "link" not in changed and "trigger_topic" not in changed,
        f"{where}link and trigger_topic are for the ROS graph: the runner's cameras sit where the "
        "robot has them, and stream; leave them out",
    )
    for key in OVER_TIME:
        if plant == "ideal" and (time := getattr(config_of(eye.settings).effects, key)):
            raise ExperimentError(
                f"{where}has a {key} of {time:g} s, and plant ideal exposes all rows at once, in "
                f"an instant: take plant free, or leave {key} out"
            )
    if plant in FLYING and (moved := [key for key in IN_LINK if key in changed]):
        raise ExperimentError(
            f"{where}{' and '.join(moved)} move a sensor in its link, and the camera of plant "
            f"{plant} has none: for one that the controller believes elsewhere set believed"
        )
    if plant != "bullet" or not experiment.pictures:
        clipped = [key for key in RENDERED if key in changed]
        require(not clipped, f"{where}{' and '.join(clipped)} clip rendered images, which plant "
                f"{plant} makes with features: pictures alone, if it is bullet; leave them out")
    if not experiment.pictures:
        _check_exact(where, changed)


def _check_exact(where: str, changed: set[str]) -> None:
    """ExperimentError for settings of light where features are exact."""
    of_light = sorted(
        key for key in changed
        if key == "format" or key.startswith("effects.") and key[8:] not in ON_FEATURES
    )
    require(
        not of_light,
        f"{where}{', '.join(of_light)}: acts on the light of images, and exact features have none: "
        "set features: pictures, or leave it out (jitter is the noise of exact features)",
    )


def _changed(overrides: Mapping[str, Any]) -> set[str]:
    """The keys, those of effects as 'effects.KEY', whose values are not the defaults."""
    effects = overrides.get("effects", {})
    own = {key: value for key, value in overrides.items() if key != "effects"}
    found = {f.name for f in fields(CameraConfig)
             if f.name in own and _plain(own[f.name]) != _plain(f.default)}
    # How finely a time is divided matters only with that time.
    return found | {f"effects.{f.name}" for f in fields(Effects)
                    if f.name in effects and effects[f.name] != f.default
                    and f.name != "exposure_samples"}


def _plain(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value
