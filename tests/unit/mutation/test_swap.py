"""A fault in a module that is imported: the same as if the faulty file had been imported."""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from mutation_tool.swap import Functions

SOURCE = """from functools import cache, wraps

LIMIT = 2.0


def logged(function):
    @wraps(function)
    def inner(*a):
        return function(*a) + 0.0
    return inner


class Arm:
    joints = 6

    @property
    def length(self):
        return 3.0

    @logged
    def reach(self, a, scale=1.0):
        return max(a, LIMIT) * scale


@cache
def table():
    return [n + 1 for n in range(3)]


def outer(a):
    def inner(b):
        return b + a
    return inner
"""
LOOPS = """import numba
import numpy as np


@numba.njit("f8(f8)")
def half(a):
    return a / 2


@numba.njit("f8(f8[:])")
def halves(many):
    total = 0.0
    for one in many:
        total += half(one)
    return total


@numba.njit("f8(f8[:])")
def both(many):
    return halves(many) + half(many[0])


@numba.njit("f8(f8)")
def other(a):
    return a + 1
"""


@pytest.fixture
def toy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "swapped_toy.py").write_text(SOURCE)
    gc.freeze()  # else a fault is looked for in all that the tests before have left
    import swapped_toy

    yield swapped_toy
    gc.unfreeze()
    sys.modules.pop("swapped_toy", None)


def planted(toy: ModuleType, was: str, now: str) -> bool:
    assert SOURCE.count(was) == 1
    faulty = SOURCE.replace(was, now)
    return Functions().plant(Path(toy.__file__), SOURCE.encode(), faulty.encode())


def test_methods_properties_and_what_decorators_hold(toy: ModuleType) -> None:
    arm, reach = toy.Arm(), toy.Arm.reach
    assert planted(toy, "return 3.0", "return 4.0") and arm.length == 4.0
    assert planted(toy, "max(a, LIMIT)", "min(a, LIMIT)") and reach(arm, 1.5) == 1.5
    assert planted(toy, "(*a) + 0.0", "(*a) + 1.0") and reach(arm, 1.5) == 2.5


def test_inner_functions_and_comprehensions(toy: ModuleType) -> None:
    assert planted(toy, "n + 1", "n + 2") and toy.table() == [2, 3, 4]
    assert planted(toy, "b + a", "b - a") and toy.outer(1)(5) == 4
    assert planted(toy, "        return b + a\n    return inner", "        return b + a\n    pass")
    assert toy.outer(1) is None


@pytest.mark.parametrize(("was", "now"), [
    ("LIMIT = 2.0", "LIMIT = 2.5"), ("joints = 6", "joints = 7"), ("scale=1.0", "scale=1.25"),
    ("    @property\n", ""), ("b + a", "b + b"),
])
def test_what_the_import_makes_is_refused(toy: ModuleType, was: str, now: str) -> None:
    alive = toy.outer(1)  # its code takes a variable from around it
    assert not planted(toy, was, now)
    assert toy.Arm().reach(3.0) == 3.0 and alive(5) == 6


def test_a_module_that_nobody_has_imported_needs_nothing(tmp_path: Path) -> None:
    assert Functions().plant(tmp_path / "not_yet.py", b"A = 1", b"A = 2")


def test_a_module_that_a_test_keeps_to_itself_gets_the_fault_too(toy: ModuleType) -> None:
    del sys.modules["swapped_toy"]
    assert planted(toy, "return 3.0", "return 4.0") and toy.Arm().length == 4.0
    assert not planted(toy, "LIMIT = 2.0", "LIMIT = 2.5")


def test_compiled_functions_and_their_callers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                              ) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "swapped_loops.py").write_text(LOOPS)
    import swapped_loops as loops

    many = np.array([2.0, 4.0])
    assert (loops.halves(many), loops.both(many)) == (3.0, 4.0)
    compiled = loops.other.overloads
    faulty = LOOPS.replace("a / 2", "a * 2")
    assert Functions().plant(Path(loops.__file__), LOOPS.encode(), faulty.encode())
    assert (loops.half(2.0), loops.halves(many), loops.both(many)) == (4.0, 12.0, 16.0)
    assert loops.other.overloads is compiled  # nothing of it has changed
