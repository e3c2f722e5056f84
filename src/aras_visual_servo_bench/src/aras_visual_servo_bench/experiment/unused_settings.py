"""Settings that have nothing to act on in an experiment: each is refused in one line."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from aras_sim_bridge.camera.config import CameraConfig
from aras_sim_bridge.camera.effects import Effects
from aras_visual_servo_base.settings import get_default

from ..errors import ExperimentError, require
from .cameras import CameraSetup
from .experiment import FREE_CAMERA_PLANTS, Experiment, IdealSpec

# Keys of an experiment: the plants on which they act, the value that is true of the others all the
# same, and what they are of.
PLANT_SETTINGS = (
    ("friction", ("bullet",), True, "the friction of simulated joints"),
    ("lag", ("chain", "free"), 0.0, "of joints without dynamics"),
    ("delay", ("bullet", "chain", "free"), 0.0, "the time that an answer takes, and plant ideal "
     "answers each image at once"),
    ("commands", ("bullet", "chain", "free"), "images", "how commands are sent, and plant ideal "
     "moves by one twist an image"),
    ("target.box", ("bullet",), None, "a body in the simulated world"),
    ("ideal", ("ideal",), IdealSpec(), "how the ideal camera flies, and when its run ends"),
)  # fmt: skip
# What exact features do not show.
IMAGE_SETTINGS = ("target.perturbed", "target.occluder", "target.marker", "sun")
# Effects on exact features: when rows are exposed, and which images are lost. The others are on the
# light of an image.
FEATURE_EFFECTS = {"row_time", "rows_together", "drop_probability"}
# Keys of a robot that say where presets and packages are, also for a camera without an arm.
FILE_SETTINGS = ("cameras", "search")
# What the ideal camera, which sees at one instant, cannot have.
TIMED_EFFECTS = ("row_time", "exposure_time")
LINK_OFFSETS = ("xyz", "rpy")
GRAPH_SETTINGS = ("link", "trigger_topic")


def check_settings(experiment: Experiment) -> None:
    """ExperimentError where a setting of an experiment has nothing to act on."""
    plain = Experiment()
    for key, plants, neutral, what in PLANT_SETTINGS:
        require(
            experiment.plant in plants
            or _read_value(experiment, key) in (neutral, _read_value(plain, key)),
            f"{key} is {what}: leave it out on plant '{experiment.plant}', or take plant "
            f"{' or '.join(plants)}",
        )
    for key in () if experiment.has_images else IMAGE_SETTINGS:
        require(
            _read_value(experiment, key) == _read_value(plain, key),
            f"{key} changes images, and exact features have none: set features: images, or leave "
            "it out",
        )
    by_pose = not isinstance(experiment.start, str | tuple) and not isinstance(
        experiment.goal, tuple)
    require(
        experiment.plant not in FREE_CAMERA_PLANTS or not by_pose
        or not (any(experiment.camera_xyz) or any(experiment.camera_rpy)),
        f"camera_xyz and camera_rpy move the camera in its link, and plant '{experiment.plant}' "
        "has none: give start and goal where the camera is to be, or set believed for one that is "
        "believed elsewhere",
    )
    of_arm = [f"robot.{f.name}" for f in fields(plain.robot) if f.name not in FILE_SETTINGS
              and getattr(experiment.robot, f.name) != f.default]  # fmt: skip
    require(
        experiment.plant not in FREE_CAMERA_PLANTS or not by_pose or not of_arm,
        f"{', '.join(of_arm)}: plant '{experiment.plant}' has no arm, and start and goal are poses "
        "of the camera: leave robot out, or take plant chain or bullet",
    )


def check_camera(camera: CameraSetup, experiment: Experiment) -> None:
    """ExperimentError where a setting of a camera has nothing to act on in an experiment."""
    plant, where = experiment.plant, f"camera '{camera.name}': "
    changed = _find_changed_keys(camera.overrides)
    on_graph = [key for key in GRAPH_SETTINGS if key in changed]
    require(
        not on_graph,
        f"{where}{' and '.join(on_graph)}: for the ROS graph; the runner's cameras are where the "
        "robot has them, and stream; leave it out",
    )
    for key in TIMED_EFFECTS:
        if plant == "ideal" and (time := getattr(camera.config.effects, key)):
            raise ExperimentError(
                f"{where}has a {key} of {time:g} s, and plant ideal exposes all rows at once, in "
                f"an instant: take plant free, or leave {key} out"
            )
    require(
        plant != "ideal" or "latency" not in changed,
        f"{where}latency: plant ideal answers each image at once; take plant free, or leave it out",
    )
    moved = [key for key in LINK_OFFSETS if key in changed]
    require(
        plant == "bullet" and experiment.has_images or not moved,
        f"{where}{' and '.join(moved)}: moves the sensor of rendered images in its link; set "
        "believed for a camera that is not where the controller believes it",
    )
    if not experiment.has_images:
        of_light = sorted(
            key for key in changed
            if key == "format" or key.startswith("effects.") and key[8:] not in FEATURE_EFFECTS
        )
        require(
            not of_light,
            f"{where}{', '.join(of_light)}: acts on the light of images, and exact features have "
            "none: set features: images, or leave it out (jitter is the noise of exact features)",
        )


def _read_value(experiment: Experiment, key: str) -> Any:
    """What an experiment has under a dotted key."""
    value: Any = experiment
    for part in key.split("."):
        value = getattr(value, part)
    return value


def _find_changed_keys(overrides: Mapping[str, Any]) -> set[str]:
    """The keys, those of effects as 'effects.KEY', whose values are not the defaults."""
    effects = overrides.get("effects", {})
    found = {f.name for f in fields(CameraConfig)
             if f.name != "effects" and f.name in overrides
             and _to_plain(overrides[f.name]) != _to_plain(f.default)}  # fmt: skip
    # How finely an exposure is divided matters only where there is one.
    return found | {f"effects.{f.name}" for f in fields(Effects)
                    if f.name in effects and effects[f.name] != get_default(f)
                    and f.name != "exposure_samples"}  # fmt: skip


def _to_plain(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value
