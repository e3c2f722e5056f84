"""How a program begins."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

LIBRARY = Path(__file__).parents[3] / "src" / "aras_visual_servo_base" / "src"
RUN = "from aras_visual_servo_base.program import run; run('asked_for')"


@pytest.fixture
def program(tmp_path):
    """Runs a module of this text as a program does; returns status, what it wrote, its errors."""

    def ran(text: str) -> tuple[int, str, str]:
        (tmp_path / "asked_for.py").write_text(text)
        done = subprocess.run(
            [sys.executable, "-c", RUN], capture_output=True, text=True,
            env={**os.environ, "PYTHONPATH": f"{tmp_path}:{LIBRARY}"})  # fmt: skip
        return done.returncode, done.stdout, done.stderr

    return ran


def test_garbage_is_looked_for_once_all_is_imported_and_only_in_what_comes_after(program):
    status, wrote, _ = program("""
import gc
at_import = gc.isenabled()
kept = [[] for _ in range(5)]
def main():
    print(at_import, gc.isenabled(), any(one is kept for one in gc.get_objects()))
    return 3
""")
    assert (status, wrote) == (3, "False True False\n")


def test_a_ctrl_c_while_it_is_imported_ends_it_without_a_traceback(program):
    status, wrote, said = program("import os, signal\nos.kill(os.getpid(), signal.SIGINT)\n"
                                  "def main():\n    print('not reached')\n")
    assert (status, wrote, said) == (-signal.SIGINT, "", "")
