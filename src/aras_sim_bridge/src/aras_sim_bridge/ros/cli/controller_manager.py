"""Load, start, stop and list controllers from the command line."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable

import rospy
from controller_manager_msgs.srv import (
    ListControllers,
    ListControllerTypes,
    LoadController,
    ReloadControllerLibraries,
    SwitchController,
    UnloadController,
)

from aras_visual_servo_ros.shutdown import init_node

STRICT = 2
ALIASES = {"sp": "spawn", "kl": "kill", "lc": "list", "lt": "list-types", "rl": "reload-libraries"}
COMMANDS = ["load", "unload", "start", "stop", "spawn", "kill", "list", "list-types"]


def call(name: str, service: type, *args: object) -> object:
    """Wait for a service of the controller manager and call it."""
    full_name = f"controller_manager/{name}"
    rospy.wait_for_service(full_name)
    return rospy.ServiceProxy(full_name, service)(*args)


def load_controller(name: str) -> bool:
    """Load one controller; print and return whether it succeeded."""
    ok = call("load_controller", LoadController, name).ok
    print(f"Loaded '{name}'" if ok else f"Error when loading '{name}'")
    return ok


def unload_controller(name: str) -> bool:
    """Unload one controller; print and return whether it succeeded."""
    ok = call("unload_controller", UnloadController, name).ok
    print(f"Unloaded '{name}' successfully" if ok else f"Error when unloading '{name}'")
    return ok


def start_stop_controllers(names: list[str], start: bool) -> bool:
    """Start or stop controllers in one strict switch; print and return whether it succeeded."""
    both = (names, []) if start else ([], names)
    ok = call("switch_controller", SwitchController, *both, STRICT, False, 0.0).ok
    done, doing = ("Started", "starting") if start else ("Stopped", "stopping")
    print(f"{done} {names} successfully" if ok else f"Error when {doing} {names}")
    return ok


def start_controllers(names: list[str]) -> bool:
    """Start controllers in one switch."""
    return start_stop_controllers(names, True)


def stop_controllers(names: list[str]) -> bool:
    """Stop controllers in one switch."""
    return start_stop_controllers(names, False)


def start_controller(name: str) -> bool:
    """Start one controller."""
    return start_controllers([name])


def stop_controller(name: str) -> bool:
    """Stop one controller."""
    return stop_controllers([name])


def list_controllers() -> bool:
    """Print one line for each controller: its name, claimed hardware interfaces and state."""
    controllers = call("list_controllers", ListControllers).controller
    if not controllers:
        print("No controllers are loaded in mechanism control")
    for controller in controllers:
        interfaces = {claim.hardware_interface: None for claim in controller.claimed_resources}
        print(f"'{controller.name}' - '{'+'.join(interfaces)}' ( {controller.state} )")
    return True


def list_controller_types() -> bool:
    """Print the available controller types."""
    for name in call("list_controller_types", ListControllerTypes).types:
        print(name)
    return True


def reload_libraries(force_kill: bool, restore: bool = False) -> bool:
    """Reload the controller classes; print and return whether it succeeded.

    Args:
        force_kill: whether to stop and unload all controllers first; without it, loaded controllers
            prevent the reload.
        restore: whether to load the same controllers again afterwards and start those that were
            running.
    """
    print(f"Restore: {restore}")
    before = call("list_controllers", ListControllers).controller if restore else []
    ok = call("reload_controller_libraries", ReloadControllerLibraries, force_kill).ok
    print("Successfully reloaded libraries" if ok else
          "Failed to reload libraries. Do you still have controllers loaded?")
    if not restore:
        return ok
    for controller in before:
        ok = call("load_controller", LoadController, controller.name).ok and ok
    running = [controller.name for controller in before if controller.state == "running"]
    ok = call("switch_controller", SwitchController, running, [], STRICT, False, 0.0).ok and ok
    print("Controllers restored to original state" if ok else
          "Error when restoring the controllers to their original state")
    return ok


def run(command: str, names: list[str], restore: bool) -> bool:
    """Run one command for all names; return whether it succeeded for each of them."""
    actions = {
        "load": (load_controller,), "unload": (unload_controller,),
        "start": (start_controller,), "stop": (stop_controller,),
        "spawn": (load_controller, start_controller),
        "kill": (stop_controller, unload_controller),
    }  # fmt: skip
    if command in actions:
        return all([action(name) for action in actions[command] for name in names])
    if command == "list":
        return list_controllers()
    if command == "list-types":
        return list_controller_types()
    return reload_libraries(True, restore)


def run_action(action: Callable[[], bool]) -> int:
    """Run `action`, which calls services of the controller manager; return the exit status.

    A message is printed if the controller manager does not answer.
    """
    try:
        return 0 if action() else 1
    except rospy.ROSInterruptException:
        return 1
    except (rospy.ServiceException, rospy.ROSException) as error:
        print(f"The controller manager did not answer: {error}; spawn the robot, and set __ns to "
              "its namespace", file=sys.stderr)
        return 1


def main() -> int:
    """Run controller_manager and return its exit status."""
    parser = argparse.ArgumentParser(
        prog="controller_manager", description=__doc__,
        epilog="example: rosrun aras_sim_bridge controller_manager list __ns:=/my_robot",
    )  # fmt: skip
    parser.add_argument("command", choices=[*COMMANDS, "reload-libraries", *ALIASES])
    parser.add_argument("names", nargs="*", help="controller names")
    parser.add_argument("--restore", action="store_true",
                        help="load the controllers again after a reload")
    args = parser.parse_args(rospy.myargv(sys.argv)[1:])
    init_node("controller_manager", anonymous=True)
    command = ALIASES.get(args.command, args.command)
    return run_action(lambda: run(command, args.names, args.restore))
