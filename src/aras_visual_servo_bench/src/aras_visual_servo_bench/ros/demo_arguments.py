"""Command line of the demo. It is checked before any process is started."""

from __future__ import annotations

import argparse
import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from aras_visual_servo_base import safe_xml
from aras_visual_servo_base.names import suggest
from aras_visual_servo_base.poses import xyz_rpy_from_matrix
from aras_visual_servo_controller.errors import ConfigurationError
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.settings import ControllerSettings

from ..errors import ExperimentError
from ..experiment.camera_specs import HandEyeSpec
from ..experiment.cameras import read_preset
from ..experiment.experiment import CameraPoseSpec, Experiment
from ..experiment.packages import PackagePath
from ..experiment.robot_spec import RobotSpec
from ..experiment.robots import Robot
from ..targets.shapes import SHAPES
from ..targets.target_factory import find_default_size, find_tracker
from ..targets.target_spec import TargetSpec

LAUNCH_FOLDER = "package://aras_visual_servo_gazebo/launch/"
# For each launch file, the arguments that the demo or its options set.
LAUNCH_FILES = {
    "aras_visual_servo.launch": {
        "camera", "camera_xyz", "camera_rpy", "urdf", "target", "target_size", "show_rviz",
        "record", "bag", "server_required",
    },
    "aras_visual_servo_nodes.launch": {"scheme", "law", "gain", "start", "goal", "desired"},
}  # fmt: skip
PLATES, NO_TARGET = "aras", "none"
# Pose of the target in the world, x, y, z (m), roll, pitch, yaw (rad); equal to the argument
# target_place of the launch file.
TARGET_POSE = (0.0, 0.0, 0.591, 0.0, 0.0, 0.0)
DEFAULT_ROBOT = RobotSpec()


def parse(argv: list[str] | None) -> argparse.Namespace:
    """Parse and check the command line.

    Returns:
        The options, with three more attributes:
            further: the further arguments of each launch file,
            taught: goal that was computed for the selected target; None if a stored goal is used,
            tracker: name of the tracker of the target.
    """
    parser = argparse.ArgumentParser(
        prog="demo", description="Servo the ARAS robot to its target and write a report.",
        epilog="example: ./demo.sh --scheme points --start 2015 --out out/points",
    )
    _add_loop_options(parser)
    _add_world_options(parser)
    parser.add_argument(
        "--out",
        type=_parse_folder,
        default=Path("out"),
        help="output folder (default out/)",
    )
    parser.add_argument("--rviz", action="store_true", help="show rviz (needs a display)")
    parser.add_argument(
        "--timeout", type=float, default=20.0, help="limit of simulated time, s (default 20)"
    )
    parser.add_argument(
        "launch", nargs="*", metavar="NAME:=VALUE",
        help="further argument of aras_visual_servo.launch or aras_visual_servo_nodes.launch, for "
             "example gains:=/my/controllers.yaml",
    )
    arguments = parser.parse_args(argv)
    try:
        _check(arguments)
    except (ConfigurationError, ExperimentError) as error:
        parser.error(str(error))
    if arguments.rviz and not os.environ.get("DISPLAY"):
        print("demo: --rviz needs a display, but DISPLAY is not set: continuing without rviz",
              file=sys.stderr)  # fmt: skip
        arguments.rviz = False
    if not arguments.timeout > 0.0:
        parser.error(f"--timeout must be above 0, not {arguments.timeout}")
    return arguments


def _add_loop_options(parser: argparse.ArgumentParser) -> None:
    """Add the options for the scheme, the law, the gain, the start and the goal."""
    parser.add_argument(
        "--scheme", default="moments",
        help="name of a feature or scheme (default moments), several names joined by +, or your "
             "own package.module:Class on PYTHONPATH; an unknown name lists all",
    )
    parser.add_argument(
        "--start", default="2016",
        help="initial pose: 2015, 2016 (default), positions of gantry (m), J1, J2, J3, "
             "J5, J6 (rad) such as '0.1 0 0.17 -0.09 -0.09 2.09', or none for the "
             "current pose; for another robot the positions of its joints",
    )
    parser.add_argument(
        "--goal", default="auto", help="2015, 2016, or a goal's YAML file (default: the goal of "
        "the start)",
    )
    parser.add_argument(
        "--law", default="", help="name of a control law (default proportional), or "
        "package.module:Class; an unknown name lists all",
    )
    parser.add_argument(
        "--gain", type=_parse_gain, help="gain of the law, 1/s (default: that of the controller)"
    )


def _add_world_options(parser: argparse.ArgumentParser) -> None:
    """Add the options for the target, the robot and the camera."""
    parser.add_argument(
        "--target", default=PLATES, help="target on the table: aras (default, the plates of the "
        "laboratory), another name in targets/, an image file, an SVG outline, a URDF, or none; "
        "unless --goal is a file, the goal is taught from the camera pose of goal 2016 or 2015",
    )
    parser.add_argument(
        "--target-size",
        type=_parse_size,
        metavar="'X Y'",
        help="size of the target along x and y, m (default: its usual size)",
    )
    parser.add_argument(
        "--urdf", type=_parse_file, help="robot description (default: the ARAS robot); for another "
        "arm, also give robot, gains and controllers as NAME:=VALUE",
    )
    parser.add_argument("--camera", default="original", help="name of a camera preset, "
                        "or path of a preset or a calibration (default original)")  # fmt: skip
    for part, unit in (("xyz", "m"), ("rpy", "rad")):
        parser.add_argument(
            f"--camera-{part}", type=_parse_vector, metavar="'0 0 0'",
            help=f"pose of the camera in camera_link: {part}, {unit} (default: 0 0 0)",
        )


def _check(arguments: argparse.Namespace) -> None:
    """Check the options, so that roslaunch or a node does not reject them later.

    The attributes `further`, `tracker` and `taught` are added.

    Raises:
        ConfigurationError, ExperimentError: an option is invalid.
    """
    arguments.further = _parse_launch_arguments(arguments.launch)
    _check_start(arguments.start, arguments.urdf is not None)
    packages = PackagePath()
    read_preset(arguments.camera, packages, DEFAULT_ROBOT.cameras)
    if Path(arguments.camera).suffix:
        arguments.camera = str(Path(arguments.camera).expanduser().resolve())
    arguments.target = _parse_target(arguments.target)
    arguments.tracker = find_tracker(arguments.target)
    parameters = {"scheme": arguments.scheme, "desired": arguments.goal, "start": arguments.start}
    for name in ("law", "gain", "tracker"):
        if value := getattr(arguments, name):
            parameters[name] = value
    package = Path(packages.find("aras_visual_servo_controller"))
    settings = ControllerSettings.from_mapping(parameters, package)
    settings.make_scheme()
    goal = settings.load_goal()
    has_goal = arguments.target in (PLATES, NO_TARGET) or arguments.target.endswith(
        (".urdf", ".xml")
    )
    is_goal_file = Path(arguments.goal).suffix != ""
    arguments.taught = None if is_goal_file or has_goal else _teach_goal(arguments, goal)


def _parse_launch_arguments(arguments: list[str]) -> dict[str, dict[str, str]]:
    """Return, for each launch file, the values of its further arguments by name.

    arguments: words NAME:=VALUE of the command line.

    Raises:
        ExperimentError: a word has another form, or its name is unknown or set by the demo.
    """
    declared = {
        file: _read_argument_names(file) - options for file, options in LAUNCH_FILES.items()
    }
    all_names = sorted(set().union(*declared.values()))
    found: dict[str, dict[str, str]] = {file: {} for file in LAUNCH_FILES}
    for word in arguments:
        name, separator, value = word.partition(":=")
        if not separator:
            raise ExperimentError(f"'{word}' is not an argument: use NAME:=VALUE, or see --help")
        if any(name in options for options in LAUNCH_FILES.values()):
            raise ExperimentError(
                f"{name}:= is set by an option or by the demo itself; see the options in --help"
            )
        if name not in all_names:
            raise ExperimentError(f"the launch files have no argument '{name}': "
                                  f"{suggest(name, all_names)}")  # fmt: skip
        for file, names in declared.items():
            if name in names:
                found[file][name] = value
    return found


def _read_argument_names(file: str) -> set[str]:
    """Return the names of a launch file's arguments."""
    path = Path(PackagePath().resolve(LAUNCH_FOLDER + file))
    root = safe_xml.parse(path.read_text(encoding="utf-8"), str(path))
    return {argument.attrib["name"] for argument in root.findall("arg")}


def _parse_target(text: str) -> str:
    """Return the name of a target, or the absolute path of its file.

    Raises:
        ExperimentError: the name is unknown, or the file does not exist.
    """
    path = Path(text).expanduser()
    if text in (*SHAPES, NO_TARGET):
        return text
    if not path.suffix:
        raise ExperimentError(
            f"--target is '{text}', which is not a target: {suggest(text, (*SHAPES, NO_TARGET))}"
        )
    if not path.is_file():
        raise ExperimentError(f"--target: there is no file {path}")
    return str(path.resolve())


def _teach_goal(arguments: argparse.Namespace, goal: Goal) -> Goal:
    """Teach a goal for the target that the options select, at the camera pose of another goal.

    Args:
        arguments: options of the demo.
        goal: goal that gives the camera pose.

    Raises:
        ExperimentError: the scheme cannot servo to this view.
    """
    # this import takes 1 s, and few calls of the demo need it
    from ..setup.assembly import assemble

    size = find_default_size(arguments.target)
    if arguments.target_size:
        size = tuple(map(float, arguments.target_size.split()))
    camera_offset = {
        name: tuple(map(float, (getattr(arguments, name) or "0 0 0").split()))
        for name in ("camera_xyz", "camera_rpy")
    }
    further = arguments.further["aras_visual_servo.launch"]
    spec = replace(
        DEFAULT_ROBOT,
        urdf=str(arguments.urdf or DEFAULT_ROBOT.urdf),
        config=further.get("gains", DEFAULT_ROBOT.config),
    )
    hand_eye = None
    if further.get("hand_eye"):
        hand_eye = HandEyeSpec(
            further["hand_eye"], further.get("hand_eye_units", ""), further.get("hand_eye_link", "")
        )
    robot = Robot(spec, *camera_offset.values(), hand_eye=hand_eye)
    xyz, rpy = xyz_rpy_from_matrix(goal.for_arm(robot.make_arm()).world_T_camera)
    experiment = Experiment(
        robot=spec, target=TargetSpec(arguments.target, size, TARGET_POSE), camera=arguments.camera,
        goal=CameraPoseSpec((*xyz, *rpy)), start=CameraPoseSpec((*xyz, *rpy)),
        scheme=arguments.scheme, hand_eye=hand_eye, **camera_offset,
    )  # fmt: skip
    parts = assemble(experiment)
    parts.plant.close()
    return parts.goal


def _parse_numbers(text: str, count: int, example: str) -> str:
    """Check that a text contains `count` finite numbers, and return it unchanged.

    example: valid text, for the error message.
    """
    try:
        numbers = [float(word) for word in text.split()]
    except ValueError:
        numbers = []
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise argparse.ArgumentTypeError(
            f"'{text}' must be {count} finite numbers, for example '{example}'"
        )
    return text


def _parse_vector(text: str) -> str:
    return _parse_numbers(text, 3, "0 0.03 0")


def _parse_size(text: str) -> str:
    if not all(float(length) > 0.0 for length in _parse_numbers(text, 2, "0.1 0.1").split()):
        raise argparse.ArgumentTypeError(f"'{text}' must be two lengths above 0 m")
    return text


def _parse_file(text: str) -> Path:
    path = Path(text).expanduser()
    if not path.is_file():
        raise argparse.ArgumentTypeError(f"there is no file {path}")
    return path.resolve()


def _parse_folder(text: str) -> Path:
    path = Path(text)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise argparse.ArgumentTypeError(f"cannot make {path}: {error.strerror}") from None
    if not os.access(path, os.W_OK):
        raise argparse.ArgumentTypeError(f"cannot write to {path}")
    return path


def _check_start(text: str, other: bool) -> None:
    """Check the option --start.

    Args:
        text: value of the option.
        other: True if the robot is not the ARAS robot.

    Raises:
        ConfigurationError: the value is invalid.
    """
    if text in ("2015", "2016", "none"):
        return
    count = len(text.split()) if other else 6
    try:
        _parse_numbers(text, max(count, 1), "0.1 0 0.17 -0.09 -0.09 2.09")
    except argparse.ArgumentTypeError as error:
        raise ConfigurationError(f"argument --start: {error}") from None


def _parse_gain(text: str) -> float:
    value = float(_parse_numbers(text, 1, "3"))
    if value <= 0.0:
        raise argparse.ArgumentTypeError(f"{text} must be above 0")
    return value
