"""How a parameter is declared, and how what is given for it is checked."""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import difflib
import functools
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from .errors import ConfigurationError

JOINTWISE = ("lead", "stiffness", "damping")  # that have a number as their default
NAMES = ("namespace", "camera_namespace", "command_topic", "description")
LEGAL = re.compile(r"[~/]?[A-Za-z][\w/]*", re.ASCII)
LONGEST = 1 << 20  # bytes of a YAML file


def parameter(
    default: Any,
    unit: str,
    text: str,
    least: float | None = None,
    above: float | None = None,
    most: float | None = None,
    internal: bool = False,
) -> Any:
    """A dataclass field with what its table says; `least`, `above` and `most` bound a number."""
    metadata = {
        "unit": unit, "text": text, "least": least, "above": above, "most": most,
        "internal": internal,
    }  # fmt: skip
    if isinstance(default, dict):
        return dataclasses.field(default_factory=lambda: dict(default), metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


def default_of(field: dataclasses.Field) -> Any:
    """The default of a field, whichever way it is kept."""
    if field.default is not dataclasses.MISSING:
        return field.default
    return field.default_factory()


def suggestion(name: str, known: Iterable[str]) -> str:
    """The nearest known name as a question, or all of them."""
    known = [str(entry) for entry in known]
    near = difflib.get_close_matches(str(name), known, 1)
    return f"did you mean '{near[0]}'?" if near else f"known are {', '.join(known)}"


def checked(field: dataclasses.Field, value: Any) -> Any:
    """The value in the kind of the field's default.

    Raises:
        ConfigurationError: another kind, not finite, or out of its bounds.
    """
    kind, default = "", default_of(field)
    if field.name in ("start", "desired", "scheme"):
        value = _named(value)
    if field.name == "start":
        return value
    if default is None or field.name in JOINTWISE:
        if not _for_joints(value):
            kind = "a number, a list of numbers in the arm's order, or {joint: number}"
    elif isinstance(default, bool):
        kind = "" if isinstance(value, bool) else "true or false"
    elif isinstance(default, float):
        with contextlib.suppress(ValueError):  # YAML takes 1e9 for a word
            value = float(value) if isinstance(value, str) else value
        kind = "" if is_number(value) else "a finite number"
        value = float(value) if not kind else value
    elif isinstance(default, str):
        kind = "" if isinstance(value, str) and (value or not default) else "a string"
    elif isinstance(default, tuple):
        kind = "" if isinstance(value, list | tuple) else "a list"
        value = tuple(value) if not kind else value
    elif isinstance(default, dict):
        kind = "" if isinstance(value, Mapping) else "a mapping, as {name: value}"
        value = dict(value) if not kind else value
    if kind:
        raise ConfigurationError(f"parameter ~{field.name} is {value!r}, must be {kind}")
    least, above = field.metadata.get("least"), field.metadata.get("above")
    if least is not None and value < least:
        raise ConfigurationError(f"parameter ~{field.name} is {value}, must be >= {least:g}")
    if above is not None and value <= above:
        raise ConfigurationError(f"parameter ~{field.name} is {value}, must be > {above:g}")
    if (most := field.metadata.get("most")) is not None and value > most:
        raise ConfigurationError(f"parameter ~{field.name} is {value:g}, must be <= {most:g}")
    if field.name in NAMES and not LEGAL.fullmatch(value or "x"):
        raise ConfigurationError(
            f"parameter ~{field.name} is '{value}', which is no name on a ROS graph: letters, "
            "digits, _ and / are"
        )
    if default is None or field.name in JOINTWISE:
        return value if isinstance(value, int) else _floats(value)
    return value


def is_number(value: Any) -> bool:
    """Whether it is a finite number, which true and false are not."""
    return (
        isinstance(value, int | float | np.number)
        and not isinstance(value, bool)
        and bool(np.isfinite(value))
    )


def parsed_yaml(text: str) -> Any:
    """What YAML says, the caller's own; texts read lately are not parsed again.

    Ten thousand runs in a process read the same few files, and parsing takes 10 ms a file. libyaml
    would be quick but crashes on what is nested ten thousand deep.

    Raises:
        yaml.YAMLError, RecursionError: it is none.
    """
    return copy.deepcopy(_parsed(text))


@functools.lru_cache(maxsize=32)
def _parsed(text: str) -> Any:
    return yaml.safe_load(text)


def yaml_mapping(path: Path) -> Mapping[str, Any]:
    """What a YAML file of parameters holds.

    Raises:
        ConfigurationError: not to be read, longer than a megabyte, or no mapping.
    """
    try:
        with open(path, encoding="utf-8") as file:
            text = file.read(LONGEST + 1)
        if len(text) > LONGEST:
            raise ConfigurationError(f"{path}: longer than {LONGEST} characters: no parameters")
        data = parsed_yaml(text)
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ConfigurationError(f"cannot read {path}: {' '.join(str(error).split())}") from error
    if not isinstance(data, Mapping):
        raise ConfigurationError(f"{path}: must hold a mapping, not {type(data).__name__}")
    return {str(key): value for key, value in data.items()}


def _named(value: Any) -> Any:
    """roslaunch turns start:=2016 into an integer, which is a name."""
    if isinstance(value, int) and not isinstance(value, bool):
        return str(value)
    return value


def _for_joints(value: Any) -> bool:
    if isinstance(value, Mapping):
        return all(isinstance(key, str) and is_number(item) for key, item in value.items())
    if isinstance(value, list | tuple):
        return bool(value) and all(is_number(item) for item in value)
    return is_number(value)


def _floats(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: float(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return tuple(float(item) for item in value)
    return float(value)
