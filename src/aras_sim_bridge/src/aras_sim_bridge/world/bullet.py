"""PyBullet, imported without the line that it prints on being loaded."""

import os
import sys


def _import_quietly() -> None:
    """Import pybullet while the process's standard error goes nowhere.

    Its initialisation writes "pybullet build time: …" from C, past sys.stderr. What goes wrong
    while importing still arrives as an exception.
    """
    if sys.stderr is not None:
        sys.stderr.flush()
    kept = os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        import pybullet  # noqa: F401
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


if "pybullet" not in sys.modules:
    _import_quietly()

import pybullet  # noqa: E402

__all__ = ["pybullet"]
