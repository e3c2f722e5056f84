"""Runs tests on a copy of the workspace: `python -m mutation_tool.worker COPY`.

The first line of stdin is JSON: {libraries: what to import at once, collect: test files}. Then a
line for each task, answered by one on stdout. Each task has a process of its own, forked from this
one; the tests' own output goes to a file. With test files the workspace is imported and its tests
are collected once, and faults are planted into that: quick, but not for all faults. Without, each
task imports and collects what it needs.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import json
import os
import resource
import select
import shutil
import signal
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import TextIO

import pytest

from mutation_tool import guard, planting, recording
from mutation_tool.swap import Functions

Run = Callable[[dict, Callable[[float], None]], dict]


def main() -> None:
    """Serve tasks until stdin ends."""
    tasks, answers = os.fdopen(os.dup(0)), os.fdopen(os.dup(1), "w")
    silence = os.open(os.devnull, os.O_RDWR)
    for descriptor in range(3):
        os.dup2(silence, descriptor)
    top = Path(sys.argv[1]).resolve()
    os.chdir(top)
    tools = str(Path(__file__).parents[1])
    sys.path[:] = [entry for entry in sys.path if entry not in ("", tools)]
    sys.modules["__main__"].__spec__ = None  # processes that tests spawn would import it by name,
    del sys.modules["__main__"].__file__  # or from its file
    if path := os.environ.pop("MUTATION_PYTHONPATH", ""):
        os.environ["PYTHONPATH"] = path
    else:
        os.environ.pop("PYTHONPATH", None)
    begin = json.loads(tasks.readline())
    for name in begin["libraries"]:
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    server = Server(top, tasks, answers)
    if files := begin["collect"]:
        _use_loops(top / ".numba")
        collected = Collected(top, server)
        pytest.main([*recording.options(top), "-s", *(str(top / f) for f in files)],
                    plugins=[collected])
        print(json.dumps({"error": "the tests cannot be collected"}), file=answers, flush=True)
    else:
        server.serve(lambda task, limit: _imported_anew(top, task, limit))


def _imported_anew(top: Path, task: dict, limit: Callable[[float], None]) -> dict:
    _use_loops(top / (".numba-faulty" if task.get("compiled") else ".numba"))
    if "record" in task:
        limit(task["patience"])
        return recording.record(top, task["record"])
    limit(10.0 * task["patience"])  # to import, and to compile maybe
    chosen = recording.Chosen(task["order"], task["seconds"], limit, task["patience"])
    return recording.run(top, chosen, task["order"])


def _use_loops(folder: Path) -> None:
    os.environ["NUMBA_CACHE_DIR"] = str(folder)
    with contextlib.suppress(ImportError):
        importlib.import_module("numba").config.CACHE_DIR = str(folder)


class Collected:
    """pytest plugin: instead of running what was collected, serve tasks from it."""

    def __init__(self, top: Path, server: Server) -> None:
        self._top, self._server = top, server

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        self._items = {item.nodeid: item for item in session.items}
        gc.unfreeze()  # what tests have put out of the collector's sight is looked for
        self._functions = Functions()
        self._session = session
        self._server.serve(self._run)
        os._exit(0)

    def _run(self, task: dict, limit: Callable[[float], None]) -> dict:
        order = task["order"]
        if not all(name in self._items for name in order):
            return {"anew": True}
        if "text" in task and not self._functions.plant(
            self._top / task["file"], task["was"].encode(), task["text"].encode()
        ):
            return {"anew": True}
        chosen = recording.Chosen(order, task["seconds"], limit, task["patience"])
        self._session.config.pluginmanager.register(chosen)
        items = [self._items[name] for name in order]
        for item, following in zip(items, [*items[1:], None], strict=True):
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            if chosen.failed:
                break
        return chosen.answer(int(bool(chosen.failed)))


class Server:
    """Answers tasks, each from a forked process that is watched, and leaves nothing of it."""

    def __init__(self, top: Path, tasks: TextIO, answers: TextIO) -> None:
        self._top, self._tasks, self._answers = top, tasks, answers
        self._deadline = guard.Deadline()
        self._asked_by_none = select.poll()  # once the process that asks has ended in any way
        self._asked_by_none.register(tasks, 0)  # tells of a pipe that is closed at its other end

    def serve(self, run: Run) -> None:
        guard.adopt_orphans()
        self._kept = guard.children()  # what the import of a library has started maybe
        files = planting.Files(self._top)
        gc.collect()
        gc.freeze()  # else each child copies what it only counts
        self._say({})
        stamp = 0
        for line in self._tasks:
            task = json.loads(line)
            stamp += 2
            faulty = contextlib.nullcontext()
            if "text" in task:
                faulty = planting.Faulty(self._top, task, stamp)
            with faulty:
                answer = self._forked(run, task)
            files.restore()
            self._say(answer)

    def _say(self, answer: dict) -> None:
        print(json.dumps(answer), file=self._answers, flush=True)

    def _forked(self, run: Run, task: dict) -> dict:
        answer, outside = self._top / ".answer.json", self._top / ".outside"
        answer.unlink(missing_ok=True)
        before = recording.spent()
        self._deadline.set(600.0)
        child = os.fork()
        if child == 0:
            self._child(run, task, answer, outside)
        status = self._wait(child)
        with contextlib.suppress(ProcessLookupError):  # what the tests left behind
            os.killpg(child, signal.SIGKILL)
        left = guard.end_all(self._kept)
        shutil.rmtree(self._top / guard.SCRATCH, ignore_errors=True)
        result = {"status": status, "left": left, "cpu": recording.spent() - before}
        if answer.is_file():
            result |= json.loads(answer.read_text())
        if outside.is_file():
            result["outside"] = outside.read_text(errors="replace").partition("\n")[0]
        return result

    def _wait(self, child: int) -> str:
        """'ended', 'time-out' or 'crash (SIGNAL)'."""
        while True:
            done, status = os.waitpid(child, os.WNOHANG)
            if done:
                if os.WIFSIGNALED(status):
                    number = os.WTERMSIG(status)
                    late = number in (signal.SIGXCPU, signal.SIGKILL)
                    return "time-out" if late else f"crash ({signal.Signals(number).name})"
                return "ended"
            if self._deadline.over:
                os.kill(child, signal.SIGKILL)
                os.waitpid(child, 0)
                return "time-out"
            if self._asked_by_none.poll(10):
                guard.end_all(set())
                os._exit(1)

    def _child(self, run: Run, task: dict, answer: Path, outside: Path) -> None:
        os.setpgid(0, 0)
        code = 70
        try:
            self._tasks.close()
            os.close(self._answers.fileno())
            out = os.open(self._top / ".output.txt", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(out, 1)
            os.dup2(out, 2)
            resource.setrlimit(resource.RLIMIT_CPU, (int(time.process_time() + 3600),) * 2)
            guard.confine(self._top, outside)

            def limit(cpu: float) -> None:
                guard.limit_time(self._deadline, cpu, task["idle"] + task["slowness"] * cpu)

            result = run(task, limit)
            answer.write_text(json.dumps(result))
            code = 0
        except BaseException:  # `os._exit` would leave nothing of it
            traceback.print_exc()
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)


if __name__ == "__main__":
    main()
