"""Reader of YAML files with settings.

It reads a file completely, or raises an error with a message of one line.
"""

from __future__ import annotations

import functools
import pickle
import stat
from pathlib import Path
from typing import Any

import yaml

LARGEST_FILE = 1_000_000  # bytes


def read_yaml(path: str | Path, fault: type[Exception], what: str = "") -> Any:
    """Return the content of a YAML file; None for an empty file.

    Args:
        fault: class of the exception to raise.
        what: kind of the file, for messages, such as 'the goal'.

    Raises:
        fault: the file is not a regular file, cannot be read, is too large, or is not YAML.
    """
    return parse_yaml(read_text(path, fault, what), str(Path(path).expanduser()), fault)


def read_text(path: str | Path, fault: type[Exception], what: str = "") -> str:
    """Return the text of a file with settings.

    The arguments and the errors are those of `read_yaml`.
    """
    path = Path(path).expanduser()
    cannot = " ".join(filter(None, ("cannot read", what, str(path))))
    try:
        # reading a pipe instead of a regular file would block
        if not stat.S_ISREG(path.stat().st_mode):
            raise fault(f"{cannot}: it is not a regular file")
        with open(path, "rb") as file:
            data = file.read(LARGEST_FILE + 1)
    # a ValueError is raised if the name contains a null byte
    except (OSError, ValueError) as error:
        raise fault(f"{cannot}: {getattr(error, 'strerror', None) or error}") from None
    if len(data) > LARGEST_FILE:
        raise fault(
            f"{path} has more than {LARGEST_FILE} bytes, the limit for a settings file; check that "
            "it is the correct file"
        )
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise fault(f"{path} is not UTF-8 text: {error}") from None


def parse_yaml(text: str, where: str, fault: type[Exception]) -> Any:
    """Return the content of a YAML text, as an object that the caller may change.

    Args:
        where: name of the text, for messages.

    Raises:
        fault: the text is not YAML.
    """
    try:
        return pickle.loads(_parse(text))
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        # PyYAML raises a ValueError for some invalid values, such as the date 2026-13-01 or a
        # number with 5000 digits. For such a number, the hint to use a function of `sys` is cut
        # off.
        words = " ".join(str(error).split()).partition("; use sys.")[0]
        raise fault(f"{where} is not valid YAML: {words}") from None


@functools.lru_cache(maxsize=32)
def _parse(text: str) -> bytes:
    """Parse a YAML text and pickle the result, or return the cached pickle.

    Each caller needs its own copy of the content, and unpickling is the fastest way to copy it. The
    cache saves about 10 ms per file, and the ten thousand runs of a study read the same few files.
    libyaml would be faster, but it crashes if a text is nested ten thousand levels deep.
    """
    return pickle.dumps(yaml.safe_load(text))
