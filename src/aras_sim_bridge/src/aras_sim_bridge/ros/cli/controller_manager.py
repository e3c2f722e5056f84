"""controller_manager: load, start, stop and list controllers from the command line."""

from __future__ import annotations

import argparse
import sys

import rospy
from controller_manager_msgs.srv import (
    ListControllers,
    ListControllerTypes,
    LoadController,
    ReloadControllerLibraries,
    SwitchController,
    UnloadController,
)

from aras_visual_servo_ros.shutdown import begin_node

STRICT = 2
ALIASES = {"sp": "spawn", "kl": "kill", "lc": "list", "lt": "list-types", "rl": "reload-libraries"}
COMMANDS = ["load", "unload", "start", "stop", "spawn", "kill", "list", "list-types"]


def call(name: str, service: type, *args: object) -> object:
    """Wait for a service of the controller manager and call it."""
    full_name = f"controller_manager/{name}"
    rospy.wait_for_service(full_name)
    return rospy.ServiceProxy(full_name, service)(*args)


def load(name: str) -> bool:
    """Load one controller."""
    ok = call("load_controller", LoadController, name).ok
    print(f"Loaded {name}" if ok else f"Error when loading {name}")
    return ok


def unload(name: str) -> bool:
    """Unload one controller."""
    ok = call("unload_controller", UnloadController, name).ok
    print(f"Unloaded {name} successfully" if ok else f"Error when unloading {name}")
    return ok


def start(name: str) -> bool:
    """Start one controller."""
    ok = call("switch_controller", SwitchController, [name], [], STRICT, False, 0.0).ok
    print(f"Started ['{name}'] successfully" if ok else f"Error when starting ['{name}']")
    return ok


def stop(name: str) -> bool:
    """Stop one controller."""
    ok = call("switch_controller", SwitchController, [], [name], STRICT, False, 0.0).ok
    print(f"Stopped ['{name}'] successfully" if ok else f"Error when stopping ['{name}']")
    return ok


def list_controllers() -> bool:
    """Print one line a controller."""
    controllers = call("list_controllers", ListControllers).controller
    if not controllers:
        print("No controllers are loaded in mechanism control")
    for controller in controllers:
        print(f"'{controller.name}' - '{controller.type}' ( {controller.state} )")
    return True


def list_types() -> bool:
    """Print the types that can be loaded."""
    for name in call("list_controller_types", ListControllerTypes).types:
        print(name)
    return True


def reload_libraries(restore: bool) -> bool:
    """Unload everything and load the types afresh; restore puts the controllers back."""
    before = call("list_controllers", ListControllers).controller if restore else []
    ok = call("reload_controller_libraries", ReloadControllerLibraries, True).ok
    print("Successfully reloaded libraries" if ok else "Failed to reload libraries")
    for controller in before:
        ok = load(controller.name) and ok
    for controller in before:
        if controller.state == "running":
            ok = start(controller.name) and ok
    return ok


def run(command: str, names: list[str], restore: bool) -> bool:
    """Run one command; returns whether all of it worked."""
    each = {"load": [load], "unload": [unload], "start": [start], "stop": [stop]}
    both = {"spawn": (load, start), "kill": (stop, unload)}
    if command in each:
        return all([action(name) for action in each[command] for name in names])
    if command in both:
        return all([action(name) for action in both[command] for name in names])
    if command == "list":
        return list_controllers()
    if command == "list-types":
        return list_types()
    return reload_libraries(restore)


def main() -> int:
    """Entry point; returns the exit status."""
    parser = argparse.ArgumentParser(prog="controller_manager", description=__doc__)
    parser.add_argument("command", choices=[*COMMANDS, "reload-libraries", *ALIASES])
    parser.add_argument("names", nargs="*", help="controller names")
    parser.add_argument("--restore", action="store_true", help="load them again after a reload")
    args = parser.parse_args(rospy.myargv(sys.argv)[1:])
    begin_node("controller_manager", anonymous=True)
    try:
        ok = run(ALIASES.get(args.command, args.command), args.names, args.restore)
    except rospy.ROSInterruptException:
        return 1
    except (rospy.ServiceException, rospy.ROSException) as error:
        print(f"The controller manager did not answer: {error}", file=sys.stderr)
        return 1
    return 0 if ok else 1
