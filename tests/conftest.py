"""Configuration of all tests: finds the built message modules next to the sources."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path

import pytest

DEVEL = Path(__file__).parents[1] / "devel"

# pyproject.toml puts the packages' sources on the path, so that unit tests run without a build.
# In a sourced workspace the devel space must come before them: its packages refer to the same
# sources and add the generated `msg` and `srv` modules, which the source folders do not have.
sys.path[:0] = [
    entry
    for entry in os.environ.get("PYTHONPATH", "").split(os.pathsep)
    if entry and Path(entry).is_relative_to(DEVEL)
]


def pytest_configure(config: pytest.Config) -> None:
    # A shell starts its background jobs deaf to Ctrl-C, and children inherit that. The tests that
    # interrupt a node must work there too.
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    ignored = "ignore:the matrix subclass.*:PendingDeprecationWarning"  # pycollada's
    config.addinivalue_line("filterwarnings", ignored)
    config.addinivalue_line("filterwarnings", "ignore:notifyAll.*:DeprecationWarning")  # rospy's
