"""`pip install .` for a Python version without PyBullet on PyPI: one line states the remedy."""

import importlib.util
import stat
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


def compiler(folder, text):
    path = folder / "mycc"
    path.write_text(text)
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return str(path)


def test_without_a_compiler_it_says_which_packages(backend, monkeypatch, tmp_path):
    monkeypatch.setenv("CC", str(tmp_path / "none"))
    told = backend.missing()
    assert "no PyBullet built for Python 3.13" in told and "apt install g++ python3-dev" in told
    assert backend.FLAGS in told and "\n" not in told
    with pytest.raises(SystemExit, match="apt install"):
        backend.prepare_metadata_for_build_wheel(str(tmp_path))


def test_without_pythons_header_it_says_the_same(backend, monkeypatch, tmp_path):
    monkeypatch.setenv("CC", compiler(tmp_path, "#!/bin/sh\nexit 1\n"))
    assert "apt install g++ python3-dev" in backend.missing()


def test_a_strict_compiler_is_asked_for_with_the_flags_that_it_needs(
    backend, monkeypatch, tmp_path
):
    monkeypatch.setenv("CC", compiler(tmp_path, STRICT))
    told = backend.missing()
    assert backend.FLAGS in told and "apt" not in told
    monkeypatch.setenv("CFLAGS", "-Wno-error=incompatible-pointer-types")
    assert backend.missing() == ""


@pytest.mark.parametrize("minor", [11, 12])
def test_a_python_with_wheels_needs_no_compiler(backend, monkeypatch, tmp_path, minor):
    monkeypatch.setenv("CC", str(tmp_path / "none"))
    monkeypatch.setattr(sys, "version_info", (3, minor, 0, "final", 0))
    assert bool(backend.missing()) == (minor == 12)


def test_nor_does_an_environment_that_has_pybullet(backend, monkeypatch, tmp_path):
    monkeypatch.setenv("CC", str(tmp_path / "none"))
    (tmp_path / "platlib" / "pybullet-3.2.7.dist-info").mkdir()
    assert backend.missing() == ""
