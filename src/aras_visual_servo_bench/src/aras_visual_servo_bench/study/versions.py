"""Which code computes: what results are told with, and what workers must agree on."""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import platform
import subprocess
from pathlib import Path

SOURCES = Path(__file__).resolve().parents[4]  # src/ of the workspace
PACKAGES = (
    "aras_sim_bridge", "aras_visual_servo_camera", "aras_visual_servo_controller",
    "aras_visual_servo_bench", "aras_visual_servo_gazebo",
)  # fmt: skip
APART = "protocols"  # folder of what is run, which tells itself apart
READ = (".py", ".yaml", ".urdf", ".dae", ".stl", ".obj")
# Those whose numbers go into a run.
LIBRARIES = ("numpy", "scipy", "numba", "pin", "pybullet", "opencv-python-headless", "pyarrow")
UNKNOWN = "unknown"


@functools.lru_cache(maxsize=1)
def sources() -> str:
    """Digest of all files of the simulator that decide how a run goes."""
    digest = hashlib.sha256()
    for package in PACKAGES:
        for path in sorted((SOURCES / package).rglob("*")):
            if path.suffix in READ and path.parent.name != APART and path.is_file():
                digest.update(str(path.relative_to(SOURCES)).encode())
                digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


@functools.lru_cache(maxsize=1)
def versions() -> dict[str, str]:
    """Of Python, of what computes, and of the sources."""
    found = {"python": platform.python_version(), "machine": platform.machine()}
    for library in LIBRARIES:
        try:
            found[library] = importlib.metadata.version(library)
        except importlib.metadata.PackageNotFoundError:
            found[library] = UNKNOWN
    return {**found, "sources": sources()}


def code() -> str:
    """The commit that is checked out, '-dirty' where files differ from it; 'unknown' without."""
    command = ["git", "-C", str(SOURCES), "describe", "--always", "--dirty", "--abbrev=12"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=20, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return UNKNOWN
    return done.stdout.strip() or UNKNOWN


def difference(here: dict[str, str], there: dict[str, str]) -> str:
    """In what two versions differ, in words; '' where they are the same."""
    keys = [key for key in {**here, **there} if here.get(key) != there.get(key)]
    return ", ".join(
        f"{key} {here.get(key, 'none')} here and {there.get(key, 'none')} there" for key in keys
    )
