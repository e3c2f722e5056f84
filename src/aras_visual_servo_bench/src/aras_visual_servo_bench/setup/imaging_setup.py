"""Imaging settings of the cameras, with random effects for a run and without for teaching a goal.
"""

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
from .run_setup import RunSetup

# Prefixes of colour encodings. Without a renderer, a colour image is replaced by a grey one.
COLOUR_ENCODINGS = ("rgb", "bgr")
# Settings of random camera effects, which are switched off while a goal is taught.
RANDOM_SETTINGS = {"noise_stddev", "shot_noise", "sensor", "drop_probability"}


def make_imaging_settings(
    context: RunSetup, camera: CameraSetup, is_teaching: bool = False
) -> ImagingSettings:
    """Return the imaging settings of a camera whose features or images need no renderer.

    is_teaching: whether the image is for teaching a goal: noise, motion blur and occluder are then
        omitted.
    """
    experiment, needs = context.experiment, context.needs.get(camera.name, frozenset())
    has_images = experiment.has_images and not (is_teaching and experiment.plant == "bullet")
    has_images = has_images or (is_teaching and Need.IMAGE in needs)
    target = context.targets[camera.name]
    # The changed texture and the occluder belong to the experiment's target, not to a camera's own
    # target.
    spec = TargetSpec() if camera.spec.target is not None else experiment.target
    if spec.perturbed and not is_teaching:
        if not target.shape.is_textured:
            raise ExperimentError(
                f"target '{experiment.target.shape}' has no texture that could be perturbed: "
                "use poster or a PNG"
            )
        target = replace(target, shape=target.shape.perturb(experiment.seed))
    config = camera.config
    if is_teaching or experiment.noise:
        config = make_camera_config(with_noise(camera.settings, experiment, is_teaching))
    effects = config.effects
    if is_teaching:  # the camera is at rest, so a rolling shutter and motion blur have no effect
        effects = replace(effects, row_time=0.0, exposure_time=0.0)
    elif not has_images:  # without images, only the camera effects in FEATURE_EFFECTS apply
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
        has_images=has_images,
        effects=effects,
        seed=seed,
        encoding=encoding,
        jitter=0.0 if is_teaching else experiment.jitter,
        has_depth=context.has_depth or config.depth or Need.DEPTH in needs,
        has_labels=bool(context.labelled_link and needs & SEGMENTED),
        occluder=spec.occluder,
        occlusion_times=() if is_teaching and spec.occluded else spec.occluded,
        is_unbounded=experiment.ideal.unbounded,
        name=camera.name,
        placement=context.placements.get(camera.name),
        row_bands=make_row_bands(effects, config.height),
        vibration=vibration,
        blind_mask=blind,
        # Clipping planes that the experiment sets also apply to features and images that are
        # computed without a renderer. Clipping planes of the robot description apply only to
        # rendered images.
        depth_range=(config.near, config.far) if {"near", "far"} & set(camera.overrides) else None,
    )  # fmt: skip


def make_rendered_settings(
    context: RunSetup, camera: CameraSetup, is_teaching: bool = False
) -> dict[str, Any]:
    """Return the settings of a camera with rendered images, instead of those in the description.

    is_teaching: whether the image is for teaching a goal: random effects are then omitted.
    """
    settings = with_noise(camera.overrides, context.experiment, is_teaching)
    settings.pop("latency", None)  # the control loop delays the frames, on every plant
    needs = context.needs.get(camera.name, frozenset())
    if context.has_depth or Need.DEPTH in needs:
        settings["depth"] = True
    if context.labelled_link and needs & SEGMENTED:
        settings["segmentation"] = True
    return settings


def with_noise(
    settings: Mapping[str, Any], experiment: Experiment, is_teaching: bool
) -> dict[str, Any]:
    """Return camera settings with the noise of the experiment.

    is_teaching: whether the image is for teaching a goal. Shake and random effects are then removed
        and no noise is added, because the noise of this single image would remain in the goal.
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
