"""Functions that start the programs of the workspace."""

from __future__ import annotations

import contextlib
import gc
import importlib
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NoReturn

from .errors import NumbaUnavailableError


@contextlib.contextmanager
def fast_imports() -> Iterator[None]:
    """Disable garbage collection while the `with` block imports what a program needs.

    Garbage collection would take an eighth of the start time. After the block, garbage collection
    ignores the imported objects, because they exist as long as the program.
    """
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


def run(module: str) -> NoReturn:
    """Import a module, call its `main`, and exit with the status that it returns.

    If Numba cannot be imported, print the error in one line and exit with the status 1. Ctrl-C
    during the start ends the program without a traceback.
    """
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        with fast_imports():
            main = importlib.import_module(module).main
        status = main()
    except NumbaUnavailableError as error:
        sys.exit(f"{Path(sys.argv[0]).name}: {error}")
    sys.exit(status)
