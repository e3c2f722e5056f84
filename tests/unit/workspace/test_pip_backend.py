"""`pip install .` for a Python version without PyBullet on PyPI: one line states the remedy."""

import importlib.util
import sys
from pathlib import Path

import pytest

BACKEND = Path(__file__).parents[3] / "requirements" / "pip_backend.py"
STRICT = """#!/bin/sh
# A compiler that takes the conversion for an error unless told otherwise, as GCC 14 does.
text=$(cat)
case "$text $*" in *"void f"*incompatible-pointer-types*) exit 0 ;; *"void f"*) exit 1 ;; esac
case "$text" in *Python.h*) exit 0 ;; esac
exit 1
"""


@pytest.fixture
def backend(monkeypatch, tmp_path):
    spec = importlib.util.spec_from_file_location("pip_backend", BACKEND)
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    monkeypatch.setattr(sys, "version_info", (3, 13, 1, "final", 0))
    monkeypatch.setattr(made.sysconfig, "get_path", lambda name: str(tmp_path / name))
    (tmp_path / "platlib").mkdir()
    for name in ("CC", "CFLAGS"):
        monkeypatch.delenv(name, raising=False)
    return made


def test_without_a_compiler_it_says_which_packages(backend, monkeypatch, tmp_path):
    monkeypatch.setenv("CC", str(tmp_path / "none"))
    told = backend.missing()
    assert "no PyBullet built for Python 3.13" in told and "apt install g++ python3-dev" in told
    assert backend.FLAGS in told and "\n" not in told
    with pytest.raises(SystemExit, match="apt install"):
        backend.prepare_metadata_for_build_wheel(str(tmp_path))
    for minor, needed in ((11, False), (12, True)):  # the first has wheels
        monkeypatch.setattr(sys, "version_info", (3, minor, 0, "final", 0))
        assert bool(backend.missing()) == needed
    (tmp_path / "platlib" / "pybullet-3.2.7.dist-info").mkdir()
    assert backend.missing() == ""


def test_a_strict_compiler_is_asked_for_with_the_flags_that_it_needs(
    backend, monkeypatch, tmp_path
):
    compiler = tmp_path / "mycc"
    monkeypatch.setenv("CC", str(compiler))
    for text, has_header in (("#!/bin/sh\nexit 1\n", False), (STRICT, True)):
        compiler.write_text(text)
        compiler.chmod(0o755)
        told = backend.missing()
        assert backend.FLAGS in told
        assert ("apt install g++ python3-dev" in told) == ("apt" in told) == (not has_header)
    monkeypatch.setenv("CFLAGS", "-Wno-error=incompatible-pointer-types")
    assert backend.missing() == ""
