"""Start of the workspace's programs."""

from __future__ import annotations

import gc
import importlib
import signal
import sys
from typing import NoReturn


def run(module: str) -> NoReturn:
    """Import a module, call its `main`, and exit with the status that it returns.

    Until rospy handles signals, Ctrl-C ends the program without a traceback. Garbage collection
    would take an eighth of the start time, so it is disabled during the import. Afterwards, it
    ignores the imported objects, because they exist as long as the program.
    """
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    gc.disable()
    main = importlib.import_module(module).main
    gc.freeze()
    gc.enable()
    sys.exit(main())
