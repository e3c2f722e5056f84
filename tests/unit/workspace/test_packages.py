"""package.xml names the packages that are imported, and no other Python packages."""

import ast
import sys
import tomllib
from functools import cache
from pathlib import Path
from xml.etree import ElementTree

import pytest

SOURCES = Path(__file__).resolve().parents[3] / "src"
PACKAGES = sorted(manifest.parent for manifest in SOURCES.rglob("package.xml"))

# rosdep's keys where they are not the module's own name; what has none is installed by pip alone.
KEYS = {
    "PIL": "python3-pil",
    "collada": "python3-collada",
    "cv2": "python3-opencv",
    "gymnasium": "python3-gymnasium-pip",
    "genpy": "genpy",
    "mcap": "python3-mcap-pip",
    "mpl_toolkits": "python3-matplotlib",
    "pybullet": "python3-pybullet-pip",
    **{
        name: f"python3-{name}"
        for name in ("dask", "distributed", "jinja2", "matplotlib", "numba", "numpy", "pandas",
                     "pyarrow", "rospkg", "scipy", "tornado")
    },
    "sklearn": "python3-sklearn",
    "svgelements": "python3-svgelements-pip",
    "trimesh": "python3-trimesh-pip",
    "yaml": "python3-yaml",
}
ELSEWHERE = {  # scripts beside the importing one
    "arm_parts", "gantry_parts", "mesh_primitives", "workbench_textures",
}


def programs(package: Path) -> list[Path]:
    """The Python files of a package that are installed or run."""
    named = [p for folder in ("nodes", "scripts") for p in package.glob(f"{folder}/*")]
    return [*package.glob("src/**/*.py"), *(path for path in named if path.is_file())]


@cache
def imported(path: Path) -> frozenset[str]:
    """Top-level modules that a file imports, the standard library's left out."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names.update(alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            names.add(node.module.split(".")[0])
    return frozenset(names - set(sys.stdlib_module_names))


def named(package: Path) -> set[str]:
    """Return the packages that a package's manifest lists as run-time dependencies."""
    root = ElementTree.parse(package / "package.xml").getroot()
    return {tag.text for kind in ("depend", "exec_depend") for tag in root.iter(kind)}


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.name)
def test_manifest_names_what_is_imported(package):
    modules = {name for path in programs(package) for name in imported(path)}
    needed = {KEYS.get(name, name) for name in modules - {package.name} - ELSEWHERE}
    assert needed - named(package) == set()
    surplus = {key for key in named(package) - needed if key.startswith("python3-")}
    assert surplus == set(), "named but never imported"


def test_what_is_no_python_is_installed_with_its_package():
    """By pip, by pyproject.toml's patterns, and by catkin, by setup.py's."""
    data = tomllib.loads((SOURCES.parent / "pyproject.toml").read_text())
    patterns = data["tool"]["setuptools"]["package-data"]
    found = set()
    for package in PACKAGES:
        for path in package.glob("src/**/*"):
            if path.is_file() and path.suffix not in (".py", ".pyc", ".nbi", ".nbc"):
                module = next(up for up in path.parents if (up / "__init__.py").is_file())
                name = ".".join(module.relative_to(package / "src").parts)
                found.add(name)
                assert any(path.match(f"{module}/{p}") for p in patterns.get(name, ())), path
                setup = (package / "setup.py").read_text()
                assert all(f'"{p}"' in setup for p in (name, *patterns[name])), path
    web, studies = "aras_visual_servo_bench.web", "aras_visual_servo_bench.studies"
    assert found == {studies, web, *(f"{web}.{page}" for page in ("browse", "live", "report"))}


def test_no_package_needs_itself_by_way_of_others():
    """`catkin build` waits for what a package needs to run, too: for ever, in a circle."""
    left = {package.name: named(package) for package in PACKAGES}
    while ready := [name for name, wants in left.items() if not wants & left.keys()]:
        for name in ready:
            del left[name]
    assert not left


def test_pips_package_asks_for_what_its_command_line_imports():
    """And the extras for the rest; what ROS brings is imported by nodes alone."""
    project = tomllib.loads((SOURCES.parent / "pyproject.toml").read_text())
    told = project["project"]
    assert told["scripts"] == {"aras-servo": "aras_visual_servo_bench.cli:main"}
    names = {"cv2": "opencv-python-headless", "PIL": "pillow", "yaml": "PyYAML",
             "collada": "pycollada", "mpl_toolkits": "matplotlib", "sklearn": "scikit-learn"}
    extras = told["optional-dependencies"]
    known = {*told["dependencies"], *(name for some in extras.values() for name in some)}
    roots = project["tool"]["setuptools"]["packages"]["find"]["where"]
    own = {path.name for root in roots for path in (SOURCES.parent / root).iterdir()}
    own |= {"rosbag", "rospy", "aras_visual_servo_ros", "std_msgs", "sensor_msgs", "geometry_msgs"}
    asked = {"youplot==1.0.0"}  # uPlot's files, which are read and not imported
    for root in roots:
        for path in (SOURCES.parent / root).rglob("*.py"):
            if "ros" not in path.relative_to(SOURCES.parent / root).parts:
                asked |= {names.get(name, name) for name in imported(path) - own}
    assert asked - known == set()
    assert set(told["dependencies"]) - asked == set(), "asked for but never imported"
