"""Makes tests/truth_checks importable for the tests of this folder, and restores its changes."""

import logging
import sys
from pathlib import Path

import pytest

TESTS = str(Path(__file__).parents[2])
if TESTS not in sys.path:
    sys.path.insert(0, TESTS)


@pytest.fixture(autouse=True)
def logging_as_before():
    """Restore the logging that the commands change, for the tests of other files."""
    level = logging.root.manager.disable
    yield
    logging.disable(level)
