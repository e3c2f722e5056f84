"""spawner: load and start controllers, stop and unload them on exit (as ros_control's does)."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import rosparam
import rospy
from controller_manager_msgs.srv import LoadController, SwitchController, UnloadController
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Bool

from aras_visual_servo_ros.shutdown import init_node

STRICT = 2
SERVICES = (
    ("load_controller", LoadController),
    ("switch_controller", SwitchController),
    ("unload_controller", UnloadController),
)


def parse(argv: list[str]) -> argparse.Namespace:
    """Return the arguments, named as ros_control names them."""
    parser = argparse.ArgumentParser(
        prog="spawner", description=__doc__,
        epilog="example: rosrun aras_sim_bridge spawner "
        "--namespace /my_robot joint_state_controller",
    )  # fmt: skip
    parser.add_argument("--stopped", action="store_true", help="load, but do not start")
    parser.add_argument("--wait-for", metavar="TOPIC", help="std_msgs/Bool to wait for until true")
    parser.add_argument("--namespace", metavar="NS", help="namespace of the controller manager")
    parser.add_argument("--timeout", metavar="T", type=float, default=30.0, help="[s]; <= 0: none")
    parser.add_argument("--no-timeout", action="store_true", help="wait for ever")
    parser.add_argument("--shutdown-timeout", metavar="T", help="without effect, as upstream")
    parser.add_argument("controllers", nargs="+", help="controller names or YAML files")
    return parser.parse_args(argv)


def wait_for_service(name: str, timeout: float | None) -> bool:
    """Return whether the service came up within timeout [s of wall time]; None waits for ever.

    As long as simulated time has not begun, the simulator is still starting and the wait goes on.
    """
    rospy.loginfo("Controller Spawner: Waiting for service %s", rospy.resolve_name(name))
    while not rospy.is_shutdown():
        try:
            rospy.wait_for_service(name, timeout)
            return True
        except rospy.ROSInterruptException:
            return False
        except rospy.ROSException:
            if not rospy.get_param("/use_sim_time", False) or is_clock_running():
                return False
    return False


def is_clock_running() -> bool:
    """Return whether /clock has been heard."""
    try:
        rospy.wait_for_message("/clock", Clock, timeout=1.0)
    except rospy.ROSException:
        return False
    return True


def wait_for_true(topic: str) -> None:
    """Return when a true Bool has come in on topic."""
    rospy.loginfo("Controller Spawner: Waiting for topic %s", rospy.resolve_name(topic))
    heard = []
    subscriber = rospy.Subscriber(topic, Bool, lambda m: m.data and heard.append(True))
    while not heard and not rospy.is_shutdown():
        rospy.rostime.wallsleep(0.01)
    subscriber.unregister()


def read_controller_names(arguments: list[str], namespace: str) -> list[str]:
    """Return the names to load; YAML files among the arguments are put on the parameter server."""
    names = []
    for argument in arguments:
        if not Path(argument).is_file():
            names.append(argument)
            continue
        own = namespace or rospy.get_namespace()
        for parameters, target in rosparam.load_file(argument, own):
            rosparam.upload_params(target, parameters)
            names.extend(parameters)
    return names


class Spawner:
    """Loads controllers, and undoes it on shutdown."""

    def __init__(self, namespace: str) -> None:
        """Talk to the controller manager in `namespace` ('' is the node's own, else ends in /)."""
        self._names = {name: f"{namespace}controller_manager/{name}" for name, _ in SERVICES}
        self._proxies = {
            name: rospy.ServiceProxy(self._names[name], service) for name, service in SERVICES
        }
        self._loaded: list[str] = []

    def wait(self, timeout: float | None) -> bool:
        """Return whether all three services are there in time."""
        return all(wait_for_service(name, timeout) for name in self._names.values())

    def load(self, names: list[str]) -> None:
        """Load in the given order; a failure is logged and the next one tried."""
        for name in names:
            rospy.loginfo("Loading controller: %s", name)
            if self._proxies["load_controller"](name).ok:
                self._loaded.append(name)
            else:
                rospy.rostime.wallsleep(1.0)
                rospy.logerr("Failed to load %s; the simulator's log says why", name)
        rospy.loginfo("Controller Spawner: Loaded controllers: %s", ", ".join(self._loaded))

    def start(self) -> bool:
        """Start all that were loaded in one strict switch."""
        if self._proxies["switch_controller"](self._loaded, [], STRICT, False, 0.0).ok:
            rospy.loginfo("Started controllers: %s", ", ".join(self._loaded))
            return True
        rospy.logerr(
            "Failed to start controllers: %s; the simulator's log says why",
            ", ".join(self._loaded),
        )
        return False

    def unload(self) -> None:
        """Stop and unload in reverse order; silent when the simulator went first."""
        if not self._loaded:
            return
        try:
            rospy.loginfo("Shutting down spawner. Stopping and unloading controllers...")
            self._proxies["switch_controller"]([], self._loaded, STRICT, False, 0.0)
            left = [
                name for name in reversed(self._loaded)
                if not self._proxies["unload_controller"](name).ok
            ]  # fmt: skip
            if len(left) < len(self._loaded):  # else the simulator ends at the same Ctrl-C
                for name in left:
                    rospy.logwarn("Failed to unload %s; the simulator's log says why", name)
        except (rospy.ServiceException, rospy.ROSException, OSError):
            rospy.logdebug("the simulator is gone already; nothing to unload")


def main() -> int:
    """Entry point; returns the exit status."""
    args = parse(rospy.myargv(sys.argv)[1:])
    # its waits are of wall time: hearing the clock all the while would be a thirtieth of a core
    init_node("spawner", anonymous=True, disable_rostime=True)
    if args.shutdown_timeout is not None:
        rospy.logwarn("--shutdown-timeout has no effect; leave it out")
    namespace = args.namespace or ""
    if namespace and not namespace.endswith("/"):
        namespace += "/"
    timeout = None if args.no_timeout or args.timeout <= 0 else args.timeout
    spawner = Spawner(namespace)
    if not spawner.wait(timeout):
        if not rospy.is_shutdown():
            rospy.logwarn(
                "Controller Spawner couldn't find the expected controller_manager ROS interface in "
                "%s; is the robot spawned, and is its robotNamespace the same?",
                rospy.resolve_name(namespace or "controller_manager"),
            )
        return 0
    if args.wait_for:
        wait_for_true(args.wait_for)
    rospy.on_shutdown(spawner.unload)
    try:
        spawner.load(read_controller_names(args.controllers, namespace))
        if not args.stopped:
            spawner.start()
    except rospy.ServiceException as error:
        if not rospy.is_shutdown():
            rospy.logerr("Controller Spawner: the simulator went away: %s", error)
        return 1
    rospy.spin()
    return 0
