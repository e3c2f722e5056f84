"""Short selection of the fault injection (./test.sh --faults runs all of it)."""

import subprocess
import sys
from pathlib import Path

TESTS = Path(__file__).parents[1]
sys.path.insert(0, str(TESTS))
from faults import campaign  # noqa: E402
from faults.processes import tracebacks  # noqa: E402

CHOICE = "garbage|bytes|fuzzed|hostile|games"


def test_nothing_is_lost_hung_or_leaked():
    ended = subprocess.run([sys.executable, campaign.__file__, "--scale", "0.02", "--only", CHOICE],
                           capture_output=True, text=True, timeout=400)
    assert ended.returncode == 0, f"{ended.stdout}\n{ended.stderr[-3000:]}"


def test_a_traceback_of_pythons_own_beginning_is_told_from_those_of_programs():
    python = (
        "Fatal Python error: init_import_site: Failed to import the site module\n"
        'Traceback (most recent call last):\n  File "<frozen site>", line 638, in <module>\n'
        "KeyboardInterrupt\n")
    importing = '  File "<frozen importlib._bootstrap>", line 1178, in _find_and_load\n  File'
    nested = python.replace("  File", importing, 1)
    ours = (
        'Traceback (most recent call last):\n  File "/ws/devel/lib/gazebo", line 15, in <module>\n'
        '    exec(x)\n  File "<frozen site>", line 3, in main\nKeyboardInterrupt\n')
    found, unborn = tracebacks(f"[INFO] up\n{python}words\n{ours}{python}{nested}")
    assert unborn == 3 and len(found) == 1
    assert "/ws/devel/lib/gazebo" in found[0] and found[0].endswith("KeyboardInterrupt")
    assert tracebacks("all is well") == ([], 0)
