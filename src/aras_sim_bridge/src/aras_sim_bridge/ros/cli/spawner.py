"""Program that loads and starts controllers, and stops and unloads them on exit."""

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
    """Parse the command line, which has the arguments of ros_control's spawner."""
    parser = argparse.ArgumentParser(
        prog="spawner", description=__doc__,
        epilog="example: rosrun aras_sim_bridge spawner "
        "--namespace /my_robot joint_state_controller",
    )  # fmt: skip
    parser.add_argument("--stopped", action="store_true",
                        help="load the controllers without starting them")
    parser.add_argument("--wait-for", metavar="TOPIC",
                        help="wait until this topic (std_msgs/Bool) is true")
    parser.add_argument("--namespace", metavar="NS", help="namespace of the controller manager")
    parser.add_argument("--timeout", metavar="T", type=float, default=30.0,
                        help="time to wait for the controller manager [s]; <= 0: no limit")
    parser.add_argument("--no-timeout", action="store_true",
                        help="wait for the controller manager without limit")
    parser.add_argument("--shutdown-timeout", metavar="T", help="ignored, as in ros_control")
    parser.add_argument("controllers", nargs="+", help="controller names or YAML files")
    return parser.parse_args(argv)


def wait_for_service(name: str, timeout: float | None) -> bool:
    """Wait for a service and return whether it is available within `timeout`, s of wall time.

    If `timeout` is None, there is no time limit. If simulated time is used, the function also waits
    without limit until the simulator publishes on /clock.
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
    """Return whether a message on /clock arrives within 1 s."""
    try:
        rospy.wait_for_message("/clock", Clock, timeout=1.0)
    except rospy.ROSException:
        return False
    return True


def wait_for_true(topic: str) -> None:
    """Wait until a message with value true arrives on a topic of type std_msgs/Bool."""
    rospy.loginfo("Controller Spawner: Waiting for topic %s", rospy.resolve_name(topic))
    received = []
    subscriber = rospy.Subscriber(topic, Bool, lambda m: m.data and received.append(True))
    while not received and not rospy.is_shutdown():
        rospy.rostime.wallsleep(0.01)
    subscriber.unregister()


def read_controller_names(arguments: list[str], namespace: str) -> list[str]:
    """Return the names of the controllers in the command-line arguments.

    An argument may also be a YAML file. The file is loaded to the parameter server, and the names
    of its parameters are the names of its controllers.
    """
    names = []
    for argument in arguments:
        if not Path(argument).is_file():
            names.append(argument)
            continue
        file_namespace = namespace or rospy.get_namespace()
        for parameters, target in rosparam.load_file(argument, file_namespace):
            rosparam.upload_params(target, parameters)
            names.extend(parameters)
    return names


class Spawner:
    """Client of a controller manager that loads and starts controllers, and unloads them again."""

    def __init__(self, namespace: str) -> None:
        """Create the service clients of the controller manager.

        `namespace` ends with '/', or is '' for the namespace of this node.
        """
        self._manager = f"{namespace}controller_manager"
        self._proxies = {
            name: rospy.ServiceProxy(f"{self._manager}/{name}", service)
            for name, service in SERVICES
        }
        self._loaded: list[str] = []

    def wait(self, timeout: float | None) -> bool:
        """Wait until controllers can be loaded, switched and unloaded by services.

        Return False if one of the services is not available within `timeout`, s.
        """
        return all(wait_for_service(f"{self._manager}/{name}", timeout) for name in self._proxies)

    def load(self, names: list[str]) -> None:
        """Load the controllers in the given order; log each failure and continue."""
        for name in names:
            rospy.loginfo("Loading controller: %s", name)
            if self._proxies["load_controller"](name).ok:
                self._loaded.append(name)
            else:
                rospy.rostime.wallsleep(1.0)
                rospy.logerr("Failed to load %s; the simulator's log says why", name)
        rospy.loginfo("Controller Spawner: Loaded controllers: %s", ", ".join(self._loaded))

    def start(self) -> None:
        """Start all loaded controllers in one strict switch, and log whether it succeeded."""
        names = ", ".join(self._loaded)
        if self._proxies["switch_controller"](self._loaded, [], STRICT, False, 0.0).ok:
            rospy.loginfo("Started controllers: %s", names)
        else:
            rospy.logerr("Failed to start controllers: %s; the simulator's log says why", names)

    def unload(self) -> None:
        """Stop the controllers and unload them in reverse order, unless the simulator has ended."""
        if not self._loaded:
            return
        try:
            rospy.loginfo("Shutting down spawner. Stopping and unloading controllers...")
            self._proxies["switch_controller"]([], self._loaded, STRICT, False, 0.0)
            failed = [
                name for name in reversed(self._loaded)
                if not self._proxies["unload_controller"](name).ok
            ]  # fmt: skip
            # Log no warning if not a single controller could be unloaded: the simulator is then
            # probably shutting down, too.
            if len(failed) < len(self._loaded):
                for name in failed:
                    rospy.logwarn("Failed to unload %s; the simulator's log says why", name)
        except (rospy.ServiceException, rospy.ROSException, OSError):
            rospy.logdebug("the simulator has already ended; nothing to unload")


def main() -> int:
    """Run the spawner and return its exit status."""
    args = parse(rospy.myargv(sys.argv)[1:])
    # The spawner waits in wall time, because a subscription to /clock would use 3 % of a CPU core.
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
                "%s; spawn the robot first, and use its robotNamespace as --namespace",
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
            rospy.logerr("Controller Spawner: the simulator has ended: %s", error)
        return 1
    rospy.spin()
    return 0
