"""Start of the workspace's programs."""

from __future__ import annotations

import gc
import importlib
import signal
import sys
from pathlib import Path
from typing import NoReturn

from .errors import CompilerError


def run(module: str) -> NoReturn:
    """Import a module, call its `main`, and exit with the status that it returns.

    If Numba cannot be imported, print this in one line and exit with the status 1.

    Until rospy handles signals, Ctrl-C ends the program without a traceback. Garbage collection is
    disabled during the import, where it would take an eighth of the start time, and ignores the
    imported objects afterwards, because they exist as long as the program.
    """
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    gc.disable()
    try:
        main = importlib.import_module(module).main
        gc.freeze()
        gc.enable()
        status = main()
    except CompilerError as error:
        sys.exit(f"{Path(sys.argv[0]).name}: {error}")
    sys.exit(status)
