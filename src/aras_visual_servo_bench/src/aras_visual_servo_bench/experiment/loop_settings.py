"""Settings of the control loop of an experiment, as parameters of the controller node."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from aras_visual_servo_base.urdf import read_robot_name
from aras_visual_servo_controller.errors import ConfigurationError
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.parameters import MARKER_TRACKER
from aras_visual_servo_controller.settings import ControllerSettings

from ..errors import catch_setting_errors, require
from ..targets.target_factory import find_tracker, is_solid
from ..targets.target_spec import TargetSpec
from .experiment import FREE_CAMERA_PLANTS, Experiment
from .packages import PackagePath
from .robots import ROBOT, Robot

# A camera without an arm has no joint limits to avoid, and its command is a velocity.
FREE_CAMERA_SETTINGS: dict[str, Any] = {"limit_avoidance": False, "output": "velocity"}
# The ideal camera executes each command without delay. The parameter `lead` limits the distance
# between commanded and measured coordinates; 1e6 switches the limit off.
IDEAL_CAMERA_SETTINGS: dict[str, Any] = {
    "delay": 0.0, "lockstep": False, "stop_time": 1e-6, "lead": 1e6,
}  # fmt: skip


def make_loop_settings(experiment: Experiment, robot: Robot | None = None) -> ControllerSettings:
    """Return the parameters of the controller node for an experiment.

    The parameter `start` is 'none', because the plant already is at its start.

    Args:
        robot: robot of the experiment; None if only the scheme and the law are needed.

    Raises:
        ExperimentError: a parameter is wrong; the message names it.
    """
    packages = robot.packages if robot is not None else PackagePath(experiment.robot.search)
    package = Path(packages.find("aras_visual_servo_controller"))
    given = {
        "scheme": experiment.scheme,
        "law": experiment.law,
        "delay": experiment.delay,
        "duration": experiment.duration,
        "start": "none",
        "lockstep": experiment.commands == "images",
        "tracker": MARKER_TRACKER
        if experiment.target.marker
        else find_tracker(experiment.target.shape),
        "marker": experiment.target.marker,
        **_make_tracker_settings(experiment.target),
        "cameras": {
            name: {"frame": name, "target_frame": camera.target_frame}
            for name, camera in experiment.cameras.items()
        },
        **(FREE_CAMERA_SETTINGS if experiment.plant in FREE_CAMERA_PLANTS else {}),
        **(IDEAL_CAMERA_SETTINGS if experiment.plant == "ideal" else {}),
        **experiment.controller_parameters,
    }
    if experiment.gain is not None:
        given["gain"] = experiment.gain
    if experiment.target.is_link and isinstance(given.get("segmentation"), Mapping):
        model = experiment.target.model or ROBOT
        name = f"{model}::{experiment.target.link}".removesuffix("::")
        given["segmentation"] = {"label": name, **given["segmentation"]}
    for name, camera in experiment.cameras.items():
        if camera.target is not None and "tracker" not in experiment.controller_parameters:
            _check_tracker(name, experiment.target, camera.target)
    with catch_setting_errors(ConfigurationError):
        settings = ControllerSettings.from_mapping(given, package)
        if experiment.plant in FREE_CAMERA_PLANTS or robot is None:
            return settings
        return settings.for_robot(read_robot_name(robot.urdf), given)


def _check_tracker(name: str, target: TargetSpec, other: TargetSpec) -> None:
    """Check that one tracker can track both a camera's own target and the experiment's.

    Raises:
        ExperimentError: the two targets need different trackers, or one tracker with different
            settings.
    """
    own_tracker, tracker = find_tracker(other.shape), find_tracker(target.shape)
    require(own_tracker == tracker,
            f"cameras.{name}.target needs the tracker '{own_tracker}' and the experiment's target "
            f"the tracker '{tracker}', but a loop has only one tracker: give both targets shapes "
            "of one kind, or set controller_parameters.tracker")
    require(other.marker == target.marker,
            f"cameras.{name}.target.marker is {other.marker!r} and target.marker is "
            f"{target.marker!r}, but a loop tracks only one marker: give both the same")
    require(not is_solid(other.shape) or other.shape == target.shape,
            f"cameras.{name}.target is another solid than the experiment's target, but the tracker "
            "'model' tracks only one solid: give both targets the same shape, or cameras."
            f"{name}.target a flat shape")


def _make_tracker_settings(target: TargetSpec) -> dict[str, Any]:
    """Return the tracker settings for a solid target: its mesh and its initial pose."""
    if not is_solid(target.shape):
        return {}
    # The tracker starts its search at the pose in `model_start`, here the target's true pose;
    # `controller_parameters` can set another pose.
    mesh = str(target.placed_target.shape.path)
    return {"model": mesh, "model_start": {"pose": list(target.pose)}}


def load_named_goal(experiment: Experiment, settings: ControllerSettings) -> Goal:
    """Load the goal that the experiment gives by name or path.

    Raises:
        ConfigurationError: there is no such goal.
    """
    start = experiment.start if isinstance(experiment.start, str) else "none"
    return dataclasses.replace(settings, desired=experiment.goal, start=start).load_goal()
