"""Program that lists, loads and switches groups of controllers.

The parameter controller_groups defines the groups.
"""

from __future__ import annotations

import argparse
import sys

import rospy
from controller_manager_msgs.srv import ListControllers, SwitchController

from aras_sim_bridge.ros.cli.controller_manager import (
    STRICT,
    load_controller,
    run_action,
    start_controller,
)
from aras_visual_servo_ros.shutdown import init_node

SERVICE_TIMEOUT = 5.0  # time to wait for a service of the controller manager, s of wall time


def read_groups() -> dict[str, list[str]]:
    """Return the lists of controller names by group name, from the parameter server."""
    groups = rospy.get_param("controller_groups", {})
    return groups if isinstance(groups, dict) else {}


def list_groups(groups: dict[str, list[str]]) -> None:
    """Print all groups with their controllers."""
    print(f"Number of groups: {len(groups)}")
    for name in sorted(groups):
        print(f"  {name}")
        for controller in groups[name]:
            print(f"      {controller}")


def spawn(controllers: list[str]) -> bool:
    """Load and start controllers; return whether all of them were loaded and started."""
    loaded = all([load_controller(name) for name in controllers])
    return loaded and all([start_controller(name) for name in controllers])


def switch(group: list[str], other_groups: set[str]) -> None:
    """Start a group's controllers and stop those of the other groups, in one switch.

    A failure is only printed.
    """
    service = "controller_manager/list_controllers"
    rospy.wait_for_service(service, SERVICE_TIMEOUT)
    controllers = rospy.ServiceProxy(service, ListControllers)().controller
    is_running = {c.name: c.state == "running" for c in controllers}
    for name in group:
        if name not in is_running and not load_controller(name):
            print("Cancel group switching")
            return
    to_start = [name for name in group if not is_running.get(name)]
    to_stop = [name for name, runs in is_running.items() if runs and name in other_groups]
    proxy = rospy.ServiceProxy("controller_manager/switch_controller", SwitchController)
    ok = proxy(to_start, to_stop, STRICT, False, 0.0).ok
    requests = {("starting", "Started"): to_start, ("stopping", "Stopped"): to_stop}
    if ok:
        for (_, done), names in requests.items():
            if names:
                print(f"{done} {names} successfully")
    else:
        doing = " and ".join(f"{word} {names}" for (word, _), names in requests.items() if names)
        print(f"Error when {doing}")


def main() -> int:
    """Run controller_group and return its exit status."""
    parser = argparse.ArgumentParser(
        prog="controller_group", description=__doc__,
        epilog="example: rosrun aras_sim_bridge controller_group switch position __ns:=/my_robot",
    )  # fmt: skip
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("list", help="print the groups")
    for name in ("spawn", "switch"):
        commands.add_parser(name).add_argument("group", help="name of the group of controllers")
    args = parser.parse_args(rospy.myargv(sys.argv)[1:])
    init_node("controller_group", anonymous=True)
    groups = read_groups()
    if args.command == "list":
        list_groups(groups)
        return 0
    group = list(dict.fromkeys(groups.get(args.group) or ()))
    if not group:
        known = ", ".join(sorted(groups)) or "none"
        print(
            f"There is no controller defined in group {args.group}; "
            f"groups in {rospy.resolve_name('controller_groups')}: {known}",
            file=sys.stderr,
        )
        return 1
    if args.command == "spawn":
        return run_action(lambda: spawn(group))
    others = {name for names in groups.values() for name in names} - set(group)

    def switch_to_group() -> bool:
        switch(group, others)
        # The exit status is 0 even if the switch failed, like that of the program of the same name
        # in ROS; scripts read the printed text.
        return True

    return run_action(switch_to_group)
