"""The test campaigns print their usage in a built workspace."""

import subprocess
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[1]


@pytest.mark.parametrize("script", ["one_run", "peers"])
def test_help_is_the_campaigns_own(script, ros_master):
    """Catkin's setup.bash takes words like --help for its own, where it sees them."""
    done = subprocess.run([TESTS / script, "--help"], env={"PATH": "/usr/bin:/bin", "HOME": "/"},
                          text=True, capture_output=True, timeout=60)
    assert done.returncode == 0 and done.stdout.startswith(f"usage: tests/{script}"), done.stderr
    assert not done.stderr
