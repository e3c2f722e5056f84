"""Of a file with one fault in it, numba compiles again what the fault touches and nothing else."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from mutation_tool import loops, planting

SOURCE = """from aras_visual_servo_base.compiled import compiled

FACTOR = 2.0


@compiled("f8")
def scaled(a):
    return FACTOR * a


@compiled("f8")
def twice(a):
    return scaled(scaled(a))


@compiled("f8")
def other(a):
    return a + 1.0
"""
BASE = Path(__file__).parents[2] / "src" / "aras_visual_servo_base" / "src"
SCRIPT = """import sys; sys.path[:0] = ["src", sys.argv[1]]; import toy
for f in (toy.scaled, toy.twice, toy.other):
    print(f.__name__, f(3.0), sum(f.stats.cache_hits.values()))
"""


def test_what_a_name_touches() -> None:
    assert loops.touched(SOURCE, ("scaled",)) == {"scaled", "twice"}
    assert loops.touched(SOURCE, ("FACTOR",)) == {"FACTOR", "scaled", "twice"}
    assert loops.touched(SOURCE, ("other",)) == {"other"}


def ran(top: Path, cache: str) -> dict[str, tuple[float, int]]:
    """By function: its answer, and how often it was found compiled."""
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(BASE)], cwd=top, check=True, capture_output=True,
        text=True, env=os.environ | {"NUMBA_CACHE_DIR": str(top / cache)},
    )
    lines = [line.split() for line in done.stdout.splitlines()]
    return {name: (float(answer), int(hits)) for name, answer, hits in lines}


def test_only_what_a_fault_touches_is_compiled_again(tmp_path: Path) -> None:
    toy = tmp_path / "src" / "toy.py"
    toy.parent.mkdir()
    toy.write_text(SOURCE)
    (tmp_path / ".numba").mkdir()
    assert ran(tmp_path, ".numba") == {"scaled": (6.0, 0), "twice": (12.0, 0), "other": (4.0, 0)}
    task = {"file": "src/toy.py", "text": SOURCE.replace("FACTOR * a", "FACTOR + a"),
            "compiled": True, "names": ["scaled"]}
    with planting.Faulty(tmp_path, task, 2):
        assert ran(tmp_path, ".numba-faulty") == {
            "scaled": (5.0, 0), "twice": (7.0, 0), "other": (4.0, 1)
        }
    assert ran(tmp_path, ".numba") == {"scaled": (6.0, 1), "twice": (12.0, 1), "other": (4.0, 1)}
