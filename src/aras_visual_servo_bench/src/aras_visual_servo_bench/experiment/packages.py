"""Find ROS packages without ROS: in given folders, next to this package, then on ROS's path."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from aras_sim_bridge.errors import DescriptionError
from aras_visual_servo_base.names import find_nearest
from aras_visual_servo_base.setting_values import format_value

from ..errors import ExperimentError

# folder src/ of the workspace, if the package is not installed
_SOURCES = Path(__file__).resolve().parents[4]
_SHARE = Path(os.sys.prefix) / "share"


class PackagePath:
    """Search path for ROS packages: given folders, the folder of this package, then ROS's own path.

    search: folders that are searched first. Each is a package, or contains packages.
    """

    def __init__(self, search: Sequence[str | Path] = ()) -> None:
        self._search = [Path(folder).expanduser() for folder in search]

    def find(self, name: str) -> str:
        """Return the folder of the package `name`.

        Raises:
            ExperimentError: there is no package with this name.
        """
        for folder in (*self._search, _SOURCES, _SHARE):
            for place in (folder / name, folder):
                if place.name == name and (place / "package.xml").is_file():
                    return str(place)
        from aras_sim_bridge.description import packages as environment

        try:
            return environment.find_package(name)
        except DescriptionError as error:
            searched = ", ".join(str(folder) for folder in (*self._search, _SOURCES))
            raise ExperimentError(
                f"package '{name}' is neither in {searched} nor in ROS_PACKAGE_PATH: add its "
                "folder to robot.search"
            ) from error

    def resolve(self, text: str) -> Path:
        """Return the path of the file that `text` names: `package://name/path` or a path.

        Raises:
            ExperimentError: there is no such package or file.
        """
        if text.startswith("package://"):
            name, _, inside = text.removeprefix("package://").partition("/")
            path = Path(self.find(name)) / inside
        else:
            path = Path(text).expanduser()
        if "\n" in text or "\0" in text:
            raise ExperimentError(
                f"{format_value(text)} is not a path: write the text to a file, and give "
                "the file's path"
            )
        if not path.is_file():
            siblings = [file.name for file in path.parent.glob(f"*{path.suffix}") if path.suffix]
            near = find_nearest(path.name, siblings)
            raise ExperimentError(
                f"there is no file {path}" + ("" if str(path) == text else f" (given as {text})")
                + (f": did you mean '{near}'?" if near else "")
            )
        return path
