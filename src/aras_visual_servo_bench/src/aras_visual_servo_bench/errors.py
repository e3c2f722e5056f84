"""Errors of this package: each message says what is wrong, where, and how to fix it."""

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
    """Error in the settings of an experiment."""


class OutOfViewError(BenchError):
    """Error that the target is behind the camera or outside the image."""


class StudyError(BenchError):
    """Error of a study that cannot be started, continued or read."""


class RefusedRequestError(BenchError):
    """A request from a web page is refused; the message gives the reason."""


def require(condition: bool, text: str) -> None:
    """Raise an ExperimentError with this text unless the condition holds."""
    if not condition:
        raise ExperimentError(text)


@contextlib.contextmanager
def catch_setting_errors(
    faults: type[Exception] | tuple[type[Exception], ...], where: str = ""
) -> Iterator[None]:
    """Convert errors of the `with` block into an ExperimentError.

    Args:
        faults: types of the errors.
        where: name of the setting or file, with which the message starts; '' for no name.
    """
    try:
        yield
    except faults as error:
        raise ExperimentError(f"{where}: {error}" if where else str(error)) from error


def check_formats(requested: Iterable[str], available: Collection[str]) -> None:
    """Check that all requested file formats are available.

    Raises:
        StudyError: a format is not available; the message names the first such format.
    """
    for name in requested:
        if name not in available:
            raise StudyError(f"unknown format '{name}': use one of {', '.join(available)}")


@contextlib.contextmanager
def catch_write_errors(where: object, error_class: type[BenchError] = StudyError) -> Iterator[None]:
    """Convert an OSError of the `with` block into an `error_class` with a one-line message.

    Args:
        where: file or folder that the block writes to; the message names it.
    """
    try:
        yield
    except OSError as error:
        raise error_class(f"cannot write {where}: {error.strerror or error}") from error


def find_program_name() -> str:
    """Return the name of this package's command, for messages.

    It is `aras-servo` if pip installed the package, and `bench` if catkin built it.
    """
    program = Path(sys.argv[0]).name
    return program if program == "aras-servo" else "bench"


def find_command() -> str:
    """Return the shell command that starts this package's program, to be shown in messages."""
    program = find_program_name()
    return "rosrun aras_visual_servo_bench bench" if program == "bench" else program


def make_missing_library_error(library: str | None, extra: str = "bench") -> BenchError:
    """Return the error for a missing library of pip's optional dependency group `extra`."""
    return BenchError(
        f"{library} is not installed: run ./setup.sh; without ROS, pip install '.[{extra}]' in the "
        "folder of the sources"
    )


def read_first_line(error: BaseException) -> str:
    """Return the first line of an exception's message; without a message, the name of its class."""
    return str(error).splitlines()[0] if str(error) else type(error).__name__


@lru_cache
def log_once(note: str) -> None:
    """Log a warning only once per process, because the runs of a study repeat many warnings."""
    log.warning("%s", note)
