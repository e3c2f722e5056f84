"""Command that prints the path of the mesh, or the pose, of a link that is the target.

    rosrun aras_visual_servo_bench target_link crate::body --world /my/crate.world mesh
    rosrun aras_visual_servo_bench target_link crate::body --world /my/crate.world start

`mesh` prints the path of a mesh file of the link's visual. `start` prints the pose of the link in
the format of the controller's parameter model_start. This is the current pose in the base frame of
the robot or, if no simulation is running, the pose in the world file.
aras_visual_servo_nodes.launch calls both commands if its argument `link` is set.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
import tempfile
from pathlib import Path

import rospy
from gazebo_msgs.srv import GetLinkState, GetWorldProperties

from aras_sim_bridge.ros.conversions import from_pose
from aras_visual_servo_base.poses import xyz_rpy_from_matrix
from aras_visual_servo_base.urdf import read_robot_name

from ..errors import ExperimentError, catch_write_errors
from ..experiment.packages import PackagePath
from ..experiment.worlds import find_world_link
from .target_pose_reader import WORLD

STATE = "/gazebo/get_link_state"
DESCRIPTION = "/robot_description"


def main(argv: list[str] | None = None) -> int:
    """Print the path of the mesh, or the pose, and return the exit status."""
    parser = argparse.ArgumentParser(
        prog="target_link", description=__doc__.splitlines()[0],
        epilog="example: rosrun aras_visual_servo_bench target_link crate --world a.world start",
    )  # fmt: skip
    parser.add_argument("link", help="MODEL::LINK, or MODEL if only one link is visible")
    parser.add_argument("--world", required=True, help="path of the world file with the model")
    parser.add_argument("what", choices=("mesh", "start"),
                        help="print the path of the link's mesh, or its pose at the start")
    options = parser.parse_args(argv)
    model, _, link_name = options.link.partition("::")
    packages = PackagePath()
    try:
        world = str(packages.resolve(options.world))
        mesh, pose, link = find_world_link(world, packages, model, link_name)
        if options.what == "mesh":
            print(_copy_mesh(Path(mesh), options.link), end="")
        else:
            pose = _read_pose(f"{model}::{link}") or pose
            print(f"{{pose: [{', '.join(f'{value:.9g}' for value in pose)}]}}")
    except ExperimentError as error:
        print(f"target_link: {error}", file=sys.stderr)
        return 1
    return 0


def _copy_mesh(mesh: Path, name: str) -> Path:
    """Copy a mesh into the folder for temporary files, and return the path of the copy.

    name: name of the link, from which the name of the copy is made.
    """
    text = mesh.read_bytes()
    folder = Path(tempfile.gettempdir()) / "aras_targets" / hashlib.sha256(text).hexdigest()[:16]
    path = folder / f"{name.replace(':', '_').replace('/', '_')}{mesh.suffix}"
    with catch_write_errors(f"the mesh into {folder}", ExperimentError):
        folder.mkdir(parents=True, exist_ok=True)
        path.write_bytes(text)
    return path


def _read_pose(link: str) -> tuple[float, ...] | None:
    """Return x, y, z (m), roll, pitch, yaw (rad) of a link in the simulation.

    The pose is in the base frame of the robot, or in the world frame if the robot is not spawned.
    Return None if no simulation is running, or if it does not contain the link.
    """
    try:
        models = rospy.ServiceProxy(WORLD, GetWorldProperties)().model_names
        robot = read_robot_name(str(rospy.get_param(DESCRIPTION, "")))
        base = robot if robot in models else ""
        state = rospy.ServiceProxy(STATE, GetLinkState)(link, base)
    except (rospy.ROSException, rospy.ServiceException, OSError):
        return None
    if not state.success:
        return None
    xyz, rpy = xyz_rpy_from_matrix(from_pose(state.link_state.pose, "link").matrix())
    return (*map(float, xyz), *map(float, rpy))
