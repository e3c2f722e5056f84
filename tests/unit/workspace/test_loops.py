"""Compilation before the first start, for the sources and for copies of them."""

import importlib
import os
import subprocess
import sys
from pathlib import Path

import numba
import pytest

from aras_visual_servo_base import compile_packages

LIBRARY = Path(__file__).parents[3] / "src" / "aras_visual_servo_base" / "src"
TWICE = """
from aras_visual_servo_base.compiled import jit
@jit("f8")
def twice(x):
    return 2 * x
"""


@pytest.fixture
def packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A package with a loop below tmp_path/source, and a copy as setup.py makes one, in /copy."""
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)  # loops are kept beside their sources
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    for folder in ("source", "copy"):
        package = tmp_path / folder / "looping"
        (package / "part").mkdir(parents=True)
        for name, text in (("__init__", ""), ("part/__init__", ""), ("part/twice", TWICE)):
            path = package / f"{name}.py"
            path.write_text(text)
            os.utime(path, (1_700_000_000, 1_700_000_000))  # what is written later differs in time

    def forget() -> None:
        for name in [name for name in sys.modules if name.partition(".")[0] == "looping"]:
            del sys.modules[name]

    def use(folder: Path) -> None:
        """Have the package from there, as a new process would."""
        forget()
        monkeypatch.setattr(sys, "path", [str(folder), *before])
        importlib.invalidate_caches()

    before = list(sys.path)
    yield tmp_path, use
    forget()


def looped() -> tuple[int, float]:
    """Return how often the compiled loop was loaded from the cache, and its result for 2."""
    twice = importlib.import_module("looping.part.twice").twice
    found = twice(2.0)
    return len(twice.stats.cache_hits), found


def kept(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.rglob("*.nb[ic]")}


def test_what_was_compiled_for_the_sources_serves_their_copies_unless_they_differ(packages):
    folder, use = packages
    source, copy = folder / "source", folder / "copy"
    use(source)
    assert compile_packages.find_sources("looping") == [Path("looping/part/twice.py")]
    assert compile_packages.main(["looping"]) == 0
    assert len(kept(source)) == 2
    use(copy)
    assert compile_packages.main(["--from", str(source), "looping"]) == 0
    assert kept(copy) == kept(source)  # nothing was compiled anew
    assert looped() == (1, 4.0)
    path = copy / "looping" / "part" / "twice.py"
    path.write_text(path.read_text().replace("2 * x", "3 * x"))
    use(copy)
    compile_packages.main(["--from", str(source), "looping"])
    assert len(kept(copy)) == 2 and kept(copy) != kept(source)
    use(copy)
    assert looped() == (1, 6.0)


@pytest.mark.parametrize("processes", [1, 2])
def test_packages_are_compiled_side_by_side_and_one_that_is_not_there_is_named(
    packages, processes, capsys
):
    folder, use = packages
    use(source := folder / "source")
    assert compile_packages.main(["nothing", "looping", f"--processes={processes}"]) == 1
    assert capsys.readouterr().err == (
        "compile_packages: there is no package nothing on PYTHONPATH; build and source the "
        "workspace\n")  # fmt: skip
    assert len(kept(source)) == 2


def test_packages_are_shared_out_among_processes_by_their_loops(packages):
    folder, use = packages
    for name, count in (("large", 9), ("middle", 6), ("small", 4), ("none", 0)):
        (folder / "shared" / name).mkdir(parents=True)
        (folder / "shared" / name / "__init__.py").write_text("")
        for n in range(count):
            (folder / "shared" / name / f"loop_{n}.py").write_text(TWICE)
    use(folder / "shared")
    names = ["none", "small", "large", "middle"]
    assert compile_packages.split_packages(names, 2) == [["large", "none"], ["middle", "small"]]
    assert compile_packages.split_packages(names, 1) == [["large", "middle", "small", "none"]]
    assert [len(part) for part in compile_packages.split_packages(names, 8)] == [1, 1, 1, 1]


def test_packages_are_missing_until_each_of_their_loops_is_kept_where_it_is_looked_for(
    packages, monkeypatch
):
    folder, use = packages
    source = folder / "source"
    use(source)
    assert compile_packages.find_missing(["looping"]) == ["looping"]
    compile_packages.main(["looping"])
    assert compile_packages.find_missing(["looping"]) == []
    small = source / "looping" / "small.py"  # becomes part of others: nothing is kept beside it
    small.write_text("from aras_visual_servo_base.compiled import jit_inline\n"
                     "@jit_inline\ndef half(x):\n    return 0.5 * x\n")
    assert compile_packages.find_missing(["looping"]) == []
    cache = folder / "elsewhere"
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(cache))
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(cache))
    assert compile_packages.find_missing(["looping"]) == ["looping"]
    use(source)
    compile_packages.main(["looping"])
    assert len(kept(cache)) == 2
    assert compile_packages.find_missing(["looping"]) == []
    # Numba uses the cache next to the sources if this folder cannot be created
    (folder / "file").write_text("")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(folder / "file" / "elsewhere"))
    assert compile_packages.find_missing(["looping"]) == []
    (source / "looping" / "thrice.py").write_text(TWICE.replace("2 * x", "3 * x"))
    assert compile_packages.find_missing(["looping"]) == ["looping"]


def test_the_compiled_fraction_is_reported(packages):
    folder, use = packages
    use(folder / "source")
    path = folder / "source" / "looping" / "thrice.py"
    path.write_text(TWICE.replace("2 * x", "3 * x").replace("twice", "thrice"))
    fractions = []
    outcome = compile_packages.compile_packages(["looping"], 2, report=fractions.append)
    assert (outcome, fractions) == (([], ""), [0.5, 1.0])


def test_a_full_disk_ends_the_compilation_with_one_line(packages):
    """A limit of 0 bytes for new files fails as a full disk does."""
    source = packages[0] / "source"
    code = ("import resource, sys; from aras_visual_servo_base.compile_packages import main; "
            "resource.setrlimit(resource.RLIMIT_FSIZE, (0, resource.RLIM_INFINITY)); "
            "sys.exit(main(['looping']))")  # fmt: skip
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd="/",
                          env={**os.environ, "PYTHONPATH": f"{source}:{LIBRARY}"})  # fmt: skip
    assert done.returncode == 1 and not kept(source)
    (line,) = done.stderr.splitlines()
    assert "cannot be cached (File too large)" in line


def test_a_process_that_is_killed_is_reported(packages):
    folder, use = packages
    use(folder / "source")
    path = folder / "source" / "looping" / "part" / "twice.py"
    path.write_text("import os, signal\nfrom aras_visual_servo_base.compiled import jit\n"
                    "class Number:\n"
                    "    def __repr__(self):\n        os.kill(os.getpid(), signal.SIGKILL)\n"
                    "N = (Number(),)\n@jit('f8')\ndef twice(x):\n    return N\n")  # fmt: skip
    (fault,), _ = compile_packages.compile_packages(["looping"], 1)
    assert fault.startswith("compiling looping failed: the process was killed")
