"""How the cameras of a run take their images, and what a goal is taught without."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from aras_sim_bridge.camera.config import seed_of
from aras_sim_bridge.camera.effects import EFFECTS, Effects
from aras_sim_bridge.camera.shaking import Vibration
from aras_sim_bridge.camera.shutter import parts
from aras_visual_servo_base.setting_values import merge
from aras_visual_servo_controller.seeing.observation import SEGMENTED, Need

from ..asked.cameras import Eye, config_of
from ..asked.experiment import Experiment
from ..asked.unused_settings import ON_FEATURES
from ..errors import ExperimentError
from ..plants.sight import Sight
from ..targets.target_spec import TargetSpec
from .setup_context import SetupContext

COLOUR = ("rgb", "bgr")  # encodings of pictures that without a renderer are grey
# Effects that are drawn by chance, which a goal is taught without.
CHANCE = {"noise_stddev", "shot_noise", "sensor", "drop_probability"}


def make_sight(context: SetupContext, eye: Eye, exactly: bool = False) -> Sight:
    """How a camera sees without a renderer; `exactly`: as for teaching a goal, without noise."""
    experiment, needs = context.experiment, context.needs.get(eye.name, frozenset())
    pictures = experiment.pictures and not (exactly and experiment.plant == "bullet")
    pictures = pictures or (exactly and Need.IMAGE in needs)
    target = context.targets[eye.name]
    on_it = TargetSpec() if eye.spec.target is not None else experiment.target
    if on_it.perturbed and not exactly:
        if not target.shape.is_textured:
            raise ExperimentError(
                f"target '{experiment.target.shape}' has no picture that could be perturbed: "
                "use poster or a PNG"
            )
        target = replace(target, shape=target.shape.perturbed(experiment.seed))
    config = eye.config
    if exactly or experiment.noise:
        config = config_of(with_noise(eye.settings, experiment, exactly))
    effects = config.effects
    if exactly:  # of one instant, as the camera is at rest
        effects = replace(effects, row_time=0.0, exposure_time=0.0)
    elif not pictures:  # of one instant for each row
        effects = Effects(**{key: getattr(effects, key) for key in ON_FEATURES})
    blind = None
    if config.cutoff_angle is not None:
        pixels = np.indices((config.height, config.width))[::-1].reshape(2, -1).T
        rays = config.model.unproject(pixels.astype(float))
        blind = ~np.isfinite(rays).all(axis=1).reshape(config.height, config.width)
    seed = eye.settings.get("seed", seed_of(experiment.seed, eye.name))
    vibration = None if config.shake is None else Vibration(config.shake, seed)
    encoding = "mono8" if config.encoding.startswith(COLOUR) else config.encoding
    return Sight(
        eye.true,
        target,
        eye.rate,
        pictures=pictures,
        effects=effects,
        seed=seed,
        encoding=encoding,
        jitter=0.0 if exactly else experiment.jitter,
        depth=context.depth or config.depth or Need.DEPTH in needs,
        labelled=bool(context.label and needs & SEGMENTED),
        occluder=on_it.occluder,
        occluded=() if exactly and on_it.occluded else on_it.occluded,
        unbounded=experiment.ideal.unbounded,
        name=eye.name,
        place=context.places.get(eye.name),
        parts=parts(effects, config.height),
        vibration=vibration,
        blind=blind,
        # As the experiment says it: the description's are of pictures that are rendered.
        clip=(config.near, config.far) if {"near", "far"} & set(eye.overrides) else None,
    )  # fmt: skip


def rendered_settings(context: SetupContext, eye: Eye, exactly: bool = False) -> dict[str, Any]:
    """Settings of a camera whose images are rendered, to lie over the robot's description."""
    settings = with_noise(eye.overrides, context.experiment, exactly)
    settings.pop("latency", None)  # the loop delays images by it, on every plant
    needs = context.needs.get(eye.name, frozenset())
    if context.depth or Need.DEPTH in needs:
        settings["depth"] = True
    if context.label and needs & SEGMENTED:
        settings["segmentation"] = True
    return settings


def with_noise(
    settings: Mapping[str, Any], experiment: Experiment, exactly: bool
) -> dict[str, Any]:
    """Settings of a camera with what the experiment itself says of its noise.

    exactly: as for teaching a goal, at rest and without what is drawn by chance: one image teaches
        it, and its noise would stay in it.
    """
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
