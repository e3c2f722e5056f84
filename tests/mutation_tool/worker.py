"""Runs tests on a copy of the workspace: `python -m mutation_tool.worker COPY LIBRARY...`.

It imports the libraries once and none of the workspace's modules, and forks for each task.
Tasks and answers are lines of JSON on stdin and stdout; the tests' own output goes to a file.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import resource
import signal
import sys
import time
from pathlib import Path
from typing import TextIO

from mutation_tool import planting

_MEMORY = 6 << 30


def main() -> None:
    """Serve tasks until stdin ends."""
    answers = os.fdopen(os.dup(1), "w")
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 1)  # some libraries print while they are imported
    os.dup2(silence, 2)
    top = Path(sys.argv[1]).resolve()
    os.chdir(top)
    tools = str(Path(__file__).parents[1])
    sys.path[:] = [entry for entry in sys.path if entry not in ("", tools)]
    if path := os.environ.pop("MUTATION_PYTHONPATH", ""):
        os.environ["PYTHONPATH"] = path
    else:
        os.environ.pop("PYTHONPATH", None)
    for name in sys.argv[2:]:
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    importlib.import_module("mutation_tool.recording")
    print("{}", file=answers, flush=True)
    serve(top, sys.stdin, answers)


def serve(top: Path, tasks: TextIO, answers: TextIO) -> None:
    stamp = 0
    for line in tasks:
        task = json.loads(line)
        stamp += 2
        faulty = planting.Faulty(top, task, stamp) if "text" in task else contextlib.nullcontext()
        with faulty:
            answer = _forked(top, task)
        print(json.dumps(answer), file=answers, flush=True)


def _forked(top: Path, task: dict) -> dict:
    answer = top / ".answer.json"
    answer.unlink(missing_ok=True)
    began = time.monotonic()
    child = os.fork()
    if child == 0:
        _child(top, task, answer)
    status = _wait(child, task["wall"])
    with contextlib.suppress(ProcessLookupError):  # what the tests left behind
        os.killpg(child, signal.SIGKILL)
    result = {"seconds": time.monotonic() - began, "status": status}
    if answer.is_file():
        result |= json.loads(answer.read_text())
    return result


def _wait(child: int, wall: float) -> str:
    """'ended', 'time-out' or 'crash (SIGNAL)'."""
    deadline = time.monotonic() + wall
    while True:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            if os.WIFSIGNALED(status):
                number = os.WTERMSIG(status)
                late = number in (signal.SIGXCPU, signal.SIGKILL)
                return "time-out" if late else f"crash ({signal.Signals(number).name})"
            return "ended"
        if time.monotonic() > deadline:
            os.killpg(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return "time-out"
        time.sleep(0.01)


def _child(top: Path, task: dict, answer: Path) -> None:
    os.setpgid(0, 0)
    code = 70
    try:
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        out = os.open(top / ".output.txt", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(out, 1)
        os.dup2(out, 2)
        resource.setrlimit(resource.RLIMIT_CPU, (task["cpu"], task["cpu"] + 5))
        resource.setrlimit(resource.RLIMIT_DATA, (_MEMORY, _MEMORY))
        cache = ".numba-faulty" if task.get("compiled") else ".numba"
        os.environ["NUMBA_CACHE_DIR"] = str(top / cache)
        with contextlib.suppress(ImportError):
            importlib.import_module("numba").config.CACHE_DIR = str(top / cache)
        recording = sys.modules["mutation_tool.recording"]
        if "record" in task:
            code = recording.record(top, task["record"], answer)
        else:
            code = recording.run(top, task["order"], answer, task["stop"])
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


if __name__ == "__main__":
    main()
