"""Recorded run in a bag: settings, goal, joint limits, and an experiment that repeats the run."""

from __future__ import annotations

import contextlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from aras_visual_servo_base.yaml_files import parse_yaml, read_yaml
from aras_visual_servo_controller.errors import ServoError
from aras_visual_servo_controller.features.base import DepthRelativeTolerance
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.kinematics import Arm
from aras_visual_servo_controller.settings import ControllerSettings

from ..errors import BenchError, ExperimentError
from ..experiment.experiment import Experiment
from ..experiment.packages import PackagePath
from ..experiment.refused_parameters import EXPERIMENT_KEYS, GRAPH_PARAMETERS
from ..experiment.robot_spec import RobotSpec
from .ros_parameters import find_branch
from .run_recorder import describe_settings

# Parameters of the controller node that are not copied to `controller_parameters`, because an
# experiment sets them by another key, or does not have them.
OWN_KEYS = {*EXPERIMENT_KEYS, *GRAPH_PARAMETERS, "start", "package", "gains"}
GOAL_FILE = re.compile(r"\w[\w .-]*\.ya?ml")  # name of a goal file, without a folder
DEFAULT_DURATION = 8.0  # duration of an experiment if the controller node had none, s


def find_preset(settings: Mapping[str, Any]) -> str | dict[str, Any]:
    """Return the name of the camera preset with these settings, or else the settings themselves."""
    folder = Path(PackagePath().find(RobotSpec().cameras)) / "config" / "cameras"
    for file in sorted(folder.glob("*.yaml")):
        if read_yaml(file, ExperimentError) == dict(settings):
            return file.stem
    return dict(settings) if settings else "original"


@dataclass
class RecordedExperiment:
    """Description of a run that was recorded in its bag.

    A property is None or empty if its data cannot be read.

    Attributes:
        content: content of the recorded message; empty if the bag has no such message.
        notes: reasons why data cannot be read.
    """

    content: Mapping[str, Any] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    @classmethod
    def from_text(cls, text: str) -> RecordedExperiment:
        """Read the JSON text of the recorded message; '' if the bag has no such message."""
        if not text:
            return cls({}, [
                "the bag is from an older version or from another recorder: its goal, limits and "
                "settings are unknown (no topic .../experiment)"
            ])  # fmt: skip
        try:
            content = json.loads(text)
            parameters = content.get("parameters") if isinstance(content, Mapping) else None
            if not isinstance(parameters, Mapping):
                raise ValueError("there are no parameters of the ROS graph; record the run again")
            for key, kind in (("goals", dict), ("versions", dict), ("launch", list)):
                if not isinstance(content.get(key, kind()), kind):
                    kind_name = "list" if kind is list else "mapping"
                    raise ValueError(f"the entry '{key}' is not a {kind_name}")
        except ValueError as error:
            return cls({}, [f"the bag's description of its run cannot be read: {error}"])
        return cls(content)

    @cached_property
    def controller(self) -> dict[str, Any]:
        """Parameters of the controller node."""
        parameters = find_branch(
            self.content.get("parameters", {}), self.content.get("controller", "")
        )
        # The node has no parameter `gains`; dynamic_reconfigure adds it to the node's parameters.
        parameters.pop("gains", None)
        return parameters

    @cached_property
    def urdf(self) -> str:
        """Robot description as text; '' if it was not recorded."""
        name = str(self.controller.get("description", "robot_description"))
        return str(self.content.get("parameters", {}).get(name, ""))

    @cached_property
    def settings(self) -> ControllerSettings | None:
        """Settings of the control loop in the recorded controller node."""
        if not self.content:
            return None
        from aras_visual_servo_base.urdf import read_robot_name

        package = Path(PackagePath().find("aras_visual_servo_controller"))
        with self._note_errors("the recorded parameters cannot be used"):
            settings = ControllerSettings.from_mapping(self.controller, package)
            return settings.for_robot(read_robot_name(self.urdf), self.controller)
        return None

    @cached_property
    def arm(self) -> Arm | None:
        """Kinematics of the recorded robot description."""
        if self.settings is None or not self.urdf:
            return None
        with self._note_errors("the recorded description cannot be used"):
            return self.settings.make_arm(self.urdf)
        return None

    @cached_property
    def goal(self) -> Goal | None:
        """Goal of the control loop; missing joints, or a missing pose, are computed from the other.
        """
        if self.settings is None:
            return None
        name = self.settings.find_goal_file().name
        text = self.content.get("goals", {}).get(name)
        if text is None:
            self.notes.append(f"the goal {name} was not recorded")
            return None
        with self._note_errors("the recorded goal cannot be used"):
            goal = Goal.from_mapping(parse_yaml(text, name, ExperimentError), name)
            return goal if self.arm is None else goal.for_arm(self.arm)
        return None

    def read_limits(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the lower, upper and speed limits of the joints (rad or m; rad/s or m/s).

        The arrays are empty if the limits are unknown."""
        if self.arm is None:
            return (np.zeros(0),) * 3
        with self._note_errors("the recorded limits cannot be used"):
            limits = self.settings.make_limits(self.arm)
            return limits.lower, limits.upper, limits.velocity
        return (np.zeros(0),) * 3

    def read_features(self, scheme: str, count: int) -> tuple[tuple[str, ...], tuple[float, ...]]:
        """Return the units and the tolerances of the features of a scheme; empty if unknown.

        Args:
            scheme: name of the scheme.
            count: number of features in the bag."""
        settings = self.settings or ControllerSettings()
        with self._note_errors("units of the features are unknown"):
            instance = settings.make_scheme() if settings.scheme == scheme else \
                ControllerSettings(scheme=scheme).make_scheme()
            if self.goal is not None:
                instance.check(self.goal)
            if len(instance.units) == count:
                known = not any(isinstance(t, DepthRelativeTolerance) for t in instance.tolerances)
                return tuple(instance.units), tuple(instance.tolerances) if known else ()
            self.notes.append(
                f"units of the features are unknown: scheme '{scheme}' has other features than in "
                "the bag"
            )
        return (), ()

    @contextlib.contextmanager
    def _note_errors(self, what: str):
        """Add a note that starts with `what` if the `with` block raises an error."""
        try:
            yield
        except (ServoError, BenchError, ValueError, TypeError) as error:
            self.notes.append(f"{what}: {error}")

    @property
    def arguments(self) -> dict[str, str]:
        """Launch arguments of all roslaunch commands; a later command overrides earlier ones."""
        words = [word for launch in self.content.get("launch", []) for word in launch]
        return dict(word.split(":=", 1) for word in words if ":=" in word)

    def make_experiment(self) -> Experiment:
        """Make an experiment that repeats the recorded run without a ROS graph.

        Raises:
            BenchError: the bag has no description, or the run cannot be repeated.
        """
        if not self.content:
            raise BenchError(self.notes[0])
        try:
            return Experiment.from_mapping(self._make_keys())
        except ExperimentError as error:
            raise BenchError(
                f"the bag's run cannot be repeated as an experiment: {error}"
            ) from error

    def make_mapping(self) -> dict[str, Any]:
        """Return the keys and values of the experiment, after checking that they are valid.

        Raises:
            BenchError: the bag has no description, or the run cannot be repeated.
        """
        self.make_experiment()
        return self._make_keys()

    def collect_files(self) -> dict[str, str]:
        """Return the content of the run's files, by file name.

        The files are the goals, the parameters, the robot description, the launch commands and the
        software versions. A goal whose name is not a file name is omitted, and a note is added.
        """
        launch = "".join(f"roslaunch {' '.join(map(str, words))}\n"
                         for words in self.content.get("launch", []))  # fmt: skip
        parameters = dict(self.content.get("parameters", {}))
        versions, goals = self.content.get("versions", {}), {}
        for name, text in self.content.get("goals", {}).items():
            if GOAL_FILE.fullmatch(name):
                goals[name] = str(text)
            else:
                self.notes.append(f"the goal {name[:80]!r} is omitted: it is not a file name")
        return {
            **goals,
            "parameters.yaml": yaml.safe_dump(parameters, sort_keys=False),
            "robot.urdf": self.urdf,
            "launch.txt": launch,
            "versions.txt": "".join(f"{name} {value}\n" for name, value in versions.items()),
        }

    def _make_keys(self) -> dict[str, Any]:
        """Return the keys and values of the experiment that are known from the recording."""
        loop, launch = self.controller, self.arguments
        simulator = find_branch(self.content["parameters"], "/gazebo")
        keys: dict[str, Any] = {"scheme": loop.get("scheme", "moments")}
        keys.update({k: loop[k] for k in ("law", "gain", "start") if loop.get(k) not in (None, "")})
        if loop.get("desired", "auto") != "auto":
            keys["goal"] = loop["desired"]
        start = keys.get("start")
        if isinstance(start, str) and len(start.split()) > 1:
            keys["start"] = [float(number) for number in start.split()]
        elif start is not None and not isinstance(start, (list, Mapping)):
            keys["start"] = str(start)
        cameras = find_branch(simulator, "cameras/labrob")
        keys["camera"] = launch.get("camera") or find_preset(next(iter(cameras.values()), {}))
        for key in ("camera_xyz", "camera_rpy"):
            if launch.get(key):
                keys[key] = [float(number) for number in launch[key].split()]
        if launch.get("hand_eye"):
            parts = {"file": "hand_eye", "units": "hand_eye_units", "link": "hand_eye_link"}
            keys["hand_eye"] = {key: launch[arg] for key, arg in parts.items() if launch.get(arg)}
        if launch.get("joint_friction", "true").lower() == "false":
            keys["friction"] = False
        if "urdf" in launch or "gains" in launch:
            keys["robot"] = {k: launch[a] for k, a in (("urdf", "urdf"), ("config", "gains"))
                             if a in launch}  # fmt: skip
        for name in ("camera_frame", "target_frame"):
            if loop.get(name, "") not in ("", getattr(RobotSpec, name)):
                keys["robot"] = {**keys.get("robot", {}), name: loop[name]}
        keys["seed"] = int(simulator.get("seed", 0))
        keys["duration"] = float(loop.get("duration") or DEFAULT_DURATION)
        parameters = {k: v for k, v in loop.items() if k not in OWN_KEYS}
        return {**keys, "controller_parameters": parameters} if parameters else keys

    def make_yaml(self) -> str:
        """Return the experiment as YAML; '' if the run cannot be repeated."""
        try:
            keys = self.make_mapping()
        except BenchError as error:
            if self.content:
                self.notes.append(str(error))
            return ""
        return yaml.safe_dump(keys, sort_keys=False, default_flow_style=None)

    def describe_settings(self) -> dict[str, str]:
        """Return the main settings as text, by name, for a report."""
        try:
            settings = describe_settings(self.make_experiment())
        except BenchError:
            return {k: str(self.controller[k]) for k in ("scheme", "law", "start")
                    if k in self.controller}  # fmt: skip
        keys = ("scheme", "law", "gain", "start", "goal", "camera", "seed")
        settings = {key: settings[key] for key in keys if key in settings}
        launch = self.arguments
        moved = {k: launch[k] for k in ("camera_xyz", "camera_rpy", "hand_eye") if launch.get(k)}
        command = "; ".join(" ".join(words) for words in self.content.get("launch", []))
        return {**settings, **moved, **({"launched by": command} if command else {})}
