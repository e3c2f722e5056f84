"""All settings files of the workspace treat equal values equally."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from aras_sim_bridge.camera import mounting
from aras_sim_bridge.control.pid import Pid
from aras_sim_bridge.errors import CameraError, ControllerError
from aras_sim_bridge.ros.runtime.node_parameters import NodeParameters as BridgeParameters
from aras_visual_servo_base.settings import build, list_defaults
from aras_visual_servo_base.yaml_files import parse_yaml
from aras_visual_servo_bench.errors import BenchError
from aras_visual_servo_bench.experiment.cameras import make_camera_model, read_preset
from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.experiment.overrides import parse_overrides
from aras_visual_servo_bench.experiment.packages import PackagePath
from aras_visual_servo_bench.ros.move_target import parse_motion
from aras_visual_servo_bench.studies.study import Study
from aras_visual_servo_camera.errors import VisionParameterError
from aras_visual_servo_camera.parameters import VisionParameters
from aras_visual_servo_controller.errors import ConfigurationError
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.goals.starts import find_start_joints
from aras_visual_servo_controller.kinematics import Arm
from aras_visual_servo_controller.settings import ControllerSettings
from aras_visual_servo_ros.parameters import InvalidParameterError

URDF = Path(__file__).parents[3] / "src/aras_visual_servo_gazebo/robots/aras_visual_servo.urdf"
JOINTS = "gantry: 0.1, J1: 0.0, J2: 0.17, J3: -0.09, J5: -0.09"
DIGITS = 5000 * "9"


@dataclass(frozen=True)
class Kind:
    """A kind of settings.

    load: reads them, of a text (`{}` stands for key: value) or of a file with it, and gives back
    the number. text: where the keys stand. number: a key that takes 0.5 and 10. truth: a key that
    takes true and false; '' where there is none. bounded: below 0 nothing fits. strict: a key that
    is not known is a fault. file: a file is read, else what a ROS parameter server holds, or words.
    """

    load: Callable[[Any], float]
    fault: type[Exception]
    number: str
    truth: str = ""
    text: str = "{}"
    bounded: bool = True
    strict: bool = True
    file: bool = True


def world_camera(values: dict[str, Any]) -> float:
    return mounting.configure_world_camera(
        "c", {**values, "parent": "world", "pose": "0 0 1 0 0 0"}, {}, 0
    )[0].latency


def world_preset(path: Path) -> float:
    settings = read_preset(str(path), PackagePath(), "aras_visual_servo_gazebo")
    make_camera_model(settings)
    return mounting.configure_world_camera(
        "c", {**settings, "parent": "world", "pose": [0.0] * 6}, {}, 0
    )[0].latency


def robot(path: Path) -> float:
    folder = path.parent / "config" / "robots"
    folder.mkdir(parents=True, exist_ok=True)
    if not (folder / "r.yaml").exists():
        (folder / "r.yaml").symlink_to(path)
    return ControllerSettings(package=path.parent).for_robot("r").gain


def starts(path: Path) -> float:
    (path.parent / "config").mkdir(exist_ok=True)
    (path.parent / "config" / "starts.yaml").symlink_to(path)
    return find_start_joints("s", Arm.from_urdf(URDF.read_text()), path.parent)[5]


def first_trial(path: Path) -> float:
    return Study.from_yaml(path).make_trials()[0].delay


KINDS = {
    "experiment": Kind(lambda path: Experiment.from_yaml(path).duration, BenchError, "duration",
                       "friction"),
    "part of an experiment": Kind(
        lambda path: Experiment.from_yaml(path).target.motion.frequency, BenchError,
        "target.motion.frequency", text="{{target: {{motion: {{{}}}}}}}",
    ),
    "target": Kind(lambda path: Experiment.from_yaml(path).target.size[0], BenchError,
                   "target.size[0]", text="target: {{ shape: square, pose: [0, 0, 0.6, 0, 0, 0], "
                                          "size: [{}, 0.1] }}"),
    "study": Kind(first_trial, BenchError, "delay", "friction",
                  "experiment: {{plant: chain, {}}}\nrepeats: 2"),
    "published study": Kind(first_trial, BenchError, "delay", "friction",
                            "source: here\nexperiment: {{plant: chain, {}}}"),
    "override": Kind(lambda values: Experiment.from_mapping(values).duration, BenchError,
                     "duration", "friction", file=False),
    "camera preset": Kind(world_preset, (BenchError, CameraError), "latency", "depth"),
    "camera of the world": Kind(world_camera, CameraError, "latency", "depth", file=False),
    "robot": Kind(robot, ConfigurationError, "gain", "limit_avoidance"),
    "goal": Kind(lambda path: Goal.load(path).depth, ConfigurationError, "depth"),
    "starts": Kind(starts, ConfigurationError, "s.J6", text=f"s: {{{{{JOINTS}, {{}}}}}}",
                   bounded=False, strict=False),
    "controller": Kind(lambda values: ControllerSettings.from_mapping(values).gain,
                       ConfigurationError, "gain", "autostart", file=False),
    "camera node": Kind(lambda values: VisionParameters.from_mapping(values).threshold,
                        VisionParameterError, "threshold", "dark_target", file=False),
    "bridge": Kind(lambda values: BridgeParameters.from_mapping(values, "/gazebo").real_time_factor,
                   InvalidParameterError, "real_time_factor", "gui", file=False),
    # As ros_control: who reads another's key is not known, and a gain may have either sign.
    "gains": Kind(lambda values: Pid.from_parameters({"p": 1.0, **values}, "/r/c/pid").gains.d,
                  ControllerError, "d", "antiwindup", bounded=False, strict=False, file=False),
}  # fmt: skip


@pytest.fixture(params=KINDS)
def kind(request) -> Kind:
    return KINDS[request.param]


def kinds(fits: Callable[[Kind], bool]) -> pytest.MarkDecorator:
    """Parametrise with the kinds that satisfy the condition."""
    return pytest.mark.parametrize("kind", [n for n in KINDS if fits(KINDS[n])], indirect=True)


@pytest.fixture
def answer(kind, tmp_path):
    """Reads settings with one key; its number."""

    def read(key: str, value: str) -> float:
        entry = value if "[{}" in kind.text else f"{key.rpartition('.')[2]}: {value}"
        text = kind.text.format(entry)
        if not kind.file:
            return kind.load(parse_yaml(text, "text", AssertionError))
        path = tmp_path / "mine.yaml"
        path.write_text(text)
        return kind.load(path)

    return read


def refused(kind: Kind, answer, key: str, value: str) -> str:
    with pytest.raises(kind.fault) as caught:
        answer(key, value)
    message = str(caught.value)
    assert "\n" not in message and len(message) < 400
    return message


@pytest.mark.parametrize(("text", "number"), [
    ("1e1", 10.0), ("1.0e+1", 10.0), ("+.5", 0.5), ("5e-1", 0.5),
])  # fmt: skip
def test_numbers_are_taken_however_they_are_written(kind, answer, text, number):
    if kind is KINDS["target"] and number == 10.0:
        assert "is 10.0, must be <= 2 m" in refused(kind, answer, kind.number, text)
    else:
        assert answer(kind.number, text) == number


@pytest.mark.parametrize(("text", "said"), [
    ("true", "True"), ("yes", "True"), ("high", "'high'"), ('"3"', "'3'"), (".nan", "nan"),
    (".inf", "inf"), ("1e999", "'1e999'"), ("[1]", "[1]"),
])  # fmt: skip
def test_what_is_no_number_is_refused_in_the_same_words(kind, answer, text, said):
    message = refused(kind, answer, kind.number, text)
    assert f"{kind.number} is {said}, must be a finite number" in message


@kinds(lambda kind: bool(kind.truth))
@pytest.mark.parametrize(("text", "works"), [
    ("true", True), ("yes", True), ("off", True), ("1", False), ('"true"', False), ("1e1", False),
])  # fmt: skip
def test_truth_values_are_true_and_false_alone(kind, answer, text, works):
    if works:
        answer(kind.truth, text)
    else:
        message = refused(kind, answer, kind.truth, text)
        assert f"{kind.truth} is " in message and "must be true or false" in message


@kinds(lambda kind: kind.strict and kind is not KINDS["target"])
def test_a_key_that_is_misspelt_is_answered_with_the_nearest(kind, answer):
    path, _, key = kind.number.rpartition(".")
    near = key[:-2] + key[-1] + key[-2]
    message = refused(kind, answer, f"{path}.{near}", "1.0")
    assert re.search(rf"unknown (key '(\w+\.)*|parameter [~/\w]*){near}'?: did you mean '{key}'",
                     message)  # fmt: skip


@kinds(lambda kind: kind.bounded)
def test_what_is_out_of_range_is_refused_with_the_bound(kind, answer):
    message = refused(kind, answer, kind.number, "-1")
    assert re.search(rf"{re.escape(kind.number)} is -1.0, must be >=? \d", message)


def test_words_of_a_command_line_are_read_like_files():
    assert parse_motion(["circle=1e-1", "frequency=.5"]).circle == 0.1
    with pytest.raises(BenchError, match="motion.circle is 'wide', must be a finite number"):
        parse_motion(["circle=wide"])
    with pytest.raises(BenchError, match="the value of 'gain' is not valid YAML: Exceeds"):
        parse_overrides([f"gain={DIGITS}"])


@pytest.mark.parametrize(
    "cls", [Experiment, Study, ControllerSettings, VisionParameters, BridgeParameters]
)
def test_the_defaults_are_values_that_may_be_given(cls):
    assert build(cls, list_defaults(cls), "", AssertionError) == cls()
