"""Write a goal file, from camera images or from the geometry of the target.

    rosrun aras_visual_servo_controller teach my_pose.yaml                 # at the current pose
    rosrun aras_visual_servo_controller teach --go 2016 my_pose.yaml       # drive to a pose first
    rosrun aras_visual_servo_controller teach --scheme points my_pose.yaml # for the scheme `points`
    rosrun aras_visual_servo_controller teach --scheme model my_pose.yaml \\
        _model:=part.obj _model_start:='{pose: [0, 0, 0.59, 0, 0, 0]}'     # with a known mesh
    rosrun aras_visual_servo_controller teach --geometry goal_2016.yaml --urdf robot.urdf mine.yaml

Parameters of the controller node are given as _NAME:=VALUE.
"""

from __future__ import annotations

import argparse
import shlex
import sys
from pathlib import Path

from ..errors import ConfigurationError, ServoError
from ..goals.goal import Goal
from ..kinematics import Arm


def make_goal_from_geometry(path: Path, urdf: Path) -> Goal:
    """Compute a goal from a goal file with joints and target geometry, without ROS.

    The view of the target is computed for a camera without errors on this robot, at these joints.

    Args:
        path: goal file.
        urdf: file of the robot description.

    Raises:
        ConfigurationError: the file contains no geometry or no joints, or does not fit the robot.
    """
    try:
        arm = Arm.from_urdf(urdf.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"cannot read the robot description {urdf}: {error}") from error
    goal = Goal.load(path).for_arm(arm)
    return goal.predict_from_pose(goal.world_T_camera)


def main(argv: list[str] | None = None) -> int:
    """Run the tool and return its exit status.

    argv: command line; None for that of the process.
    """
    parser = argparse.ArgumentParser(
        prog="teach", description=__doc__.splitlines()[0],
        epilog="example: rosrun aras_visual_servo_controller teach "
        "goal.yaml --scheme points --depth 0.3",
    )  # fmt: skip
    command_line = [a for a in (sys.argv[1:] if argv is None else argv) if ":=" not in a]
    parser.add_argument("file", type=Path, help="YAML file into which the goal is written")
    source = parser.add_mutually_exclusive_group()
    source.add_argument("--geometry", type=Path, help="compute the goal from this goal file with "
                                                      "the target's geometry")
    source.add_argument("--go", help="move the arm there first: name of a start, or goal file with "
                                     "joints")
    parser.add_argument("--urdf", type=Path, help="robot description (URDF), needed by --geometry")
    parser.add_argument("--scheme", default="moments", help="scheme whose features are taught "
                        "(default moments)")  # fmt: skip
    parser.add_argument("--images", type=int, default=30, help="number of images to average "
                        "(default 30)")  # fmt: skip
    parser.add_argument("--depth", type=float, help="depth of the target's plane, m (default: from "
                        "the geometry of the demo's target)")  # fmt: skip
    parser.add_argument("--timeout", type=float, default=60.0, help="time to wait for images, s "
                        "(default 60)")  # fmt: skip
    arguments = parser.parse_args(command_line)
    try:
        if arguments.images < 1 or not arguments.timeout > 0.0:
            raise ConfigurationError("--images and --timeout have to be above 0")
        if arguments.depth is not None and not arguments.depth > 0.0:
            raise ConfigurationError("--depth has to be above 0 m")
        if arguments.geometry:
            if arguments.urdf is None:
                raise ConfigurationError("--geometry needs --urdf FILE, the robot description")
            goal = make_goal_from_geometry(arguments.geometry, arguments.urdf)
            heading = "View of the target from this pose, computed from the geometry below."
        else:
            # imported here, because no other part of this module needs ROS
            from .teach import collect_views

            goal = collect_views(arguments)
            heading = f"Taught from {arguments.images} images."
        heading += f"\nMade by: teach {shlex.join(command_line)}"
        arguments.file.write_text(goal.to_yaml(heading), encoding="utf-8")
    except (ServoError, OSError) as error:
        print(f"teach: {error}", file=sys.stderr)
        return 1
    area = "" if goal.moments is None else f", area {goal.moments.m00:.6f}"
    print(f"wrote {arguments.file}: depth {goal.depth:.4f} m{area}")
    return 0
