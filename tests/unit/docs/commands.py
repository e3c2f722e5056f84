"""Check whether a documented command would be accepted as written; few are executed."""

from __future__ import annotations

import argparse
import importlib
import importlib.abc
import importlib.machinery
import os
import re
import runpy
import shutil
import subprocess
import sys
import tomllib
import types
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from blocks import ROOT

from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_controller.schemes import create_scheme

SOURCES = ROOT / "src"
OTHERS = {"tf2_ros", "camera_calibration", "rviz", "rosbag"}  # ROS's own, not looked into
Words = list[str]


class Parsed(Exception):  # noqa: N818
    """Raised when a program has accepted its command line."""


class Messages(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Importer of empty message packages, because programs import messages before parsing words."""

    def find_spec(self, name, path=None, target=None):
        if re.search(r"(^|\.)(\w+_msgs|msg|srv)(\.|$)", name):
            return importlib.machinery.ModuleSpec(name, self, is_package=True)
        return None

    def create_module(self, spec):
        module = types.ModuleType(spec.name)
        module.__getattr__ = _message
        return module

    def exec_module(self, module) -> None:
        """Do nothing: the module is empty."""


def _message(name: str) -> type:
    if name.startswith("__"):
        raise AttributeError(name)
    return type(name, (), {"__slots__": ()})


def check(words: Words, folder: Path) -> None:
    """Check a documented command; fail if it would be refused or if its program is unknown."""
    program = words[0]
    name = program.rpartition("/")[2]
    if name.startswith("python"):
        name = "python"
    if name not in CHECKS:
        pytest.fail(f"nothing checks '{program}': add it to tests/unit/docs/commands.py")
    CHECKS[name](words, folder)


def taken(run: Callable[[], object], words: Words) -> None:
    """Run a program until it has parsed its command line."""
    plain = argparse.ArgumentParser.parse_known_args
    depth = 0

    def parse(self, args=None, namespace=None):
        nonlocal depth
        depth += 1
        try:
            options, behind = plain(self, args, namespace)
        finally:
            depth -= 1
        strange = [word for word in behind if "=" not in word or word.startswith("-")]
        if depth == 0:
            assert not strange, f"{self.prog} does not take {strange}"
            raise Parsed
        return options, behind

    known = set(sys.modules)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(argparse.ArgumentParser, "parse_known_args", parse)
        patch.setattr(argparse.ArgumentParser, "parse_args", lambda *a, **k: parse(*a, **k)[0])
        patch.setattr(sys, "argv", words)
        patch.setattr(sys, "meta_path", [*sys.meta_path, Messages()])
        try:
            run()
        except Parsed:
            return
        except SystemExit as end:
            pytest.fail(f"{' '.join(words)}: refused with status {end.code}")
        finally:  # remove empty message modules, and our modules that have imported them
            new = set(sys.modules) - known
            made = {name for name in new if isinstance(sys.modules[name].__loader__, Messages)}
            for name in new if made else ():
                if name in made or name.startswith("aras_"):
                    del sys.modules[name]
    pytest.fail(f"{' '.join(words)}: no command line was read")


def run_file(path: Path, words: Words) -> None:
    taken(lambda: runpy.run_path(str(path), run_name="__main__"), words)


def python(words: Words, folder: Path) -> None:
    rest = words[1:]
    if rest[0] == "-m" and rest[1] in ("pytest", "ruff"):
        there(rest[2:])
    elif rest[:2] == ["-m", "venv"]:
        assert len(rest) == 3, rest
    elif rest[0] == "-m":
        taken(lambda: runpy.run_module(rest[1], run_name="__main__", alter_sys=True), rest[1:])
    else:
        script = found(rest[0], folder)
        if len(rest) > 1 or "argparse" in script.read_text(encoding="utf-8"):
            sys.path.insert(0, str(script.parent))  # the test of the page restores it
            run_file(script, [str(script), *rest[1:]])


def found(name: str, folder: Path) -> Path:
    """Return the path of a file that the page has written, or of a file of the checkout."""
    packages = [path.parent for path in SOURCES.glob("*/package.xml")]
    for place in (folder, ROOT, *packages):
        if (place / name).is_file():
            return place / name
    return pytest.fail(f"there is no file {name}")


def there(words: Words) -> None:
    for word in words:
        path = word.partition("::")[0]
        assert "/" not in path or word.startswith("-") or (ROOT / path).exists(), f"no {path}"


def rosrun(words: Words, folder: Path) -> None:
    package, name, *rest = words[1:]
    if package in OTHERS:
        return
    files = [SOURCES / package / part / name for part in ("nodes", "scripts")]
    file = next((file for file in files if file.is_file()), None)
    assert file is not None, f"{package} has no executable {name}"
    text = file.read_text(encoding="utf-8")
    imported = re.search(r"^from ([\w.]+) import main$", text, re.MULTILINE)
    source = Path(*imported[1].split(".")) if imported else Path("none")
    reads = [*SOURCES.glob(f"*/src/{source}.py"), *SOURCES.glob(f"*/src/{source}/__init__.py")]
    if rest or any("argparse" in path.read_text(encoding="utf-8") for path in reads):
        run_file(file, [name, *rest])


def roslaunch(words: Words, folder: Path) -> None:
    package, name, *rest = [word for word in words[1:] if not word.startswith("--")]
    path = SOURCES / package / "launch" / name
    if name.isupper():  # FILE, where a table names them
        return
    assert path.is_file(), f"{package} has no {name}"
    known = {arg.get("name") for arg in ElementTree.parse(path).iter("arg") if arg.get("doc")}
    for word in rest:
        key, given, value = word.partition(":=")
        assert given, f"roslaunch's arguments are name:=value, not {word}"
        assert "\n" not in word, f"roslaunch leaves out, without a word, what has two lines: {word}"
        assert key in known, f"{name} has no argument {key}"
        if key == "scheme" and ":" not in value:  # else a class that the page has written
            Experiment(scheme=value)
            create_scheme(value)
        elif key == "camera":
            camera(value, folder)


def camera(name: str, folder: Path) -> None:
    presets = SOURCES / "aras_visual_servo_gazebo" / "config" / "cameras"
    file = folder / name.rpartition("/")[2] if "/" in name else presets / f"{name}.yaml"
    assert file.is_file(), f"no block makes {name}, nor is it a camera preset"


def script(words: Words, folder: Path) -> None:
    """Run a script of this project without the programs that it would start."""
    name, *rest = words
    name = Path(name).name
    if name == "test.sh":
        there(rest)
        if rest[:1] == ["--faults"]:
            run_file(ROOT / "tests" / "faults" / "campaign.py", [name, *rest[1:]])
        return
    if name == "setup.sh":
        end = subprocess.run([ROOT / name, *rest, "--packages"], capture_output=True, text=True)
        assert end.returncode == 0, end.stderr
        return
    run_file(SOURCES / "aras_visual_servo_bench" / "nodes" / "demo",
             ["demo", *_without_setup(folder, rest)])  # fmt: skip


def _without_setup(folder: Path, rest: Words) -> Words:
    """Return the words that demo.sh passes on in a workspace that needs no setup."""
    stage, told = folder / "stage", folder / "told"
    shutil.rmtree(stage, ignore_errors=True)
    for path, text in (("devel/setup.bash", ""), ("setup.sh", ""),
                       (".venv/bin/rosrun", 'printf "%s\\n" "${@:3}" > "$TOLD"\n')):  # fmt: skip
        (stage / path).parent.mkdir(parents=True, exist_ok=True)
        (stage / path).write_text(f"#!/bin/bash\n{text}")
        (stage / path).chmod(0o755)
    shutil.copy(ROOT / "demo.sh", stage)
    (stage / "src").symlink_to(SOURCES)
    rest = [word for word in rest if word != "--rviz"]  # asks for a display
    end = subprocess.run([stage / "demo.sh", *rest], env={**os.environ, "TOLD": str(told)},
                         cwd=folder, capture_output=True, text=True)  # fmt: skip
    assert end.returncode == 0, end.stderr
    return told.read_text().splitlines()


def docker(words: Words, folder: Path) -> None:
    """Check `docker compose -f FILE run --rm SERVICE [command]`, or `docker build -f FILE .`"""
    file = ROOT / words[words.index("-f") + 1]
    assert file.is_file(), f"no {file}"
    if words[1] == "compose":
        services = yaml.safe_load(file.read_text(encoding="utf-8"))["services"]
        rest = [word for word in words[words.index("-f") + 2 :] if not word.startswith("-")]
        assert rest[0] in ("run", "up", "build") and set(rest[1:2]) <= set(services), rest


def copy(words: Words, folder: Path) -> None:
    """Copy a file of the checkout into the folder of the page."""
    for word in words[1:-1]:
        shutil.copy(ROOT / word, folder)


def dask(words: Words, folder: Path) -> None:
    """Check the words of Dask's programs, without starting them."""
    program = importlib.import_module(f"distributed.cli.dask_{words[1]}").main
    program.make_context(" ".join(words[:2]), list(words[2:]))


def pip(words: Words, folder: Path) -> None:
    """Check `pip install` of this checkout, with extras that exist."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert words[1] == "install" and re.fullmatch(r"\.(\[\w+\])?", words[2]), words
    assert words[2][2:-1] in ("", *project["optional-dependencies"]), words


def subcommand(*known: str) -> Callable[[Words, Path], None]:
    """Accept these first words; tests/integration/test_controller_node.py calls them on a graph."""
    def check(words: Words, folder: Path) -> None:
        assert words[1] in known, words

    return check


CHECKS: dict[str, Callable[[Words, Path], None]] = {
    "python": python, "rosrun": rosrun, "roslaunch": roslaunch, "docker": docker,
    "rosbag": subcommand("info", "play", "check", "record", "filter"),
    "cp": copy, "dask": dask, "pip": pip,
    "aras-servo": lambda w, f: rosrun(["rosrun", "aras_visual_servo_bench", "bench", *w[1:]], f),
    "setup.sh": script, "demo.sh": script, "test.sh": script,
    "truth": lambda w, f: run_file(ROOT / w[0], w),
    **dict.fromkeys(("rosservice", "rostopic", "rosparam", "rosnode"), subcommand(
        "call", "list", "info", "echo", "hz", "load", "set", "get", "pub")),
    **dict.fromkeys(("cd", "mkdir", "export", "source", ".", "git", "apt", "catkin_make", "roscore",
                     "cat", "xdg-open", "ls"), lambda words, folder: None),  # the system's
}  # fmt: skip
