"""Faults of this package: each message says what, where and how to fix it."""

from __future__ import annotations

import contextlib
import logging
import sys
from collections.abc import Collection, Iterable, Iterator
from functools import lru_cache
from pathlib import Path

log = logging.getLogger(__name__)


class BenchError(Exception):
    """Base class of all errors of experiments, studies and reports."""


class ExperimentError(BenchError):
    """An experiment that cannot be run as it is written."""


class ViewError(BenchError):
    """A view that shows no target: it is behind the camera or outside of the picture."""


class StudyError(BenchError):
    """A study that cannot be begun, gone on with or read as it is."""


class RefusedError(BenchError):
    """A request that is not carried out, with the reason."""


def require(condition: bool, text: str) -> None:
    """Raise ExperimentError with this text unless the condition holds."""
    if not condition:
        raise ExperimentError(text)


def check_formats(requested: Iterable[str], available: Collection[str]) -> None:
    """StudyError naming the first format that is not among the known ones."""
    for name in requested:
        if name not in available:
            raise StudyError(f"no format '{name}': there are {', '.join(available)}")


@contextlib.contextmanager
def catch_write_errors(where: object, error_class: type[BenchError] = StudyError) -> Iterator[None]:
    """Raise `error_class`, in one line, where what is within cannot write there."""
    try:
        yield
    except OSError as error:
        raise error_class(f"cannot write {where}: {error.strerror or error}") from error


def find_program_name() -> str:
    """What the command line of this package is called here: `aras-servo` where pip installed it,
    `bench` where catkin did. Messages name commands by it."""
    called = Path(sys.argv[0]).name
    return called if called == "aras-servo" else "bench"


def make_missing_library_error(library: str | None, extra: str = "bench") -> BenchError:
    """The fault that a library is missing, which is among pip's `extra`."""
    return BenchError(
        f"{library} is not installed: run ./setup.sh; without ROS, pip install '.[{extra}]' in the "
        "folder of the sources"
    )


def read_first_line(error: BaseException) -> str:
    """What an exception says in its first line, or its class."""
    return str(error).splitlines()[0] if str(error) else type(error).__name__


@lru_cache
def log_once(note: str) -> None:
    """Log a warning, once a process: the runs of a study have much in common."""
    log.warning("%s", note)
