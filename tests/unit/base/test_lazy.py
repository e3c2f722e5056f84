"""Names that are imported when they are first used."""

from __future__ import annotations

import importlib
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = """
from aras_visual_servo_base.lazy_imports import lazy_exports

__all__ = ["Experiment", "Study"]
__getattr__, __dir__ = lazy_exports(__name__, {"Experiment": ".one", "Study": ".two"})
"""


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A package that exports two names of two modules, and has a third module."""
    folder = tmp_path / "lazy_example"
    folder.mkdir()
    (folder / "__init__.py").write_text(PACKAGE)
    (folder / "one.py").write_text("class Experiment: ...\n")
    (folder / "two.py").write_text("class Study: ...\n")
    (folder / "other.py").write_text("VALUE = 1\n")
    monkeypatch.syspath_prepend(tmp_path)
    yield "lazy_example"
    for name in [name for name in sys.modules if name.partition(".")[0] == "lazy_example"]:
        del sys.modules[name]


def test_a_name_is_imported_when_it_is_used(package: str) -> None:
    module = importlib.import_module(package)
    assert dir(module) == ["Experiment", "Study"]
    assert f"{package}.one" not in sys.modules
    assert module.Experiment is importlib.import_module(f"{package}.one").Experiment
    assert f"{package}.two" not in sys.modules


def test_a_wrong_name_gets_the_nearest_one(package: str) -> None:
    module, nearest = importlib.import_module(package), "did you mean 'Experiment'[?]$"
    said = f"^module 'lazy_example' has no attribute 'Experimnt': {nearest}"
    with pytest.raises(AttributeError, match=said):
        module.Experimnt  # noqa: B018
    with pytest.raises(AttributeError, match="use one of Experiment, Study"):
        module.Unheard  # noqa: B018
    assert not hasattr(module, "Experimnt") and not hasattr(module, "__wrapped__")
    said = f"^cannot import name 'Experimnt' from 'lazy_example': {nearest}"
    with pytest.raises(ImportError, match=said):
        exec(f"from {package} import Experimnt")
    found: dict[str, object] = {}
    exec(f"from {package} import other, Study", found)
    assert found["other"].VALUE == 1 and found["Study"].__module__ == f"{package}.two"


def test_a_traceback_suggests_once(package: str, tmp_path: Path) -> None:
    for wrong in (f"import {package}; {package}.Experimnt", f"from {package} import Experimnt"):
        paths = repr([str(tmp_path), *sys.path])
        code = f"import sys; sys.path[:0] = {paths}\n{wrong}"
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
        assert done.returncode == 1
        assert done.stderr.lower().count("did you mean") == 1, done.stderr


def test_all_that_a_package_says_it_exports_is_there() -> None:
    for package in ("aras_sim_bridge.camera", "aras_sim_bridge.description",
                    "aras_sim_bridge.rendering", "aras_sim_bridge.world",
                    "aras_visual_servo_controller.laws"):  # fmt: skip
        module = importlib.import_module(package)
        assert all(getattr(module, name) is not None for name in module.__all__)
