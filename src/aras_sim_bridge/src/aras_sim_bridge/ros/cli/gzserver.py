"""gzserver and gazebo: the simulator with Gazebo's own command line, as launch files give it."""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
from pathlib import Path

import rospkg
import rospy

from aras_sim_bridge.errors import DescriptionError
from aras_sim_bridge.ros.runtime import node

# Accepted for Gazebo's sake: there are no other engines, plugins of the server, or logs to play.
_OPTIONS_WITH_VALUE = (
    ("-e", "--physics"), ("-o", "--profile"), ("-s", "--server-plugin"), ("-g", "--gui-plugin"),
    ("-p", "--play"), ("--iters",), ("--gui-client-plugin",), ("--initial_sim_time",),
    ("--record_path",), ("--record_encoding",), ("--record_period",),
)  # fmt: skip
_FLAGS = (("-r", "--record"), ("-q", "--quiet"), ("--lockstep",), ("--minimal_comms",))


def parse(argv: list[str]) -> argparse.Namespace:
    """Return world ('' for ground and sun), paused, verbose, seed (None: not given), and more that
    has no meaning here."""
    parser = argparse.ArgumentParser(
        prog="gzserver", description=__doc__, allow_abbrev=False,
        epilog="example: rosrun gazebo_ros gzserver worlds/empty.world",
    )  # fmt: skip
    parser.add_argument("world", nargs="?", default="", help="world file (SDF)")
    parser.add_argument("-u", "--pause", dest="paused", action="store_true", help="start paused")
    parser.add_argument("--verbose", action="store_true", help="log in detail")
    parser.add_argument("--seed", type=int, help="seed of the sensors' noise")
    for names in _OPTIONS_WITH_VALUE:
        parser.add_argument(*names, action="append", help=argparse.SUPPRESS)
    for names in _FLAGS:
        parser.add_argument(*names, action="store_true", help=argparse.SUPPRESS)
    return parser.parse_args(argv)


def find_world(name: str) -> str:
    """Path of a world file: as named, below GAZEBO_RESOURCE_PATH, or among gazebo_ros's own.

    Raises:
        DescriptionError: it is in none of them.
    """
    if not name:
        return ""
    named = os.environ.get("GAZEBO_RESOURCE_PATH", "").split(os.pathsep)
    folders = [Path("."), *map(Path, filter(None, named))]
    with contextlib.suppress(rospkg.ResourceNotFound):
        folders.append(Path(rospkg.RosPack().get_path("gazebo_ros")))
    for folder in folders:
        if (folder / name).is_file():
            return str((folder / name).resolve())
    looked = ", ".join(str(folder.absolute()) for folder in folders)
    raise DescriptionError(
        f"there is no world file '{name}' in {looked}; give a path, or name its folder in "
        "GAZEBO_RESOURCE_PATH"
    )


def main() -> int:
    """Put the command line into the node's parameters and run it; returns the exit status."""
    arguments = parse(rospy.myargv()[1:])
    try:
        world = find_world(arguments.world)
    except DescriptionError as error:
        print(f"gzserver: {error}", file=sys.stderr)
        return 1
    given = {"world": world, "paused": arguments.paused}
    if arguments.seed is not None:
        given["seed"] = arguments.seed
    if arguments.verbose:
        given["log_level"] = "debug"
    return node.main(given)
