"""Imports without an optional library: only the importing module lacks it, and only then."""

import importlib
import sys

import pytest

from aras_visual_servo_base.lazy_imports import import_without

MODULES = {
    "optional_library": "",
    "library_user": "try:\n    import optional_library as found\n"
                    "except ImportError:\n    found = None\n",
}  # fmt: skip


@pytest.fixture(autouse=True)
def modules(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tmp_path))
    for name, text in MODULES.items():
        (tmp_path / f"{name}.py").write_text(text)
    importlib.invalidate_caches()
    yield
    for name in MODULES:
        sys.modules.pop(name, None)


def test_the_library_is_missing_during_the_import_only():
    before = list(sys.meta_path)
    import_without("optional_library", "library_user")
    assert sys.modules["library_user"].found is None and "optional_library" not in sys.modules
    library = importlib.import_module("optional_library")
    del sys.modules["library_user"]
    import_without("optional_library", "library_user")  # one that is imported is used
    assert sys.modules["library_user"].found is library
    del sys.modules["optional_library"]
    with pytest.raises(ModuleNotFoundError, match="there_is_none"):
        import_without("optional_library", "there_is_none")
    assert sys.meta_path == before


def test_other_threads_find_the_library(tmp_path):
    (tmp_path / "library_user.py").write_text(
        "import importlib, threading\nfound = []\n"
        "def search():\n    found.append(importlib.import_module('optional_library'))\n"
        "thread = threading.Thread(target=search)\nthread.start()\nthread.join()\n"
    )
    importlib.invalidate_caches()
    import_without("optional_library", "library_user")
    assert [one.__name__ for one in sys.modules["library_user"].found] == ["optional_library"]
