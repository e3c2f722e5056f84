"""YAML files of settings: read whole, or refused in one line."""

from __future__ import annotations

import copy
import functools
import stat
from pathlib import Path
from typing import Any

import yaml

LARGEST_FILE = 1_000_000  # bytes


def read_yaml(path: str | Path, fault: type[Exception], what: str = "") -> Any:
    """What a YAML file holds; None for an empty one.

    Args:
        what: the file is, for messages, as 'the goal'.

    Raises:
        fault: it is no ordinary file, cannot be read, is too large, or is no YAML.
    """
    return parse_yaml(read_text(path, fault, what), str(Path(path).expanduser()), fault)


def read_text(path: str | Path, fault: type[Exception], what: str = "") -> str:
    """The text of a file of settings; see `read_yaml`."""
    path = Path(path).expanduser()
    cannot = " ".join(filter(None, ("cannot read", what, str(path))))
    try:
        if not stat.S_ISREG(path.stat().st_mode):  # a pipe would be waited for
            raise fault(f"{cannot}: it is no ordinary file")
        with open(path, "rb") as file:
            data = file.read(LARGEST_FILE + 1)
    except (OSError, ValueError) as error:  # a null byte in the name is a ValueError
        raise fault(f"{cannot}: {getattr(error, 'strerror', None) or error}") from None
    if len(data) > LARGEST_FILE:
        raise fault(f"{path} holds more than {LARGEST_FILE} bytes: no such file is meant")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise fault(f"{path} is no text in UTF-8: {error}") from None


def parse_yaml(text: str, where: str, fault: type[Exception]) -> Any:
    """What a YAML text says, the caller's own copy.

    Args:
        where: the text's name, for the message.

    Raises:
        fault: it is no YAML.
    """
    try:
        return copy.deepcopy(_parse(text))
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        # A ValueError comes of a number of 5000 digits, and of a date such as 2026-13-01.
        words = " ".join(str(error).split()).partition("; use sys.")[0]
        raise fault(f"{where} is not valid YAML: {words}") from None


@functools.lru_cache(maxsize=32)
def _parse(text: str) -> Any:
    """Texts read lately are not parsed again: ten thousand runs of a process read the same few
    files, at 10 ms a file. libyaml would be quick but crashes on what is nested ten thousand deep.
    """
    return yaml.safe_load(text)
