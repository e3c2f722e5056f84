"""Which sources and which tests belong to an area."""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from pathlib import Path

from .sources import is_source

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
        files = {file for glob in self.sources for file in top.glob(glob)
                 if is_source(top, str(file.relative_to(top)))} - left_out
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
_UNIT = "tests/unit"

AREAS = {
    area.name: area
    for area in (
        Area("rendering", (f"{BRIDGE}/rendering/**/*.py",), (f"{_UNIT}/camera",)),
        Area("camera", (f"{BRIDGE}/camera/**/*.py", f"{BRIDGE}/sensors/**/*.py"),
             (f"{_UNIT}/camera", f"{_UNIT}/world/test_sensors", f"{_UNIT}/world/test_stereo",
              f"{_UNIT}/bench/test_camera_sensors")),
        Area("control", (f"{BRIDGE}/control/**/*.py",),
             (f"{_UNIT}/as_new", f"{_UNIT}/control", f"{_UNIT}/world/test_step_",
              f"{_UNIT}/world/test_cycle", f"{_UNIT}/world/test_foreign_robots",
              f"{_UNIT}/world/test_command_streams", f"{_UNIT}/world/test_hard_limits")),
        Area("world", (f"{BRIDGE}/world/**/*.py",), (f"{_UNIT}/world",)),
        Area("description", (f"{BRIDGE}/description/**/*.py",),
             (f"{_UNIT}/description", f"{_UNIT}/world", f"{_UNIT}/robot", f"{_UNIT}/camera",
              f"{_UNIT}/ros/test_spawn_namespaces")),
        Area("simulation", (f"{BRIDGE}/*.py",),
             (f"{_UNIT}/world", f"{_UNIT}/control", f"{_UNIT}/camera", f"{_UNIT}/description")),
        Area("ros", (f"{BRIDGE}/ros/**/*.py",),
             (f"{_UNIT}/ros", f"{_UNIT}/control", f"{_UNIT}/camera",
              f"{_UNIT}/world/test_divergence", f"{_UNIT}/docs/test_tables"),
             graph=tuple(f"{_INTEGRATION}/test_bridge_{name}.py" for name in (
                 "scene", "resets", "lockstep", "controllers", "controller_manager"))
             + (f"{_INTEGRATION}/test_camera_topics.py",)),
        Area("vision", (f"{VISION}/**/*.py",),
             (f"{_UNIT}/features", f"{_UNIT}/camera/test_model_tracking",
              f"{_UNIT}/bench/test_textures", f"{_UNIT}/servo/test_silhouettes",
              f"{_UNIT}/servo/test_features", f"{_UNIT}/bench/test_markers"),
             without=(f"{VISION}/node.py",)),
        Area("kinematics", (f"{CONTROLLER}/arm/*.py",), (f"{_UNIT}/servo", f"{_UNIT}/arm")),
        Area("laws", (f"{CONTROLLER}/laws/*.py",),
             (f"{_UNIT}/servo", f"{_UNIT}/ros/test_gains")),
        Area("features", tuple(f"{CONTROLLER}/{room}/*.py" for room in (
                 "features", "schemes", "goals")),
             (f"{_UNIT}/servo", f"{_UNIT}/features", f"{_UNIT}/settings",
              f"{_UNIT}/bench/test_half_turn", f"{_UNIT}/bench/test_users_answers")),
        Area("servo",
             (f"{CONTROLLER}/*.py", *(f"{CONTROLLER}/{room}/*.py" for room in (
                 "hands", "loop", "seeing"))),
             (f"{_UNIT}/as_new", f"{_UNIT}/servo", f"{_UNIT}/loop")),
        Area("judging", (f"{CONTROLLER}/judging/*.py",),
             (f"{_UNIT}/as_new", f"{_UNIT}/servo", f"{_UNIT}/docs/test_figures")),
        Area("study", (f"{BENCH}/study/*.py", f"{BENCH}/numbers/*.py"),
             (f"{_UNIT}/properties",
              f"{_UNIT}/study", f"{_UNIT}/loop", f"{_UNIT}/bench/test_protocols",
              f"{_UNIT}/bench/test_report.py", f"{_UNIT}/bench/test_report_recomputed",
              f"{_UNIT}/bench/test_browse")),
        Area("live", (f"{BENCH}/live/*.py",),
             (f"{_UNIT}/properties",
              f"{_UNIT}/bench/test_page", f"{_UNIT}/bench/test_story",
              f"{_UNIT}/bench/test_keeping", f"{_UNIT}/bench/test_browse.py")),
        Area("report", tuple(f"{BENCH}/{room}/*.py" for room in (
                 "report", "pictures", "browse", "recording")),
             (f"{_UNIT}/bench/test_report", f"{_UNIT}/bench/test_browse",
              f"{_UNIT}/bench/test_palette", f"{_UNIT}/bench/test_several_cameras",
              f"{_UNIT}/ros/test_bags", f"{_UNIT}/study")),
        Area("bench",
             (f"{BENCH}/*.py", *(f"{BENCH}/{room}/*.py" for room in (
                 "asked", "targets", "plants", "running", "learning", "commands"))),
             (f"{_UNIT}/as_new", f"{_UNIT}/properties",
              f"{_UNIT}/bench", f"{_UNIT}/loop", f"{_UNIT}/settings", f"{_UNIT}/truth",
              f"{_UNIT}/study",
              f"{_UNIT}/servo/test_solid_targets", f"{_UNIT}/servo/test_matches",
              f"{_UNIT}/servo/test_link_targets", f"{_UNIT}/servo/test_silhouettes")),
        Area("nodes",
             (f"{BENCH}/ros/*.py", f"{CONTROLLER}/ros/*.py", f"{VISION}/node.py",
              "src/aras_visual_servo_ros/src/**/*.py", "src/*/nodes/*",
              "src/aras_visual_servo_bench/scripts/*", "src/upstream_*/*/scripts/*",
              "src/upstream_*/*/src/**/*.py"),
             (f"{_UNIT}/ros", f"{_UNIT}/bench/test_demo_words", f"{_UNIT}/bench/test_keeping",
              f"{_UNIT}/features/test_vision_messages", f"{_UNIT}/servo/test_parameters",
              f"{_UNIT}/servo/test_teleop", f"{_UNIT}/servo/test_teach", f"{_UNIT}/workspace",
              f"{_UNIT}/settings")),
        Area("robots", ("src/aras_visual_servo_gazebo/scripts/*",),
             (f"{_UNIT}/robot", f"{_UNIT}/description", f"{_UNIT}/workspace/test_scripts")),
        Area("base", (f"{BASE}/**/*.py",),
             (f"{_UNIT}/properties",
              f"{_UNIT}/base", f"{_UNIT}/settings", f"{_UNIT}/description/test_tree",
              f"{_UNIT}/description/test_urdf", f"{_UNIT}/camera/test_lens",
              f"{_UNIT}/features/test_undistortion", f"{_UNIT}/servo/test_laws",
              f"{_UNIT}/description/test_gltf_files", f"{_UNIT}/description/test_mesh_files",
              f"{_UNIT}/description/test_shapes", f"{_UNIT}/arm/test_arm",
              f"{_UNIT}/arm/test_kinematics", f"{_UNIT}/bench/test_eye_to_hand",
              f"{_UNIT}/workspace/test_moved", f"{_UNIT}/workspace/test_loops")),
    )
}
# In no area, and why.
LEFT_OUT = {
    "src/*/setup.py": "catkin runs it when the workspace is built",
    "src/upstream_*/*/setup.py": "catkin runs it when the workspace is built",
}
# Folders of tests below tests/unit that are of no area, and why.
TESTS_LEFT_OUT = {
    "docs": "documentation, its code blocks and figures excepted",
    "mutation": "this tool",
}


def area_named(name: str) -> Area:
    """The area; raises UnknownAreaError with the known ones and the nearest."""
    if name in AREAS:
        return AREAS[name]
    near = difflib.get_close_matches(name, AREAS, 1)
    guess = f"did you mean {near[0]}? " if near else ""
    raise UnknownAreaError(f"no area {name}; {guess}known: {', '.join(AREAS)}")
