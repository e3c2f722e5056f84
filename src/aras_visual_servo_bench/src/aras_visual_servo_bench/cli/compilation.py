"""Compilation at the first simulation of an installation by pip."""

from __future__ import annotations

import os
import sys
import time

from ..errors import find_program_name

COMPILED_PACKAGES = ("aras_visual_servo_base", "aras_sim_bridge", "aras_visual_servo_camera",
                     "aras_visual_servo_controller", "aras_visual_servo_bench")  # fmt: skip


def compile_once() -> None:
    """Compile all functions that are not in the cache, on all cores and with a progress bar.

    Commands call this before they simulate. In a workspace it does nothing, because the set-up
    compiles. If the compilation fails, the simulation compiles the functions that it calls.
    """
    if find_program_name() == "bench":
        return
    from aras_visual_servo_base import compile_packages
    from aras_visual_servo_base.compiled import warn_uncached

    from ..progress_bar import ProgressBar

    missing = compile_packages.find_missing(COMPILED_PACKAGES)
    if not missing:
        return
    start = time.monotonic()
    print("first simulation: compiling for one or two minutes", file=sys.stderr, flush=True)
    bar = ProgressBar(sys.stderr)
    try:
        faults, uncached = compile_packages.compile_packages(
            missing, os.cpu_count() or 1, report=lambda fraction: bar.show(fraction, "compiling")
        )
    finally:
        bar.close()
    for fault in faults:
        print(f"{find_program_name()}: {fault}", file=sys.stderr)
    if uncached:
        warn_uncached(uncached)
    elif not faults:
        print(f"compiled in {time.monotonic() - start:.0f} s", file=sys.stderr)
