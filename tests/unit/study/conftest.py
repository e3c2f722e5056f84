"""Studies of a free camera with exact features; a run takes a hundredth of a second."""

import sys
from pathlib import Path

import pytest

from aras_visual_servo_bench.studies.study import Study

sys.path.append(str(Path(__file__).parent))

TINY = {
    "experiment": {"plant": "free", "duration": 0.1, "lag": 0.0},
    "vary": {"gain": [1.0, 2.0, 4.0]},
    "repeats": 2,
    "chunk": 2,
    "metrics": ["success", "final_distance"],
}


@pytest.fixture(scope="session")
def tiny():
    """Function that makes the tiny study with changed keys."""
    return lambda **changes: Study.from_mapping({**TINY, **changes})
