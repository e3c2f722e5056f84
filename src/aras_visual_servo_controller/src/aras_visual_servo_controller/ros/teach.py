"""Teaching of a goal from the images of a running system."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import rospy

from aras_visual_servo_ros.shutdown import init_node

from ..diagnosis.joint_tracking_check import describe_foreign_nodes
from ..errors import ServoError
from ..goals.goal import Goal
from ..goals.starts import find_start_joints
from ..loop.teaching import ViewCollector, make_mean_goal
from ..observation.observation import Need
from .command_publishers import CommandPublishers
from .foreign_commands import ForeignCommandListener
from .loop_subscribers import LoopSubscribers
from .node_settings import read_robot_settings


def collect_views(arguments: argparse.Namespace) -> Goal:
    """Collect views of the target and return the goal; with `--go`, move to a pose first.

    Raises:
        ServoError: too few images arrive in time, or too many successive images are unusable. The
            message gives the reason.
    """
    init_node("teach", anonymous=True)
    raw_settings = {**rospy.get_param("~", {}), "scheme": arguments.scheme}
    settings, arm = read_robot_settings(raw_settings)
    scheme, package = settings.make_scheme(), settings.package
    urdf = str(rospy.get_param(settings.description))
    arms = {settings.list_cameras(scheme)[0]: arm, **settings.make_other_cameras(urdf, arm)}
    rig = settings.make_camera_rig(arms, scheme)
    for observer in rig.observers.values():
        if observer.needs <= {Need.MOMENTS, Need.KERNEL}:
            observer.needs |= {Need.MOMENTS}
    joints, commands, foreign = None, None, None
    if arguments.go:
        path = Path(arguments.go).expanduser()
        if not path.is_file():
            path = package / "config" / f"goal_{Path(arguments.go).name}.yaml"
        if path.is_file():
            joints = Goal.load(path).for_arm(arm).get_joints(arm.names)
        if joints is None:
            joints = find_start_joints(arguments.go, arm, package)
        commands = CommandPublishers(settings, arm.names, "position")
        foreign = ForeignCommandListener(commands)
        foreign.listen(True)
    teacher = ViewCollector(arm, rig, joints, None if commands is None else commands.send)
    inputs = LoopSubscribers(settings, teacher)
    deadline = time.monotonic() + arguments.timeout
    while len(teacher.views) < arguments.images:
        # If so many successive images are unusable, further ones probably are, too. The limit is
        # the number of images needed for teaching.
        if teacher.refused_count >= arguments.images:
            raise ServoError(
                f"the last {teacher.refused_count} images show nothing that can be taught "
                f"({teacher.reason}): bring the target into view and teach again"
            )
        if rospy.is_shutdown() or time.monotonic() > deadline:
            nodes = {} if foreign is None else {j: n for j, (n, _) in foreign.read_latest().items()}
            reason = "; ".join(filter(None, (teacher.reason, describe_foreign_nodes(nodes))))
            raise ServoError(
                f"only {len(teacher.views)} of {arguments.images} usable images arrived within "
                f"{arguments.timeout:.0f} s ({reason}): start the simulator and the camera node, "
                "and bring the target into view"
            )
        time.sleep(0.02)
    inputs.close()
    target_goal = None
    # Without a mesh model or a known depth, the plane is computed from the target geometry in a
    # goal.
    if arguments.depth is None and not settings.model:
        target_goal = Goal.load(package / "config" / "goal_2016.yaml")
    views = teacher.views[: arguments.images]
    return make_mean_goal(views, scheme, arm, arguments.file.name, arguments.depth, target_goal)
