"""The campaigns beside the tests say how they are used, in a workspace that is built."""

import subprocess
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[1]


@pytest.mark.parametrize("script", ["one_run", "peers"])
def test_help_is_the_campaigns_own(script, ros_master):
    """Catkin's setup.bash takes words like --help for its own, where it sees them."""
    done = subprocess.run(
        [TESTS / script, "--help"], env={"PATH": "/usr/bin:/bin", "HOME": "/"}, text=True,
        capture_output=True, timeout=60,
    )  # fmt: skip
    assert done.returncode == 0 and done.stdout.startswith(f"usage: tests/{script}"), done.stderr
    assert not done.stderr
