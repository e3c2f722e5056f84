"""One latched message with everything that repeats a run, for who records it; and where the target
lies, in a topic of its own (geometry_msgs/PoseStamped in the arm's base), when it has moved.

JSON with: `parameters`, the whole parameter server; `launch`, the words of every roslaunch of this
master; `read_goal_files`, the texts of the goal files that the controller may take; `presets`, the
camera's file; `versions` and `code`, of what computes; `controller`, the node whose parameters
count. It is
sent again whenever one of them changes. Nothing of it is judged here: who reads it does.
"""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Mapping
from pathlib import Path

from ..recording.parameters import find_branch

FORMAT_VERSION = 1
TOPIC = "/aras_visual_servo/experiment"
CONTROLLER = "/aras_visual_servo_controller"
PERIOD = 0.2  # s of wall time between two looks for the target
PARAMETER_INTERVAL = 5  # such looks for one at the parameters
MAX_GOAL_BYTES = 200_000  # bytes of a goal file


def collect_description(
    parameters: Mapping[str, object], controller: str = CONTROLLER
) -> dict[str, object]:
    """What the message says of these parameters; see the module."""
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
    """Texts of the goal files that may be meant, by file name."""
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
    """Words behind the name of every roslaunch on this machine that has the same master."""
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
    """The node `describe`: look, and tell what is new."""
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
    place, lay, told, looks, robot = target_pose_reader.TargetPoseReader(), None, "", 0, ""
    while not rospy.is_shutdown():
        with contextlib.suppress(rospy.ROSException, OSError):
            if looks % PARAMETER_INTERVAL == 0:
                parameters = get_parameter("/")
                text = json.dumps(parameters, sort_keys=True, default=str)
                if text != told:
                    told = text
                    robot = read_robot_name(str(parameters.get("robot_description", "")))
                    words = json.dumps(collect_description(parameters, controller), default=str)
                    publisher.publish(String(words))
            found = place.read_pose(robot)
            if found is not None and target_pose_reader.has_moved(lay, found.pose):
                lay = found.pose
                target.publish(found)
        looks += 1
        time.sleep(PERIOD)
    return 0
