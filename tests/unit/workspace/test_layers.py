"""Imports between layers only go down; computation does not import ROS."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

import pytest

SOURCES = Path(__file__).parents[3] / "src"
LIBRARIES = {package: SOURCES / package / "src" / package for package in (
    "aras_sim_bridge", "aras_visual_servo_camera", "aras_visual_servo_controller",
    "aras_visual_servo_bench", "aras_visual_servo_ros", "aras_visual_servo_base",
)}
# What each package may take from the others, besides their generated messages.
ALLOWED = {
    "aras_visual_servo_base": set(),
    "aras_visual_servo_ros": {"aras_visual_servo_base"},
    "aras_sim_bridge": {"aras_visual_servo_base", "aras_visual_servo_ros"},
    "aras_visual_servo_camera": {"aras_visual_servo_base", "aras_visual_servo_ros"},
    "aras_visual_servo_controller": {
        "aras_visual_servo_base", "aras_visual_servo_camera", "aras_visual_servo_ros",
    },
    "aras_visual_servo_bench": {
        "aras_sim_bridge", "aras_visual_servo_base", "aras_visual_servo_camera",
        "aras_visual_servo_controller", "aras_visual_servo_ros",
    },
}


# The floors of a package: a room, a folder or a module, imports from rooms on lower floors,
# never from one on its own floor. A room of a folder, as web/live, is named where its own floor is
# another than the folder's.
FLOORS = {
    "aras_sim_bridge": (
        {"errors"}, {"angles"}, {"pose_interpolation"}, {"description"}, {"control", "world"},
        {"rendering", "control_cycle"}, {"camera", "controlled_model", "lighting", "sensors"},
        {"simulation"}, {"ros"},
    ),
    "aras_visual_servo_camera": (
        {"edge_pixels", "errors", "formula", "polygons"}, {"moment_sums"},
        {"feature_formulas", "images", "markers", "moments"}, {"segmentation_settings"},
        {"camera_model", "degeneracy", "feature_plan", "interaction", "intersection_accuracy",
         "kernel", "segmented_target"},
        {"compiled_contour", "label_segmentation", "model_tracker", "pixel_coverage", "silhouette",
         "target_orientation"},
        {"contour", "detection_pipeline", "label_subscribers", "moment_feature_values", "trackers"},
        {"messages", "overlay", "parameters"}, {"detection_publishers"}, {"camera_node"}, {"node"},
    ),
    "aras_visual_servo_controller": (
        {"errors", "interaction_check_defaults"}, {"laws"}, {"kinematics"},
        {"observation", "teleop"}, {"goals"}, {"features"}, {"schemes"}, {"records"},
        {"diagnosis"}, {"loop"}, {"parameters"}, {"camera_settings"}, {"settings"}, {"runner"},
        {"ros"},
    ),
    "aras_visual_servo_bench": (
        {"errors", "progress_bar"}, {"targets"}, {"experiment"}, {"plants"}, {"setup"},
        {"recording"}, {"metrics", "runner"}, {"studies"}, {"plots"}, {"visualization"}, {"web"},
        {"web/report"}, {"web/browse", "web/live"}, {"ros"}, {"run_loading"}, {"cli"},
        {"__main__", "learning"},
    ),
}
# What may import pages, inside functions or for types alone: commands and nodes that start one, and
# the public interface.
STARTERS = ("__init__.py", "cli/analyze.py", "cli/browse.py", "cli/show_and_tune.py",
            "ros/dashboard.py", "ros/demo.py")  # fmt: skip


def absolute_names(node: ast.AST, file: Path) -> set[str]:
    """Absolute names of the modules, and of what is taken from them, of an import."""
    if isinstance(node, ast.Import):
        return {alias.name for alias in node.names}
    base = node.module or ""
    if node.level:
        inside = file.parts[len(file.parts) - file.parts[::-1].index("src"):]
        base = ".".join([*inside[: len(inside) - node.level], *filter(None, [node.module])])
    return {base} | {f"{base}.{alias.name}" for alias in node.names}


@cache
def statements(file: Path) -> tuple[list[ast.stmt], list[ast.stmt]]:
    """Return the statements of `file` at its top, and its imports and classes anywhere."""
    module = ast.parse(file.read_text(), str(file))
    kinds = ast.Import | ast.ImportFrom | ast.ClassDef
    return module.body, [node for node in ast.walk(module) if isinstance(node, kinds)]


def names_of(nodes: list[ast.stmt], file: Path) -> set[str]:
    return set().union(*(absolute_names(node, file) for node in nodes
                         if isinstance(node, ast.Import | ast.ImportFrom)))  # fmt: skip


@cache
def imports(file: Path) -> set[str]:
    """Absolute names of all modules that `file` imports, wherever and however it does."""
    return names_of(statements(file)[1], file)


def room_of(package: str, path: tuple[str, ...]) -> str:
    """Return the group (room) of a package to which a module belongs.

    path: folders and module below the package.
    """
    rooms = set().union(*FLOORS[package])
    for length in range(len(path), 1, -1):
        if (room := "/".join(path[:length])) in rooms:
            return room
    return path[0]


def floor(package: str, room: str) -> int:
    """Return the layer number of a group of a package."""
    found = [height for height, rooms in enumerate(FLOORS[package]) if room in rooms]
    assert found, f"{package}/{room}: a room without a floor; give it one in FLOORS"
    return found[0]


def rooms_imported(package: str, file: Path) -> set[str]:
    """The rooms of its own package from which `file` takes something."""
    library = LIBRARIES[package]
    tops = {room.stem for room in library.iterdir() if room.suffix in ("", ".py")}
    names = [tuple(name.split(".")) for name in imports(file)]
    paths = [name[1:] for name in names if name[0] == package and len(name) > 1]
    return {room_of(package, path) for path in paths if path[0] in tops}


@pytest.mark.parametrize("package", FLOORS)
def test_imports_go_down_from_floor_to_floor(package: str) -> None:
    library = LIBRARIES[package]
    for file in library.rglob("*.py"):
        path = file.relative_to(library).with_suffix("").parts
        if path == ("__init__",):
            continue
        room = room_of(package, path)
        for other in rooms_imported(package, file) - {room}:
            assert floor(package, other) < floor(package, room), (
                f"{package}: {'/'.join(path)} imports {other}, which does not lie below {room}"
            )


def test_only_what_starts_a_page_imports_pages_and_only_then() -> None:
    library = LIBRARIES["aras_visual_servo_bench"]
    web = "aras_visual_servo_bench.web"
    for file in library.rglob("*.py"):
        name = file.relative_to(library).as_posix()
        if not name.startswith("web/"):
            found = {one for one in imports(file) if f"{one}.".startswith(f"{web}.")}
            assert not found or name in STARTERS, f"{name} imports {found}"
            assert not found & imported_at_once(file), f"{name} imports {found} at its top"


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


def imported_at_once(file: Path) -> set[str]:
    """Return the imports that are executed when `file` is imported, without those for types."""
    return names_of(statements(file)[0], file)


def test_no_modules_import_each_other() -> None:
    """No module comes back to itself by imports: those for types alone and those inside of
    functions count too, and so do the packages that are made on the way."""
    modules = {}
    for root in LIBRARIES.values():
        for file in root.rglob("*.py"):
            parts = file.relative_to(root.parent).with_suffix("").parts
            modules[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = file
    edges = {name: edges_of(name, file, set(modules)) for name, file in modules.items()}
    done: set[str] = set()

    def visit(name: str, path: tuple[str, ...]) -> None:
        assert name not in path, " -> ".join((*path[path.index(name):], name))
        if name not in done:
            for wanted in sorted(edges[name]):
                visit(wanted, (*path, name))
            done.add(name)

    for name in sorted(modules):
        visit(name, ())


def edges_of(name: str, file: Path, modules: set[str]) -> set[str]:
    """The modules that module `name` imports, with the packages that Python makes for them; not
    those that hold itself, which are under way."""
    found = set()
    for wanted in imports(file) & modules:
        found |= {wanted[:k] for k, c in enumerate(wanted) if c == "."} | {wanted}
    return {wanted for wanted in found & modules
            if wanted != name and not name.startswith(f"{wanted}.")}


def test_a_class_name_is_used_once() -> None:
    """A reader who meets a class in two modules is not to wonder whether it is the same one."""
    places: dict[str, list[str]] = {}
    for file in SOURCES.rglob("*.py"):
        for node in statements(file)[1]:
            if isinstance(node, ast.ClassDef):
                places.setdefault(node.name, []).append(str(file.relative_to(SOURCES)))
    assert {name: found for name, found in places.items() if len(found) > 1} == {}
