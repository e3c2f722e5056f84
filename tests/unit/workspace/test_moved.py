"""Old names of modules that have moved into rooms mean the same modules."""

from __future__ import annotations

import ast
import importlib
import pickle
import sys
from pathlib import Path

import pytest

from aras_visual_servo_base.moved import MovedModules

SOURCES = Path(__file__).parents[3] / "src"


def tables() -> dict[str, str]:
    """Old to new full names, as the packages' `__init__` say them."""
    found = {}
    for package in ("aras_visual_servo_controller", "aras_visual_servo_bench"):
        text = (SOURCES / package / "src" / package / "__init__.py").read_text()
        call = next(n for n in ast.walk(ast.parse(text)) if isinstance(n, ast.Call))
        moved = ast.literal_eval(call.args[1])
        found |= {f"{package}.{old}": f"{package}.{new}" for old, new in moved.items()}
    return found


@pytest.mark.parametrize("old, new", sorted(tables().items()))
def test_an_old_name_is_the_module_itself(old: str, new: str) -> None:
    module = importlib.import_module(old)
    assert module is importlib.import_module(new)
    assert module.__name__ == module.__spec__.name == new


def test_a_pickle_under_the_old_name_gives_the_same_class() -> None:
    from aras_visual_servo_bench.asked.experiment import CameraPose

    text = pickle.dumps(CameraPose((0.0,) * 6), protocol=0)
    old = text.replace(b"aras_visual_servo_bench.asked.starts",
                       b"aras_visual_servo_bench.experiment")  # fmt: skip
    assert old != text and type(pickle.loads(old)) is CameraPose


def test_what_has_not_moved_is_left_to_others() -> None:
    finder = MovedModules("package", {"old": "room.new"})
    assert finder.find_spec("package.other") is None and finder.find_spec("old") is None
    assert "package.old" not in sys.modules
