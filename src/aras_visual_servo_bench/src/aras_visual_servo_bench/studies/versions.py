"""Versions of the code and libraries that affect results; all workers must have the same."""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import importlib.util
import json
import platform
import re
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..errors import ExperimentError
from ..experiment.packages import PackagePath

SOURCE_FOLDER = Path(__file__).resolve().parents[4]  # folder src/ of the workspace
INSTALL_FOLDER = Path(__file__).resolve().parents[2]  # folder of all packages after an installation
PACKAGES = (
    "aras_sim_bridge", "aras_visual_servo_camera", "aras_visual_servo_controller",
    "aras_visual_servo_bench", "aras_visual_servo_gazebo",
)  # fmt: skip
# Folder with study files. The digest of the code omits it, because the folder of a study contains a
# copy of its file.
EXCLUDED_FOLDER = ("config", "studies")
SOURCE_SUFFIXES = (
    ".py", ".yaml", ".urdf", ".world", ".dae", ".glb", ".gltf", ".stl", ".obj", ".mtl", ".png",
    ".npz",
)  # fmt: skip
# text "package.module:Class" in JSON; the group is the module
CLASS_PATH = re.compile(r'"([A-Za-z_]\w*(?:\.\w+)*):[A-Za-z_]\w*"')
# libraries whose version can change the numbers of a run
LIBRARIES = ("numpy", "scipy", "numba", "pin", "pybullet", "opencv-python-headless", "pyarrow")
UNKNOWN = "unknown"


@functools.lru_cache(maxsize=1)
def compute_source_digest() -> str:
    """Compute a digest of all files of the simulator that affect a run."""
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
    """Return the folders with the files of a package: one in a workspace, two after installation.

    Python's import path is not used, because in a sourced workspace it contains catkin's stubs
    instead of the code.
    """
    code = INSTALL_FOLDER / package
    try:
        share = Path(PackagePath().find(package))
    except ExperimentError:
        return [code]
    return [share] if code.is_relative_to(share) or not code.is_dir() else [share, code]


@functools.lru_cache(maxsize=1)
def read_versions() -> dict[str, str]:
    """Return the versions of Python and the libraries, and the digest of the code, by name."""
    versions = {"python": platform.python_version(), "machine": platform.machine()}
    for library in LIBRARIES:
        try:
            versions[library] = importlib.metadata.version(library)
        except importlib.metadata.PackageNotFoundError:
            versions[library] = UNKNOWN
    return {**versions, "sources": compute_source_digest()}


def read_study_versions(study: Mapping[str, Any]) -> dict[str, str]:
    """Return the versions, and a digest of each user module that the settings of a study name."""
    modules = sorted(set(CLASS_PATH.findall(json.dumps(study, ensure_ascii=False))))
    return {**read_versions(), **{module: _digest_module(module) for module in modules}}


def _digest_module(name: str) -> str:
    try:
        spec = importlib.util.find_spec(name)
        return hashlib.sha256(Path(spec.origin).read_bytes()).hexdigest()[:16]
    except (ImportError, AttributeError, TypeError, ValueError, OSError):
        # No error is raised here, because each run that imports this module reports it.
        return UNKNOWN


def read_commit() -> str:
    """Return the current Git commit; 'unknown' without Git.

    '-dirty' is appended if there are uncommitted changes."""
    command = ["git", "-C", str(SOURCE_FOLDER), "describe", "--always", "--dirty", "--abbrev=12"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=20, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return UNKNOWN
    return done.stdout.strip() or UNKNOWN


def describe_difference(here: dict[str, str], there: dict[str, str]) -> str:
    """Describe the differences between two sets of versions; return '' if they are equal."""
    keys = [key for key in {**here, **there} if here.get(key) != there.get(key)]
    return ", ".join(
        f"{key} {here.get(key, 'none')} here and {there.get(key, 'none')} there" for key in keys
    )
