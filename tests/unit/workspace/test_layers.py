"""Imports go down only: what computes is plain Python, ROS is a skin over it."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

SOURCES = Path(__file__).parents[3] / "src"
LIBRARIES = {package: SOURCES / package / "src" / package for package in (
    "aras_sim_bridge", "aras_visual_servo_camera", "aras_visual_servo_controller",
    "aras_visual_servo_bench",
)}
# What each package may take from the others, besides their generated messages.
ALLOWED = {
    "aras_sim_bridge": set(),
    "aras_visual_servo_camera": set(),
    "aras_visual_servo_controller": {"aras_visual_servo_camera"},
    "aras_visual_servo_bench": {
        "aras_sim_bridge", "aras_visual_servo_camera", "aras_visual_servo_controller"
    },
}


def imports(file: Path) -> set[str]:
    """Absolute names of all modules that `file` imports, wherever in the file."""
    names = set()
    for node in ast.walk(ast.parse(file.read_text(), str(file))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return names


@pytest.mark.parametrize("package", LIBRARIES)
def test_packages_meet_only_where_they_may(package: str) -> None:
    for file in LIBRARIES[package].rglob("*.py"):
        for name in imports(file):
            top, _, rest = name.partition(".")
            if top in LIBRARIES and top != package and rest.split(".")[0] not in ("msg", "srv"):
                assert top in ALLOWED[package] or not rest and _only_messages(file, top), (
                    f"{file.relative_to(SOURCES)} imports {name}"
                )


def _only_messages(file: Path, package: str) -> bool:
    names = {name for name in imports(file) if name.startswith(package + ".")}
    return bool(names) and all(name.split(".")[1] in ("msg", "srv") for name in names)


@pytest.mark.parametrize("package", ["aras_sim_bridge", "aras_visual_servo_bench"])
def test_floors_below_the_skin_know_no_ros(package: str) -> None:
    library = LIBRARIES[package]
    for file in library.rglob("*.py"):
        if "ros" not in file.relative_to(library).parts:
            tops = {name.split(".")[0] for name in imports(file)}
            assert not tops & {"rospy", "tf", "tf2_ros", "actionlib", "dynamic_reconfigure"}, file


def test_nodes_are_thin() -> None:
    for node in SOURCES.glob("aras_*/nodes/*"):
        if node.is_file():
            assert len(node.read_text().splitlines()) <= 20, f"{node}: belongs into the library"
