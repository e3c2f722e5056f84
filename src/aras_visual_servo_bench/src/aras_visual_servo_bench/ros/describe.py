"""Node that publishes a description of the experiment, for recorders.

A latched std_msgs/String contains a JSON object with all data that are needed to repeat a run:

- `parameters`: all parameters of the parameter server,
- `controller`: name of the controller node,
- `launch`: arguments of all roslaunch processes with this ROS master,
- `goals`: texts of the goal files that the controller may use,
- `versions`: versions of the software.

It is published again when the parameters change. A second topic, a geometry_msgs/PoseStamped, is
the pose of the target in the base frame of the arm. It is published when the target has moved.
"""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Mapping
from pathlib import Path

from ..recording.ros_parameters import find_branch

FORMAT_VERSION = 1
TOPIC = "/aras_visual_servo/experiment"
CONTROLLER = "/aras_visual_servo_controller"
PERIOD = 0.2  # time between two queries of the target's pose, s of wall time
# The parameters are queried once per this number of queries of the target's pose.
PARAMETER_INTERVAL = 5
MAX_GOAL_BYTES = 200_000  # largest size of a goal file that is included in the description, bytes


def collect_description(parameters: Mapping[str, object], controller: str) -> dict[str, object]:
    """Return the description of an experiment, a JSON object.

    Args:
        parameters: all parameters of the parameter server.
        controller: name of the controller node.
    """
    from ..studies.versions import read_commit, read_versions

    return {
        "format": FORMAT_VERSION,
        "controller": controller,
        "parameters": parameters,
        "launch": find_launch_commands(),
        "goals": read_goal_files(find_branch(parameters, controller)),
        "versions": {**read_versions(), "code": read_commit()},
    }


def read_goal_files(controller: Mapping[str, object]) -> dict[str, str]:
    """Return, by file name, the texts of the goal files that the controller may use.

    controller: parameters of the controller node.
    """
    import rospkg

    with contextlib.suppress(rospkg.ResourceNotFound):
        folder = Path(rospkg.RosPack().get_path("aras_visual_servo_controller")) / "config"
        named = [str(controller.get(key, "")) for key in ("desired", "start")] + ["2016"]
        paths = [folder / f"goal_{Path(name).name}.yaml" for name in named]
        paths.append(Path(str(controller.get("desired", ""))).expanduser())
        return {
            path.name: path.read_text(encoding="utf-8", errors="replace")
            for path in dict.fromkeys(paths)
            if path.is_file() and path.stat().st_size < MAX_GOAL_BYTES
        }
    return {}


def find_launch_commands(proc: Path = Path("/proc")) -> list[list[str]]:
    """Return the arguments of each roslaunch process on this machine with the same ROS master.

    proc: folder of the proc file system.
    """
    master, found = os.environ.get("ROS_MASTER_URI", "").rstrip("/"), []
    for entry in sorted(proc.glob("[0-9]*"), key=lambda one: (len(one.name), one.name)):
        with contextlib.suppress(OSError):
            words = (entry / "cmdline").read_bytes().decode(errors="replace").split("\0")[:-1]
            names = [Path(word).name for word in words[:3]]
            if "roslaunch" not in names:
                continue
            environment = (entry / "environ").read_bytes().decode(errors="replace").split("\0")
            values = dict(line.partition("=")[::2] for line in environment)
            if values.get("ROS_MASTER_URI", "").rstrip("/") == master:
                found.append(words[names.index("roslaunch") + 1 :])
    return found


def main() -> int:
    """Run the node, which publishes the description and the target's pose when they change.

    Returns:
        The exit status.
    """
    import rospy
    from geometry_msgs.msg import PoseStamped
    from std_msgs.msg import String

    from aras_visual_servo_base.urdf import read_robot_name
    from aras_visual_servo_ros.parameters import get_parameter
    from aras_visual_servo_ros.shutdown import init_node

    from . import target_pose_reader

    init_node("describe", __doc__, disable_rostime=True)
    controller = rospy.get_param("~controller", CONTROLLER)
    publisher = rospy.Publisher(TOPIC, String, queue_size=1, latch=True)
    target = rospy.Publisher(target_pose_reader.TOPIC, PoseStamped, queue_size=1, latch=True)
    reader, last_pose = target_pose_reader.TargetPoseReader(), None
    last_text, count, robot = "", 0, ""
    while not rospy.is_shutdown():
        with contextlib.suppress(rospy.ROSException, OSError):
            if count % PARAMETER_INTERVAL == 0:
                parameters = get_parameter("/")
                text = json.dumps(parameters, sort_keys=True, default=str)
                if text != last_text:
                    last_text = text
                    robot = read_robot_name(str(parameters.get("robot_description", "")))
                    description = collect_description(parameters, controller)
                    publisher.publish(String(json.dumps(description, default=str)))
            found = reader.read_pose(robot)
            if found is not None and target_pose_reader.has_moved(last_pose, found.pose):
                last_pose = found.pose
                target.publish(found)
        count += 1
        time.sleep(PERIOD)
    return 0
