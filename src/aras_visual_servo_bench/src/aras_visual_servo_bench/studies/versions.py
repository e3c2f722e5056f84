"""Which code computes: what results are told with, and what workers must agree on."""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import importlib.util
import platform
import re
import subprocess
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from ..errors import ExperimentError
from ..experiment.packages import PackagePath

SOURCE_FOLDER = Path(__file__).resolve().parents[4]  # src/ of the workspace
# beside this package are the others, installed
INSTALL_FOLDER = Path(__file__).resolve().parents[2]
PACKAGES = (
    "aras_sim_bridge", "aras_visual_servo_camera", "aras_visual_servo_controller",
    "aras_visual_servo_bench", "aras_visual_servo_gazebo",
)  # fmt: skip
# Studies' settings: a study stores its own with its digest.
EXCLUDED_FOLDER = ("config", "studies")
SOURCE_SUFFIXES = (
    ".py", ".yaml", ".urdf", ".world", ".dae", ".glb", ".gltf", ".stl", ".obj", ".mtl", ".png",
    ".npz",
)  # fmt: skip
CLASS_PATH = re.compile(r"([A-Za-z_]\w*(?:\.\w+)*):[A-Za-z_]\w*")  # package.module:Class
# Those whose numbers go into a run.
LIBRARIES = ("numpy", "scipy", "numba", "pin", "pybullet", "opencv-python-headless", "pyarrow")
UNKNOWN = "unknown"


@functools.lru_cache(maxsize=1)
def compute_source_digest() -> str:
    """Digest of all files of the simulator that decide how a run goes."""
    digest = hashlib.sha256()
    for package in PACKAGES:
        for folder in _find_folders(package):
            for path in sorted(folder.rglob("*")):
                if (
                    path.suffix in SOURCE_SUFFIXES
                    and path.parts[-3:-1] != EXCLUDED_FOLDER
                    and path.is_file()
                ):
                    digest.update(f"{package}/{path.relative_to(folder)}".encode())
                    digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _find_folders(package: str) -> list[Path]:
    """Where its files are: one folder in a workspace, two where it is installed.

    Not by Python's path, which in a sourced workspace leads to catkin's own stubs first.
    """
    code = INSTALL_FOLDER / package
    try:
        share = Path(PackagePath().find(package))
    except ExperimentError:
        return [code]
    return [share] if code.is_relative_to(share) or not code.is_dir() else [share, code]


@functools.lru_cache(maxsize=1)
def read_versions() -> dict[str, str]:
    """Of Python, of what computes, and of the sources."""
    found = {"python": platform.python_version(), "machine": platform.machine()}
    for library in LIBRARIES:
        try:
            found[library] = importlib.metadata.version(library)
        except importlib.metadata.PackageNotFoundError:
            found[library] = UNKNOWN
    return {**found, "sources": compute_source_digest()}


def read_study_versions(study: Mapping[str, Any]) -> dict[str, str]:
    """`read_versions`, and a digest of each module that the values of a study name."""
    found = dict(read_versions())
    for module in sorted(
        {match[1] for word in _collect_strings(study) if (match := CLASS_PATH.fullmatch(word))}
    ):
        found[module] = _digest_module(module)
    return found


def _collect_strings(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        for inner in value.values():
            yield from _collect_strings(inner)
    elif isinstance(value, list | tuple):
        for inner in value:
            yield from _collect_strings(inner)


def _digest_module(name: str) -> str:
    try:
        spec = importlib.util.find_spec(name)
        return hashlib.sha256(Path(spec.origin).read_bytes()).hexdigest()[:16]
    except (ImportError, AttributeError, TypeError, ValueError, OSError):
        return UNKNOWN  # no file: whoever uses it says so


def read_commit() -> str:
    """The commit that is checked out, '-dirty' where files differ from it; 'unknown' without."""
    command = ["git", "-C", str(SOURCE_FOLDER), "describe", "--always", "--dirty", "--abbrev=12"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=20, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return UNKNOWN
    return done.stdout.strip() or UNKNOWN


def describe_difference(here: dict[str, str], there: dict[str, str]) -> str:
    """In what two versions differ, in words; '' where they are the same."""
    keys = [key for key in {**here, **there} if here.get(key) != there.get(key)]
    return ", ".join(
        f"{key} {here.get(key, 'none')} here and {there.get(key, 'none')} there" for key in keys
    )
