"""How the cameras of a run take their images, and what a goal is taught without."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from aras_sim_bridge.camera.config import derive_seed
from aras_sim_bridge.camera.effects import EFFECTS, Effects
from aras_sim_bridge.camera.shutter import make_row_bands
from aras_sim_bridge.camera.vibration import Vibration
from aras_visual_servo_base.setting_values import merge
from aras_visual_servo_controller.observation.observation import SEGMENTED, Need

from ..errors import ExperimentError
from ..experiment.cameras import CameraSetup, make_camera_config
from ..experiment.experiment import Experiment
from ..experiment.unused_settings import FEATURE_EFFECTS
from ..plants.imaging import ImagingSettings
from ..targets.target_spec import TargetSpec
from .setup_context import SetupContext

COLOUR_ENCODINGS = ("rgb", "bgr")  # encodings of pictures that without a renderer are grey
# Effects that are drawn by chance, which a goal is taught without.
RANDOM_SETTINGS = {"noise_stddev", "shot_noise", "sensor", "drop_probability"}


def make_imaging_settings(
    context: SetupContext, camera: CameraSetup, is_teaching: bool = False
) -> ImagingSettings:
    """How a camera sees without a renderer; `is_teaching`: as for teaching a goal, without noise.
    """
    experiment, needs = context.experiment, context.needs.get(camera.name, frozenset())
    pictures = experiment.has_images and not (is_teaching and experiment.plant == "bullet")
    pictures = pictures or (is_teaching and Need.IMAGE in needs)
    target = context.targets[camera.name]
    on_it = TargetSpec() if camera.spec.target is not None else experiment.target
    if on_it.perturbed and not is_teaching:
        if not target.shape.is_textured:
            raise ExperimentError(
                f"target '{experiment.target.shape}' has no picture that could be perturbed: "
                "use poster or a PNG"
            )
        target = replace(target, shape=target.shape.perturb(experiment.seed))
    config = camera.config
    if is_teaching or experiment.noise:
        config = make_camera_config(with_noise(camera.settings, experiment, is_teaching))
    effects = config.effects
    if is_teaching:  # of one instant, as the camera is at rest
        effects = replace(effects, row_time=0.0, exposure_time=0.0)
    elif not pictures:  # of one instant for each row
        effects = Effects(**{key: getattr(effects, key) for key in FEATURE_EFFECTS})
    blind = None
    if config.cutoff_angle is not None:
        pixels = np.indices((config.height, config.width))[::-1].reshape(2, -1).T
        rays = config.projection.unproject(pixels.astype(float))
        blind = ~np.isfinite(rays).all(axis=1).reshape(config.height, config.width)
    seed = camera.settings.get("seed", derive_seed(experiment.seed, camera.name))
    vibration = None if config.shake is None else Vibration(config.shake, seed)
    encoding = "mono8" if config.encoding.startswith(COLOUR_ENCODINGS) else config.encoding
    return ImagingSettings(
        camera.true_camera,
        target,
        camera.rate,
        has_images=pictures,
        effects=effects,
        seed=seed,
        encoding=encoding,
        jitter=0.0 if is_teaching else experiment.jitter,
        has_depth=context.has_depth or config.depth or Need.DEPTH in needs,
        has_labels=bool(context.labelled_link and needs & SEGMENTED),
        occluder=on_it.occluder,
        occlusion_times=() if is_teaching and on_it.occluded else on_it.occluded,
        is_unbounded=experiment.ideal.unbounded,
        name=camera.name,
        placement=context.placements.get(camera.name),
        row_bands=make_row_bands(effects, config.height),
        vibration=vibration,
        blind_mask=blind,
        # As the experiment says it: the description's are of pictures that are rendered.
        depth_range=(config.near, config.far) if {"near", "far"} & set(camera.overrides) else None,
    )  # fmt: skip


def make_rendered_settings(
    context: SetupContext, camera: CameraSetup, is_teaching: bool = False
) -> dict[str, Any]:
    """Settings of a camera whose images are rendered, to lie over the robot's description."""
    settings = with_noise(camera.overrides, context.experiment, is_teaching)
    settings.pop("latency", None)  # the loop delays images by it, on every plant
    needs = context.needs.get(camera.name, frozenset())
    if context.has_depth or Need.DEPTH in needs:
        settings["depth"] = True
    if context.labelled_link and needs & SEGMENTED:
        settings["segmentation"] = True
    return settings


def with_noise(
    settings: Mapping[str, Any], experiment: Experiment, is_teaching: bool
) -> dict[str, Any]:
    """Settings of a camera with what the experiment itself says of its noise.

    exactly: as for teaching a goal, at rest and without what is drawn by chance: one image teaches
        it, and its noise would stay in it.
    """
    found = dict(settings)
    if is_teaching:
        found.pop("shake", None)
        effects = found.get("effects", {})
        found["effects"] = {k: v for k, v in effects.items() if k not in RANDOM_SETTINGS}
        if further := effects.get("further"):
            steady = {k: v for k, v in further.items() if not EFFECTS.find(k).is_random}
            found["effects"]["further"] = steady
    elif experiment.noise:
        found = merge(found, {"effects": {"noise_stddev": experiment.noise}})
    return found
