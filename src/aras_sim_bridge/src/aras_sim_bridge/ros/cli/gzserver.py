"""Start the simulator with the command line of Gazebo's gzserver and gazebo."""

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

# Options of Gazebo that are accepted without effect: physics engines, plug-ins, log files and
# others.
_OPTIONS_WITH_VALUE = (
    ("-e", "--physics"), ("-o", "--profile"), ("-s", "--server-plugin"), ("-g", "--gui-plugin"),
    ("-p", "--play"), ("--iters",), ("--gui-client-plugin",), ("--initial_sim_time",),
    ("--record_path",), ("--record_encoding",), ("--record_period",),
)  # fmt: skip
_FLAGS = (("-r", "--record"), ("-q", "--quiet"), ("--lockstep",), ("--minimal_comms",))


def parse(argv: list[str]) -> argparse.Namespace:
    """Parse the command line.

    The result has the attributes `world` ('' means ground plane and sun), `paused`, `verbose` and
    `seed` (None if not given). Its other attributes are not used.
    """
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
    """Return the path of a world file, or '' if the name is empty.

    The function searches the working directory, the folders of GAZEBO_RESOURCE_PATH and the package
    gazebo_ros.

    Raises:
        DescriptionError: the file does not exist in any of these folders.
    """
    if not name:
        return ""
    resource_paths = os.environ.get("GAZEBO_RESOURCE_PATH", "").split(os.pathsep)
    folders = [Path("."), *map(Path, filter(None, resource_paths))]
    with contextlib.suppress(rospkg.ResourceNotFound):
        folders.append(Path(rospkg.RosPack().get_path("gazebo_ros")))
    for folder in folders:
        if (folder / name).is_file():
            return str((folder / name).resolve())
    searched = ", ".join(str(folder.absolute()) for folder in folders)
    raise DescriptionError(
        f"there is no world file '{name}' in {searched}; give its full path or add its folder to "
        "GAZEBO_RESOURCE_PATH"
    )


def read_parameters(argv: list[str]) -> dict[str, object]:
    """Return the parameters of the simulator node that the command line sets.

    Raises:
        DescriptionError: there is no such world file.
    """
    arguments = parse(argv)
    parameters = {"world": find_world(arguments.world), "paused": arguments.paused}
    if arguments.seed is not None:
        parameters["seed"] = arguments.seed
    if arguments.verbose:
        parameters["log_level"] = "debug"
    return parameters


def main() -> int:
    """Run the simulator node with the parameters of the command line; return the exit status."""
    try:
        parameters = read_parameters(rospy.myargv()[1:])
    except DescriptionError as error:
        print(f"gzserver: {error}", file=sys.stderr)
        return 1
    return node.main(parameters)
