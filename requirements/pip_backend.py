"""setuptools' backend for `pip install .`, which first asks whether PyBullet can be had at all.

PyPI has PyBullet built for Python up to 3.11; for a later one pip compiles it, and where it cannot,
what it says is a compiler's hundred lines.
"""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
import sysconfig
from pathlib import Path

from setuptools import build_meta
from setuptools.build_meta import (  # noqa: F401 what pip asks for besides
    build_editable,
    build_sdist,
    build_wheel,
    get_requires_for_build_editable,
    get_requires_for_build_sdist,
    get_requires_for_build_wheel,
    prepare_metadata_for_build_editable,
)

BUILT = (3, 11)  # the last Python for which PyPI has PyBullet 3.2.7 built
FLAGS = 'CFLAGS="-O1 -g0 -w -Wno-error=incompatible-pointer-types" CXXFLAGS="-O2 -g0 -w"'
# What PyBullet's C asks for: Python's header, and a conversion that GCC 14 takes for an error.
PROBE = "#include <Python.h>\nvoid f(int *); void g(float *x) { f(x); }\n"


def prepare_metadata_for_build_wheel(
    metadata_directory: str, config_settings: dict[str, object] | None = None
) -> str:
    """As setuptools', unless PyBullet would have to be compiled and cannot be."""
    fault = missing()
    if fault:
        raise SystemExit(fault)
    return build_meta.prepare_metadata_for_build_wheel(metadata_directory, config_settings)


def missing() -> str:
    """What PyBullet's installation lacks here and how to get it, in one line; empty if nothing."""
    if sys.version_info[:2] <= BUILT or any(Path(sysconfig.get_path("platlib")).glob("pybullet*")):
        return ""
    compiler = [*shlex.split(os.environ.get("CC", "cc")), "-x", "c", "-fsyntax-only",
                f"-I{sysconfig.get_path('include')}"]  # fmt: skip
    flags = shlex.split(os.environ.get("CFLAGS", ""))
    told = f"PyPI has no PyBullet built for Python {sys.version_info[0]}.{sys.version_info[1]}: "
    if not _compiles([*compiler, "-w"], PROBE.splitlines()[0]):
        return f"{told}to compile it, apt install g++ python3-dev; then {FLAGS} pip install ."
    if not _compiles([*compiler, *flags], PROBE):
        return f"{told}to compile it with this compiler (some minutes), {FLAGS} pip install ."
    return ""


def _compiles(command: list[str], text: str) -> bool:
    try:
        done = subprocess.run(
            [*command, "-"], input=text + "\n", text=True, capture_output=True, check=False
        )
    except OSError:
        return False
    return done.returncode == 0
