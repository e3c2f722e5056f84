"""A short choice of the campaign of faults (./test.sh --faults runs all of it)."""

import subprocess
import sys
from pathlib import Path

CAMPAIGN = Path(__file__).parents[1] / "faults" / "campaign.py"
CHOICE = "garbage|bytes|fuzzed|hostile|games"


def test_nothing_is_lost_hung_or_leaked():
    ended = subprocess.run(
        [sys.executable, CAMPAIGN, "--scale", "0.02", "--only", CHOICE],
        capture_output=True,
        text=True,
        timeout=400,
    )
    assert ended.returncode == 0, f"{ended.stdout}\n{ended.stderr[-3000:]}"
