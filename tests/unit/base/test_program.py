"""Start of a program."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

LIBRARY = Path(__file__).parents[3] / "src" / "aras_visual_servo_base" / "src"
RUN = "from aras_visual_servo_base.program import run; run('asked_for')"


def run(tmp_path, text):
    """Run a program with this text."""
    (tmp_path / "asked_for.py").write_text(text)
    return subprocess.run([sys.executable, "-c", RUN], capture_output=True, text=True,
                          env={**os.environ, "PYTHONPATH": f"{tmp_path}:{LIBRARY}"})  # fmt: skip


def test_garbage_is_looked_for_once_all_is_imported_and_only_in_what_comes_after(tmp_path):
    done = run(tmp_path, """
import gc
at_import = gc.isenabled()
kept = [[] for _ in range(5)]
def main():
    print(at_import, gc.isenabled(), any(one is kept for one in gc.get_objects()))
    return 3
""")
    assert (done.returncode, done.stdout) == (3, "False True False\n")


def test_a_missing_compiler_ends_a_program_with_one_line(tmp_path):
    done = run(tmp_path, """
import sys
from aras_visual_servo_base.compiled import jit
sys.modules["numba"] = None
main = jit("")(lambda: 3)
""")
    (line,) = done.stderr.splitlines()
    assert done.returncode == 1 and "cannot import Numba" in line and "./setup.sh" in line
