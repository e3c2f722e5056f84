"""Check that every setting of an experiment has an effect; a setting without effect is an error."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from aras_sim_bridge.camera.config import CameraConfig
from aras_sim_bridge.camera.effects import Effects
from aras_visual_servo_base.settings import get_default
from aras_visual_servo_controller.parameters import TRACKER_PARAMETERS
from aras_visual_servo_controller.settings import ControllerSettings

from ..errors import ExperimentError, require
from .cameras import CameraSetup
from .experiment import FREE_CAMERA_PLANTS, Experiment, IdealPlantSpec
from .loop_settings import FREE_CAMERA_SETTINGS

PARAMETERS = ControllerSettings.__dataclass_fields__
# Controller parameters that act only on the joints of an arm, and those that act on commanded
# coordinates, which plant 'ideal' does not have.
ARM_PARAMETERS = ("damping", "elbow", "joints", "singularity_avoidance", "stiffness")
COORDINATE_PARAMETERS = (
    "approach_speed", "hold_gain", "lag", "lead", "limit_avoidance", "lower", "output", "posture",
    "posture_gain", "start", "stop_time", "upper", "watchdog",
)  # fmt: skip
# Keys that act only on some plants. Each tuple contains the key, the plants on which it acts, the
# value that is accepted on other plants, and why it does not act on them, for the error message.
PLANT_SETTINGS = (
    ("friction", ("bullet",), True, "friction acts only on a simulation with physics"),
    ("lag", ("chain", "free"), 0.0, "lag acts only on joints without dynamics"),
    ("delay", ("bullet", "chain", "free"), 0.0, "delay is the time until a command takes effect, "
     "but plant ideal executes commands immediately"),
    ("commands", ("bullet", "chain", "free"), "images", "commands selects when commands are sent, "
     "but plant ideal executes one twist per image"),
    *((f"controller_parameters.{name}", ("bullet", "chain", "free"), None,
       f"{name} limits the joints, and plant ideal limits the speed of its camera by ideal.speed")
      for name in ("max_velocity", "max_acceleration")),
    *((f"controller_parameters.{name}", ("bullet", "chain", "free"), FREE_CAMERA_SETTINGS.get(name),
       f"{name} has no effect on plant ideal, whose camera executes each twist immediately and "
       "exactly") for name in COORDINATE_PARAMETERS),
    *((f"controller_parameters.{name}", ("bullet", "chain"), None,
       f"{name} is a parameter for the joints of an arm") for name in ARM_PARAMETERS),
    ("target.box", ("bullet",), None, "target.box is a body in a simulation with physics"),
    ("ideal", ("ideal",), IdealPlantSpec(), "ideal sets the properties of the ideal camera"),
)  # fmt: skip
# Settings that change images, but not features that are computed from the geometry.
IMAGE_SETTINGS = (
    "target.perturbed", "target.occluder", "target.marker", "sun",
    *(f"controller_parameters.{name}" for name in (
        "tracker", "tracker_options", "segmentation", "depth_image", *TRACKER_PARAMETERS)),
)  # fmt: skip
# Camera effects that also act on features that are computed from the geometry: the exposure times
# of image rows and the loss of images. All other effects change only grey levels.
FEATURE_EFFECTS = {"row_time", "rows_together", "drop_probability"}
# Keys of a robot that only say where files are, so that they are accepted on every plant.
FILE_SETTINGS = ("cameras", "search")
# Effects that plant 'ideal' does not have, because all pixels of its image are exposed at one
# instant.
TIMED_EFFECTS = ("row_time", "exposure_time")
LINK_OFFSETS = ("xyz", "rpy")
GRAPH_SETTINGS = ("link", "trigger_topic")


def check_settings(experiment: Experiment) -> None:
    """Check that every setting of an experiment has an effect.

    Raises:
        ExperimentError: a setting has no effect, because of the plant or because features are
            computed from true poses instead of images.
    """
    plain = Experiment()
    for key, plants, neutral, reason in PLANT_SETTINGS:
        require(
            experiment.plant in plants
            or _read_value(experiment, key) in (neutral, _read_value(plain, key)),
            f"{reason}: leave {key} out on plant '{experiment.plant}', or use plant "
            f"{' or '.join(plants)}",
        )
    for key in () if experiment.has_images else IMAGE_SETTINGS:
        require(
            _read_value(experiment, key) == _read_value(plain, key),
            f"{key} changes images, but exact features have none: set features to images, or leave "
            f"out {key}",
        )
    by_pose = not isinstance(experiment.start, str | tuple) and not isinstance(
        experiment.goal, tuple)
    require(
        experiment.plant not in FREE_CAMERA_PLANTS or not by_pose
        or not (any(experiment.camera_xyz) or any(experiment.camera_rpy)),
        f"camera_xyz and camera_rpy move the camera in its link, but plant '{experiment.plant}' "
        "has no links: change the poses start and goal instead, or set calibration_offset for an "
        "error of the controller's calibration",
    )
    robot_keys = [f"robot.{f.name}" for f in fields(plain.robot) if f.name not in FILE_SETTINGS
                  and getattr(experiment.robot, f.name) != f.default]  # fmt: skip
    require(
        experiment.plant not in FREE_CAMERA_PLANTS or not by_pose or not robot_keys,
        f"{', '.join(robot_keys)} set up an arm, but plant '{experiment.plant}' has no arm, and "
        "start and goal are poses of the camera: leave out robot, or use plant chain or bullet",
    )


def check_camera(camera: CameraSetup, experiment: Experiment) -> None:
    """Check that every setting of a camera has an effect in an experiment.

    Raises:
        ExperimentError: a setting has no effect, because of the plant or because features are
            computed from true poses instead of images.
    """
    plant, where = experiment.plant, f"camera '{camera.name}': "
    changed = _find_changed_keys(camera.overrides)
    graph_keys = [key for key in GRAPH_SETTINGS if key in changed]
    require(
        not graph_keys,
        f"{where}{' and '.join(graph_keys)} cannot be set in an experiment, where the robot "
        "description gives the camera's pose and the camera takes images continuously; leave out "
        f"{' and '.join(graph_keys)}",
    )
    for key in TIMED_EFFECTS:
        if plant == "ideal" and (time := getattr(camera.config.effects, key)):
            raise ExperimentError(
                f"{where}{key} is {time:g} s, but plant ideal exposes the whole image at one "
                f"instant: use plant free, or leave out {key}"
            )
    require(
        plant != "ideal" or "latency" not in changed,
        f"{where}latency cannot be set on plant ideal; use plant free, or leave out latency",
    )
    offsets = [key for key in LINK_OFFSETS if key in changed]
    require(
        plant == "bullet" and experiment.has_images or not offsets,
        f"{where}{' and '.join(offsets)} move the sensor in its link, which is possible only on "
        "plant bullet with images; for an error of the calibration, set calibration_offset",
    )
    if not experiment.has_images:
        image_keys = sorted(
            key for key in changed
            if key == "format" or key.startswith("effects.") and key[8:] not in FEATURE_EFFECTS
        )
        require(
            not image_keys,
            f"{where}{', '.join(image_keys)} cannot be set with exact features, which have no "
            "images; set features to images, or leave it out (exact features have jitter)",
        )


def _read_value(experiment: Experiment, key: str) -> Any:
    """Return the value of a dotted key; for a controller parameter that is not set, its default."""
    head, _, name = key.partition(".")
    if head == "controller_parameters":
        return experiment.controller_parameters.get(name, get_default(PARAMETERS[name]))
    value: Any = experiment
    for part in key.split("."):
        value = value.get(part) if isinstance(value, Mapping) else getattr(value, part)
    return value


def _find_changed_keys(overrides: Mapping[str, Any]) -> set[str]:
    """Return the keys of a camera whose values differ from their defaults.

    The key of a camera effect is returned as 'effects.KEY'.
    """
    effects = overrides.get("effects", {})
    found = {f.name for f in fields(CameraConfig)
             if f.name != "effects" and f.name in overrides
             and _to_plain(overrides[f.name]) != _to_plain(f.default)}  # fmt: skip
    # `exposure_samples` is always accepted: it only says into how many parts `exposure_time` is
    # divided, and `exposure_time` is checked itself.
    return found | {f"effects.{f.name}" for f in fields(Effects)
                    if f.name in effects and effects[f.name] != get_default(f)
                    and f.name != "exposure_samples"}  # fmt: skip


def _to_plain(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value
