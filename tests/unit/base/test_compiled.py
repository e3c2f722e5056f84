"""Compiled functions also work if they cannot be cached, and a message says so."""

import importlib
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numba
import numpy as np
import pytest

from aras_visual_servo_base import compiled


def run(program, paths=()):
    """What a program prints, and says on its standard error; the modules of tests are in sight."""
    program = f"import sys\nsys.path[:] = {[*map(str, paths), *sys.path]}\n{program}"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    return done.returncode, done.stdout, done.stderr


def test_without_a_place_to_keep_them_loops_work_all_the_same():
    """As where the text of a function is in no file."""
    _, out, err = run("""
from aras_visual_servo_base.compiled import jit
for _ in range(2):
    total = jit("f8[::1]")(eval("lambda x: x.sum()"))
    print(total(__import__("numpy").arange(4.0)))
""")
    assert out == "6.0\n6.0\n" and err.count("NUMBA_CACHE_DIR") == 1


def test_on_a_full_disk_loops_work_and_one_line_gives_the_reason(tmp_path):
    """A limit of 0 bytes for new files fails as a full disk does."""
    (tmp_path / "loops.py").write_text("""
from aras_visual_servo_base.compiled import jit
@jit("f8")
def twice(x):
    return 2 * x
@jit("f8")
def thrice(x):
    return x + twice(x)
""")
    _, out, err = run("""
import resource
resource.setrlimit(resource.RLIMIT_FSIZE, (0, resource.RLIM_INFINITY))
import loops
print(loops.thrice(2.0), loops.twice(2.0))
""", [tmp_path])
    (line,) = err.splitlines()
    assert out == "6.0 4.0\n"
    assert "cannot be cached (File too large)" in line and "NUMBA_CACHE_DIR" in line


@pytest.mark.parametrize("words", ["run STUDY --in-process --out OUT", "check_interaction moments"])
def test_a_missing_compiler_is_reported_with_the_command_that_installs_it(words, tmp_path):
    study = tmp_path / "study.yaml"
    study.write_text("experiment: {plant: free, features: exact, duration: 0.1}\n")
    words = words.replace("STUDY", str(study)).replace("OUT", str(tmp_path / "out"))
    status, _, err = run(f"""
sys.modules["numba"] = None
from aras_visual_servo_bench.cli import main
sys.exit(main({words.split()}))
""")
    (line,) = err.splitlines()
    assert status == 1 and line.startswith("bench: cannot import Numba") and "pip install" in line


def test_other_types_are_refused_instead_of_compiled_in_the_middle_of_a_run():
    total = compiled.jit("f8[::1]")(lambda x: x.sum())
    for other in (np.arange(4), np.arange(8.0)[::2], np.zeros((2, 2))):
        with pytest.raises(TypeError):
            total(other)


def test_arrays_in_any_order_are_only_read() -> None:
    total = compiled.jit("f8[:], b1")(lambda x, twice: x.sum() * (2.0 if twice else 1.0))
    kept = np.arange(8.0)
    kept.setflags(write=False)
    assert total(kept[::2], False) == 12.0
    assert total(kept, True) == 56.0

    def written(x):
        x[0] = 1.0

    with pytest.raises(numba.TypingError, match="Cannot modify readonly array"):
        compiled.jit("f8[:]")(written)(kept)
    compiled.jit("f8[::1]")(written)(copy := kept.copy())
    assert copy[0] == 1.0


def test_what_makes_no_arrays_looks_at_rows_and_is_refused_when_it_does() -> None:
    def sums(rows, out):
        for k in range(len(rows)):
            row = rows[k]
            out[k] = row[0] + 2.0 * row[1:][0]

    rows, out = np.arange(6.0).reshape(3, 2), np.zeros(3)
    compiled.jit("f8[:,::1], f8[::1]", allocates=False)(sums)(rows, out)
    assert out.tolist() == [2.0, 8.0, 14.0]
    with pytest.raises(numba.core.errors.NumbaError):
        compiled.jit("f8[::1]", allocates=False)(lambda x: np.empty(len(x)))(rows[0])


def test_it_is_compiled_at_its_first_use_once_and_for_its_types_alone() -> None:
    inner = compiled.jit("f8[:], i8")(lambda x, k: x[k])
    outer = compiled.jit("f8[::1]")(lambda x: inner(x, 1) + inner(x, 2))
    assert not inner.signatures and not outer.signatures
    with ThreadPoolExecutor(4) as threads:
        assert list(threads.map(outer, [np.arange(k, k + 3.0) for k in range(8)])) == [
            3.0 + 2 * k for k in range(8)
        ]
    assert len(outer.signatures) == 1
    # the caller has rows in C order and another kind of whole number
    ((row, number),) = inner.signatures
    assert (row.layout, row.mutable, str(number)) == ("A", False, "int64")


def test_all_of_a_package_are_compiled_when_that_is_asked_for() -> None:
    made = []
    for module in ("mine.a", "mined.a", "mine"):
        function = eval("lambda x: 2 * x", {"__name__": module})
        made.append(compiled.jit("f8")(function))
    compiled.compile_all("mine")
    assert [len(one.signatures) for one in made] == [1, 0, 1]
    compiled.compile_all("mined")
    assert [len(one.signatures) for one in made] == [1, 1, 1]
    # A node compiles those of the project; a function of somebody else may be unfinished.
    assert not {*made} & {*compiled.list_functions()}


@pytest.mark.parametrize("decorator", ["jit('f8')", "jit_inline"])
def test_what_changes_in_another_module_counts(tmp_path, monkeypatch, decorator) -> None:
    """What was kept of a caller must not go on with what its callee was, or the callee's own one,
    or a number of another module. (Texts of one size within a second are one text to Python.)"""
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")  # beside the sources, as it is by default
    head = "from aras_visual_servo_base.compiled import jit, jit_inline\n"
    (tmp_path / "calling_loop.py").write_text(
        f"{head}from called_loop import add, TIMES\n"
        "@jit('f8')\ndef twice(x):\n    return TIMES * add(x)\n"
    )
    (tmp_path / "called_loop.py").write_text(
        f"{head}from deeper_loop import more, TIMES\n"
        f"@{decorator}\ndef add(x):\n    return x + more(x)\n"
    )

    def answer(constant: float, times: float) -> float:
        (tmp_path / "deeper_loop.py").write_text(
            f"{head}TIMES = {times}\n@{decorator}\ndef more(x):\n    return {constant} * x\n"
        )
        for name in ("calling_loop", "called_loop", "deeper_loop"):
            sys.modules.pop(name, None)
        importlib.invalidate_caches()
        loop = importlib.import_module("calling_loop").twice
        return loop(1.0), sum(loop.stats.cache_hits.values())

    assert answer(1.0, 2.0) == (4.0, 0)
    assert answer(25.0, 2.0) == (52.0, 0)
    assert answer(25.0, 3.25) == (84.5, 0)
    assert answer(25.0, 3.25) == (84.5, 1)
