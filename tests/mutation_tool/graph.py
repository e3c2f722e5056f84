"""Faults that only a ROS graph can notice: integration tests in a built copy of the workspace.

Nodes are processes of their own, so each integration file is recorded as one test, with
coverage.py started in every process by COVERAGE_PROCESS_START. One graph runs at a time.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import signal
import subprocess
import threading
import time
import uuid
from pathlib import Path

from coverage import CoverageData

from . import trees
from .planting import Faulty

MARK = "ARAS_MUTATION_GRAPH"
_BUILT_FROM = (".msg", ".srv", ".action", ".cfg", "CMakeLists.txt", "package.xml", "setup.py")
_SETTINGS = """[run]
data_file = {top}/.coverage-data/part
parallel = true
sigterm = true
include = {top}/src/*
"""


class GraphError(Exception):
    """The copy cannot be built, or its integration tests cannot run."""


class Graph:
    """A copy of the workspace that is built when it is first used."""

    def __init__(self, top: Path, folder: Path) -> None:
        self._top, self._folder = top, folder
        self._lock = threading.Lock()
        self._ready = False
        self._stamp = 0

    def record(self, test_file: str) -> dict:
        """Run one integration file under coverage; as `recording.record` writes it."""
        with self._lock:
            self._prepare()
            data = self._copy / ".coverage-data"
            shutil.rmtree(data, ignore_errors=True)
            data.mkdir()
            settings = self._copy / ".coverage-settings"
            settings.write_text(_SETTINGS.format(top=self._copy))
            answer = self._pytest(
                [test_file], 900.0, {"COVERAGE_PROCESS_START": str(settings)}
            )
            if answer["status"] != "ended" or answer["code"] != 0:
                text = answer["output"][-3000:]
                raise GraphError(f"{test_file} fails without any fault:\n{text}")
            lines: dict[str, dict[str, list[str]]] = {}
            for part in data.iterdir():
                read = CoverageData(str(part))
                read.read()
                for file in read.measured_files():
                    of_file = lines.setdefault(str(Path(file).relative_to(self._copy)), {})
                    of_file |= {str(line): [test_file] for line in read.lines(file) or ()}
            return {"code": 0, "lines": lines, "shared": {}, "failed": {},
                    "seconds": {test_file: answer["seconds"]}}

    def run(self, task: dict) -> dict:
        """As the worker's task for a fault, `order` naming integration files."""
        with self._lock:
            self._prepare()
            self._stamp += 2
            with Faulty(self._copy, task, self._stamp):
                return self._pytest(["-x", *task["order"]], task["wall"], {})

    def _prepare(self) -> None:
        if self._ready:
            return
        self._copy, self._held = trees.free_copy(self._folder.resolve())
        trees.update(self._top, self._copy)
        names = [n for n in trees.tracked(self._top) if n.endswith(_BUILT_FROM)]
        digest, built = trees.digest(self._top, names), self._copy / ".built"
        if not built.is_file() or built.read_text() != digest:
            python = self._top / ".venv" / "bin" / "python"
            environment = _clean() | {"PATH": "/usr/sbin:/usr/bin:/sbin:/bin",
                                      "ROS_LANG_DISABLE": "genlisp"}
            catkin = shutil.which("catkin_make")
            if catkin is None:
                raise GraphError("there is no catkin_make to build the copy with; --no-graph")
            done = subprocess.run(
                [catkin, f"-DPYTHON_EXECUTABLE={python}"], cwd=self._copy, text=True,
                env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False,
            )
            if done.returncode:
                raise GraphError(f"the copy cannot be built:\n{done.stdout[-2000:]}")
            built.write_text(digest)
        self._ready = True

    def _pytest(self, arguments: list[str], wall: float, more: dict[str, str]) -> dict:
        mark = uuid.uuid4().hex
        environment = _clean() | more | {
            MARK: mark, "ARAS_REQUIRE_GRAPH": "1", "NUMBA_CACHE_DIR": str(self._copy / ".numba"),
            "PATH": f"{self._copy}/.venv/bin:{os.environ['PATH']}",
        }
        script = '. devel/setup.bash && exec python -m pytest -q -p no:cacheprovider "$@"'
        began = time.monotonic()
        process = subprocess.Popen(
            ["bash", "-c", script, "graph", *arguments], cwd=self._copy, env=environment, text=True,
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        status = "ended"
        try:
            output = process.communicate(timeout=wall)[0]
        except subprocess.TimeoutExpired:
            status = "time-out"
            process.send_signal(signal.SIGINT)  # so that launch files are ended
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.communicate(timeout=30)
            output = ""
        finally:
            _end_all(mark)
        failed = re.findall(r"^(?:FAILED|ERROR) (\S+)", output, re.MULTILINE)
        return {"status": status, "code": process.wait(), "failed": failed, "output": output,
                "seconds": time.monotonic() - began, "ran": len(arguments)}


def _clean() -> dict[str, str]:
    """The environment without a workspace."""
    names = ("CMAKE_PREFIX_PATH", "ROS_PACKAGE_PATH", "PYTHONPATH", "VIRTUAL_ENV")
    return {name: value for name, value in os.environ.items() if name not in names}


def _end_all(mark: str) -> None:
    """Kill what is left of a graph: processes that carry its mark in their environment."""
    wanted = f"{MARK}={mark}".encode()
    for entry in Path("/proc").iterdir():
        with contextlib.suppress(OSError):
            if entry.name.isdigit() and wanted in (entry / "environ").read_bytes().split(b"\0"):
                os.kill(int(entry.name), signal.SIGKILL)
