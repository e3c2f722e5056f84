"""Which sources and which tests belong to an area."""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from pathlib import Path

BASE = "src/aras_visual_servo_base/src/aras_visual_servo_base"
BRIDGE = "src/aras_sim_bridge/src/aras_sim_bridge"
VISION = "src/aras_visual_servo_camera/src/aras_visual_servo_camera"
CONTROLLER = "src/aras_visual_servo_controller/src/aras_visual_servo_controller"
BENCH = "src/aras_visual_servo_bench/src/aras_visual_servo_bench"


class UnknownAreaError(Exception):
    """No area of this name, or one that has no sources or no tests yet."""


@dataclass(frozen=True)
class Area:
    """Sources as globs from the workspace's top; folders of tests, or files without their .py.

    `without` are globs of sources that are left out. `graph` are test files that need a ROS
    graph; they run where unit tests find nothing.
    """

    name: str
    sources: tuple[str, ...]
    tests: tuple[str, ...]
    without: tuple[str, ...] = ()
    graph: tuple[str, ...] = ()

    def source_files(self, top: Path) -> list[Path]:
        """All sources, in order of their names; raises UnknownAreaError where there are none."""
        left_out = {file for glob in self.without for file in top.glob(glob)}
        files = {file for glob in self.sources for file in top.glob(glob)} - left_out
        if not files:
            known = ", ".join(self.sources)
            raise UnknownAreaError(f"area {self.name} has no sources yet: {known}")
        return sorted(files)

    def test_files(self, top: Path) -> list[Path]:
        """All files of unit tests, in order of their names; raises UnknownAreaError for none."""
        files = set()
        for entry in self.tests:
            files |= set(top.glob(f"{entry}/**/test_*.py")) | set(top.glob(f"{entry}*.py"))
        if not files:
            raise UnknownAreaError(f"area {self.name} has no tests yet: {', '.join(self.tests)}")
        return sorted(files)


_INTEGRATION = "tests/integration"

AREAS = {
    area.name: area
    for area in (
        Area("rendering", (f"{BRIDGE}/rendering/**/*.py",), ("tests/unit/camera",)),
        Area("camera", (f"{BRIDGE}/camera/**/*.py",), ("tests/unit/camera",)),
        Area("control", (f"{BRIDGE}/control/**/*.py",),
             ("tests/unit/control", "tests/unit/world/test_step_response",
              "tests/unit/world/test_cycle")),
        Area("world", (f"{BRIDGE}/world/**/*.py",), ("tests/unit/world",)),
        Area("description", (f"{BRIDGE}/description/**/*.py",),
             ("tests/unit/description", "tests/unit/world", "tests/unit/robot",
              "tests/unit/camera")),
        Area("simulation", (f"{BRIDGE}/*.py",),
             ("tests/unit/world", "tests/unit/control", "tests/unit/camera")),
        Area("ros", (f"{BRIDGE}/ros/**/*.py",),
             ("tests/unit/ros", "tests/unit/control", "tests/unit/camera", "tests/unit/world"),
             without=(f"{BRIDGE}/ros/cli/*.py",),
             graph=tuple(f"{_INTEGRATION}/test_bridge_{name}.py" for name in (
                 "gazebo_api", "resets", "lockstep", "controllers", "controller_manager"))
             + (f"{_INTEGRATION}/test_camera_topics.py",)),
        Area("vision", (f"{VISION}/**/*.py",), ("tests/unit/features",),
             without=(f"{VISION}/node.py",)),
        Area("kinematics", (f"{CONTROLLER}/arm/*.py",), ("tests/unit/servo", "tests/unit/arm")),
        Area("laws", (f"{CONTROLLER}/laws/*.py",), ("tests/unit/servo",)),
        Area("features", (f"{CONTROLLER}/features/*.py", f"{CONTROLLER}/schemes/*.py"),
             ("tests/unit/servo", "tests/unit/features")),
        Area("servo",
             (f"{CONTROLLER}/*.py", *(f"{CONTROLLER}/{room}/*.py" for room in (
                 "goals", "hands", "loop", "seeing"))),
             ("tests/unit/servo", "tests/unit/loop")),
        Area("judging", (f"{CONTROLLER}/judging/*.py",), ("tests/unit/servo",)),
        Area("bench", (f"{BENCH}/**/*.py",), ("tests/unit/bench", "tests/unit/study"),
             without=(f"{BENCH}/ros/**/*.py",)),
        Area("base", (f"{BASE}/*.py",), ("tests/unit/base", "tests/unit/workspace/test_moved",
              "tests/unit/workspace/test_loops")),
    )
}


def area_named(name: str) -> Area:
    """The area; raises UnknownAreaError with the known ones and the nearest."""
    if name in AREAS:
        return AREAS[name]
    near = difflib.get_close_matches(name, AREAS, 1)
    guess = f"did you mean {near[0]}? " if near else ""
    raise UnknownAreaError(f"no area {name}; {guess}known: {', '.join(AREAS)}")
