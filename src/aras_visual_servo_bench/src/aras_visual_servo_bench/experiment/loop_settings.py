"""The loop of an experiment, made of the controller node's own Settings: it is the same loop."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from aras_visual_servo_base.urdf import read_robot_name
from aras_visual_servo_controller.errors import ConfigurationError
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.parameters import MARKER_TRACKER
from aras_visual_servo_controller.settings import Settings

from ..errors import ExperimentError, require
from ..targets.target_factory import find_tracker, is_solid
from ..targets.target_spec import TargetSpec
from .experiment import FREE_CAMERA_PLANTS, Experiment
from .packages import PackagePath
from .robots import ROBOT, Robot

# A camera without an arm has no limits to keep away from and no elbow.
FREE_CAMERA_SETTINGS: dict[str, Any] = {"limit_avoidance": False, "output": "velocity"}
# The ideal camera does at once what it is told, and its coordinates never wait for it.
IDEAL_CAMERA_SETTINGS: dict[str, Any] = {
    "delay": 0.0,
    "lockstep": False,
    "stop_time": 1e-6,
    "lead": 1e6,
}


def make_loop_settings(experiment: Experiment, robot: Robot | None = None) -> Settings:
    """The node's parameters that the experiment stands for.

    The plant stands at its start from the beginning, so the loop's own start is 'none'.

    Args:
        robot: read already; None: only scheme and law matter.

    Raises:
        ExperimentError: naming the parameter that is wrong.
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
    try:
        settings = Settings.from_mapping(given, package)
        if experiment.plant in FREE_CAMERA_PLANTS or robot is None:
            return settings
        return settings.for_robot(read_robot_name(robot.urdf), given)
    except ConfigurationError as error:
        raise ExperimentError(str(error)) from error


def _check_tracker(name: str, target: TargetSpec, other: TargetSpec) -> None:
    """ExperimentError where a camera's own target is not followed as the experiment's is."""
    own, one = find_tracker(other.shape), find_tracker(target.shape)
    require(own == one, f"cameras.{name}.target is followed by the tracker '{own}' and the "
            f"experiment's target by '{one}', and a loop has one: give both targets shapes of one "
            "kind, or controller_parameters.tracker")  # fmt: skip
    require(other.marker == target.marker,
            f"cameras.{name}.target.marker is {other.marker!r} and target.marker is "
            f"{target.marker!r}, and a loop follows one marker: give both the same")
    require(not is_solid(other.shape) or other.shape == target.shape,
            f"cameras.{name}.target is another solid than the experiment's target, and the tracker "
            "'model' follows one: give both the same shape, or a flat one")


def _make_tracker_settings(target: TargetSpec) -> dict[str, Any]:
    """What the tracker of a solid target is told: its mesh, and where it is about."""
    if not is_solid(target.shape):
        return {}
    # It is looked for where it is, or where the options say.
    mesh = str(target.placed_target.shape.path)
    return {"model": mesh, "model_start": {"pose": list(target.pose)}}


def load_named_goal(experiment: Experiment, settings: Settings) -> Goal:
    """The goal that is given by name or path; ConfigurationError where there is none."""
    start = experiment.start if isinstance(experiment.start, str) else "none"
    return dataclasses.replace(settings, desired=experiment.goal, start=start).load_goal()
