"""Compiling loops before the first start: for sources, and for copies made of them."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

LIBRARY = Path(__file__).parents[3] / "src" / "aras_visual_servo_base" / "src"
TWICE = """
from aras_visual_servo_base.compiled import compiled
@compiled("f8")
def twice(x):
    return 2 * x
"""
ASK = "from looping.part.twice import twice as t; v = t(2.0); print(len(t.stats.cache_hits), v)"


@pytest.fixture
def packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A package with a loop below tmp_path/source, and a copy as setup.py makes one, in /copy."""
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)  # loops are kept beside their sources
    for folder in ("source", "copy"):
        package = tmp_path / folder / "looping"
        (package / "part").mkdir(parents=True)
        for name, text in (("__init__", ""), ("part/__init__", ""), ("part/twice", TWICE)):
            path = package / f"{name}.py"
            path.write_text(text)
            seconds = 1_700_000_000 if folder == "copy" else 1_700_000_000.25
            os.utime(path, (seconds, seconds))
    return tmp_path


def run(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *arguments], env={**os.environ, "PYTHONPATH": f"{folder}:{LIBRARY}"},
        cwd="/", capture_output=True, text=True, timeout=300,
    )  # fmt: skip


def kept(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.rglob("*.nb[ic]")}


def test_what_was_compiled_for_the_sources_serves_their_copies_unless_they_differ(packages):
    source, copy = packages / "source", packages / "copy"
    done = run(source, "-m", "aras_visual_servo_base.loops", "looping", "nothing")
    assert done.returncode == 1 and "no package nothing on PYTHONPATH" in done.stderr
    assert len(kept(source)) == 2
    done = run(copy, "-m", "aras_visual_servo_base.loops", "--from", str(source), "looping")
    assert done.returncode == 0, done.stderr
    assert kept(copy) == kept(source)  # nothing was compiled anew
    assert run(copy, "-c", ASK).stdout == "1 4.0\n"
    path = copy / "looping" / "part" / "twice.py"
    path.write_text(path.read_text().replace("2 * x", "3 * x"))
    run(copy, "-m", "aras_visual_servo_base.loops", "--from", str(source), "looping")
    assert len(kept(copy)) == 2 and kept(copy) != kept(source)
    assert run(copy, "-c", ASK).stdout == "1 6.0\n"


def test_packages_are_missing_until_each_of_their_loops_is_kept(packages, monkeypatch):
    source = packages / "source"
    ask = "from aras_visual_servo_base.loops import missing; print(missing(['looping']))"
    assert run(source, "-c", ask).stdout == "['looping']\n"
    run(source, "-m", "aras_visual_servo_base.loops", "looping")
    assert run(source, "-c", ask).stdout == "[]\n"
    small = source / "looping" / "small.py"  # becomes part of others: nothing is kept beside it
    small.write_text("from aras_visual_servo_base.compiled import inlined\n"
                     "@inlined\ndef half(x):\n    return 0.5 * x\n")
    assert run(source, "-c", ask).stdout == "[]\n"
    thrice = source / "looping" / "thrice.py"
    thrice.write_text(TWICE.replace("2 * x", "3 * x"))
    assert run(source, "-c", ask).stdout == "['looping']\n"
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(packages / "elsewhere"))
    assert run(source, "-c", ask).stdout == "[]\n"
