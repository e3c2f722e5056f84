"""Program that spawns a model, with the arguments of gazebo_ros's spawn_model."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

import rospy
from gazebo_msgs.msg import ModelStates
from gazebo_msgs.srv import (
    DeleteModel,
    GetPhysicsProperties,
    SetModelConfiguration,
    SpawnModel,
)
from std_srvs.srv import Empty

from aras_sim_bridge.ros.conversions import to_pose
from aras_visual_servo_base.poses import Pose
from aras_visual_servo_ros.shutdown import init_node


class SpawnError(Exception):
    """The model cannot be spawned; the message states the reason and the remedy."""


def parse(argv: list[str]) -> argparse.Namespace:
    """Parse the command line, which has the arguments of gazebo_ros's spawn_model."""
    parser = argparse.ArgumentParser(
        prog="spawn_model", description=__doc__,
        epilog="example: rosrun aras_sim_bridge spawn_model "
        "-urdf -param robot_description -model my_robot",
    )  # fmt: skip
    kind = parser.add_mutually_exclusive_group(required=True)
    kind.add_argument("-urdf", action="store_true", help="the description is URDF")
    kind.add_argument("-sdf", "-gazebo", action="store_true",
                      help="the description is SDF (-gazebo is the old name of this option)")
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("-file", metavar="FILE", help="read the model from a file")
    source.add_argument("-param", metavar="PARAM", help="read the model from a ROS parameter")
    source.add_argument("-database", metavar="MODEL", help="not supported (no model database)")
    source.add_argument("-stdin", action="store_true", help="read the model from standard input")
    parser.add_argument("-model", required=True, metavar="NAME",
                        help="name of the model in the simulation")
    parser.add_argument("-reference_frame", default="", metavar="ENTITY",
                        help="model or link that the initial pose is relative to; default: world")
    parser.add_argument("-gazebo_namespace", default="/gazebo", metavar="NS",
                        help="namespace of the simulator (default: %(default)s)")
    parser.add_argument("-robot_namespace", default=None, metavar="NS",
                        help="namespace of the model's controllers and cameras; default: "
                        "namespace of this node")
    parser.add_argument("-unpause", action="store_true",
                        help="resume simulated time after spawning")
    parser.add_argument("-wait", metavar="MODEL", help="wait until this model exists")
    for name, unit in zip("xyzRPY", ["m"] * 3 + ["rad"] * 3, strict=True):
        parser.add_argument(f"-{name}", type=float, default=0.0,
                            help=f"{name} of the initial pose [{unit}]")
    parser.add_argument(
        "-J",
        nargs=2,
        action="append",
        default=[],
        dest="joints",
        metavar=("JOINT", "POSITION"),
        help="initial position of a joint [rad or m]; can be repeated for several joints",
    )
    parser.add_argument("-package_to_model", action="store_true",
                        help="replace package:// by model:// in the description")
    parser.add_argument("-b", action="store_true", dest="bond", help="delete the model on exit")
    return parser.parse_args(argv)


def read_xml(args: argparse.Namespace) -> str:
    """Return the XML text of the model from the source that the arguments select.

    Raises:
        SpawnError: the source does not exist or is not supported.
    """
    if args.database:
        raise SpawnError("-database is not supported (there is no model database); use -file")
    if args.file:
        try:
            return Path(args.file).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise SpawnError(f"cannot read the model file: {error}") from error
    if args.param:
        if not rospy.has_param(args.param):
            raise SpawnError(
                f"parameter {rospy.resolve_name(args.param)} does not exist; load the model first,"
                f' e.g. <param name="{args.param}" textfile="..."/>'
            )
        return str(rospy.get_param(args.param))
    return sys.stdin.read()


def wait_for_model(namespace: str, name: str) -> None:
    """Wait until model_states contains the model."""
    rospy.loginfo("Waiting for model %s before spawning", name)
    while not rospy.is_shutdown():
        try:
            states = rospy.wait_for_message(f"{namespace}/model_states", ModelStates, timeout=1.0)
        except rospy.ROSException:
            continue
        if name in states.name:
            return
        rospy.rostime.wallsleep(0.1)


@contextmanager
def pause_time(namespace: str) -> Iterator[None]:
    """Pause the simulation in a `with` block; resume it afterwards if it was running before."""
    rospy.wait_for_service(f"{namespace}/get_physics_properties")
    physics = rospy.ServiceProxy(f"{namespace}/get_physics_properties", GetPhysicsProperties)
    is_running = not physics().pause
    if is_running:
        rospy.ServiceProxy(f"{namespace}/pause_physics", Empty)()
    try:
        yield
    finally:
        if is_running:
            rospy.ServiceProxy(f"{namespace}/unpause_physics", Empty)()


def spawn(args: argparse.Namespace) -> None:
    """Spawn the model and set its joint positions according to the arguments.

    Raises:
        SpawnError: the model cannot be spawned.
    """
    namespace = args.gazebo_namespace.rstrip("/")
    xml = read_xml(args)
    if not xml.strip():
        raise SpawnError("the model is empty; check the file, parameter or pipe it comes from")
    if args.package_to_model:
        xml = xml.replace("package://", "model://")
    try:
        joints = [(name, float(position)) for name, position in args.joints]
    except ValueError as error:
        raise SpawnError(f"-J takes a joint name and a number: {error}") from error
    if args.wait:
        wait_for_model(namespace, args.wait)
    service = f"{namespace}/spawn_{'urdf' if args.urdf else 'sdf'}_model"
    robot_namespace = args.robot_namespace
    if robot_namespace is None:
        robot_namespace = rospy.get_namespace()
    pose = Pose.from_rpy((args.x, args.y, args.z), (args.R, args.P, args.Y))
    rospy.loginfo("Waiting for service %s", service)
    rospy.wait_for_service(service)
    # Pause simulated time, so that the robot does not move before its joints are at their initial
    # positions. At other positions, links of the robot may collide with each other.
    with pause_time(namespace) if joints else nullcontext():
        response = rospy.ServiceProxy(service, SpawnModel)(
            args.model, xml, robot_namespace, to_pose(pose), args.reference_frame
        )
        if not response.success:
            raise SpawnError(response.status_message)
        rospy.loginfo("%s", response.status_message)
        if joints:
            set_joint_positions(args.model, joints, namespace)
    if args.unpause:
        rospy.wait_for_service(f"{namespace}/unpause_physics")
        rospy.ServiceProxy(f"{namespace}/unpause_physics", Empty)()


def set_joint_positions(model: str, joints: list[tuple[str, float]], namespace: str) -> None:
    """Set joint positions (rad or m) of a model that has been spawned.

    Raises:
        SpawnError: the simulator rejects the positions.
    """
    service = f"{namespace}/set_model_configuration"
    rospy.wait_for_service(service)
    names, positions = zip(*joints, strict=True)
    response = rospy.ServiceProxy(service, SetModelConfiguration)(
        model, "robot_description", names, positions
    )
    if not response.success:
        raise SpawnError(response.status_message)


def delete(args: argparse.Namespace) -> None:
    """Delete the model on exit (option -b)."""
    service = f"{args.gazebo_namespace.rstrip('/')}/delete_model"
    try:
        rospy.ServiceProxy(service, DeleteModel)(args.model)
    except (rospy.ServiceException, rospy.ROSException):
        rospy.logwarn("model %s was not deleted: the simulator has ended", args.model)


def main() -> int:
    """Run spawn_model and return its exit status."""
    args = parse(rospy.myargv(sys.argv)[1:])
    init_node("spawn_model", anonymous=True)
    try:
        spawn(args)
    except SpawnError as error:
        rospy.logerr("Spawning %s failed: %s", args.model, error)
        return 1
    except rospy.ServiceException as error:
        rospy.logerr("Spawning %s failed, because the simulator refused the call: "
                     "%s", args.model, error)
        return 1
    except rospy.ROSInterruptException:
        return 1
    except rospy.ROSException as error:
        if not rospy.is_shutdown():
            rospy.logerr("Spawning %s failed: %s", args.model, error)
        return 1
    if args.bond:
        rospy.on_shutdown(lambda: delete(args))
        rospy.spin()
    return 0
