"""Preparation of commands that simulate: Numba is imported, and functions are compiled."""

from __future__ import annotations

import contextlib
import os
import sys
import time

from aras_visual_servo_base.compiled import import_numba, warn_uncached
from aras_visual_servo_base.program import fast_imports

from ..errors import find_program_name
from ..progress_bar import ProgressBar

COMPILED_PACKAGES = ("aras_visual_servo_base", "aras_sim_bridge", "aras_visual_servo_camera",
                     "aras_visual_servo_controller", "aras_visual_servo_bench")  # fmt: skip


def prepare_simulation() -> None:
    """Import Numba, and compile the package's functions if pip installed the package.

    Commands call this before they simulate. Functions with a compiled version in Numba's cache are
    not compiled again. If catkin built the package, they were already compiled when it was built.

    Raises:
        NumbaUnavailableError: Numba cannot be imported.
    """
    # `fast_imports` suspends garbage collection, which would otherwise take a tenth of the time of
    # a short run.
    with fast_imports():
        import_numba()
    if find_program_name() != "bench":
        _compile_missing()


def _compile_missing() -> None:
    """Compile all Numba functions that are not in Numba's cache, on all cores, with a progress bar.

    If this fails, Numba compiles each function when the simulation first calls it.
    """
    from aras_visual_servo_base import compile_packages  # imports multiprocessing

    missing = compile_packages.find_missing(COMPILED_PACKAGES)
    if not missing:
        return
    start = time.monotonic()
    print("compiling before the first simulation, which takes one or two "
          "minutes", file=sys.stderr, flush=True)
    with contextlib.closing(ProgressBar(sys.stderr)) as bar:
        faults, uncached = compile_packages.compile_packages(
            missing, os.cpu_count() or 1, report=lambda fraction: bar.show(fraction, "compiling")
        )
    for fault in faults:
        print(f"{find_program_name()}: {fault}", file=sys.stderr)
    if uncached:
        warn_uncached(uncached)
    elif not faults:
        print(f"compiled in {time.monotonic() - start:.0f} s", file=sys.stderr)
