"""How the cameras of an experiment take their images, and what a goal is taught without."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from aras_sim_bridge.camera.effects import EFFECTS
from aras_visual_servo_base.settings import merge

from .cameras import Eye
from .experiment import Experiment

# Effects that are drawn by chance, which a goal is taught without.
CHANCE = {"noise_stddev", "shot_noise", "sensor", "drop_probability"}
# Effects on exact features: when rows are exposed, and which images are lost. The others are on the
# light of an image.
ON_FEATURES = {"row_time", "rows_together", "drop_probability"}


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
        if further := effects.get("further"):
            steady = {k: v for k, v in further.items() if not EFFECTS.find(k).is_random}
            found["effects"]["further"] = steady
    elif experiment.noise:
        found = merge(found, {"effects": {"noise_stddev": experiment.noise}})
    return found
