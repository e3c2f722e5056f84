"""Parameters in the types of their defaults: nothing is bent, and every fault says the mend."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping
from typing import TypeVar

import rosgraph
import rospy

Value = float | int | bool | str | tuple[str, ...]
T = TypeVar("T", bound=Value)

_WANTED = {float: "a number", int: "a whole number", bool: "true or false", str: "text"}


class InvalidParameterError(ValueError):
    """A parameter is unknown, of the wrong type or out of range.

    Attributes:
        name: as it was given. reason: what is wrong with it, and the mend.
    """

    def __init__(self, name: str, reason: str) -> None:
        self.name = name
        self.reason = reason
        super().__init__(f"{name} {reason}")


def fetched(name: str) -> object:
    """Return what the parameter server holds under a name; {} where there is nothing.

    It is asked itself: rospy keeps a copy of some of it, which it takes for the whole of `/`.
    """
    try:
        return rosgraph.Master(rospy.get_name()).getParam(rospy.resolve_name(name))
    except rosgraph.MasterError:
        return {}


def namespace_of(name: str) -> dict[str, object]:
    """Return the parameters below a name; none where it is a single one."""
    values = fetched(name)
    return values if isinstance(values, dict) else {}


def nearest(name: str, known: Iterable[str]) -> str:
    """Return the hint for an unknown name: the known one nearest to it, or all there are."""
    known = list(known)
    near = difflib.get_close_matches(name, known, 1)
    return f"did you mean {near[0]}?" if near else f"known are {', '.join(known)}"


def converted(name: str, value: object, default: T) -> T:
    """Return value in the type of default; ints pass for floats, a text for a list of its words.

    Raises:
        InvalidParameterError: it is of another type, or not finite.
    """
    kind = type(default)
    if kind is float and isinstance(value, (int, float)) and not isinstance(value, bool):
        if not math.isfinite(value):
            raise InvalidParameterError(name, f"is {value}; give a finite number")
        return float(value)
    if kind is tuple:
        words = value.split() if isinstance(value, str) else value
        if isinstance(words, list) and all(isinstance(word, str) for word in words):
            return tuple(words)
    elif type(value) is kind:
        return value
    wanted = _WANTED.get(kind, "a list of texts")
    found = f"is {value!r}, of type {type(value).__name__}"
    raise InvalidParameterError(name, f"{found}; give {wanted}")


def read(
    values: Mapping[str, object],
    defaults: Mapping[str, Value],
    namespace: str,
    foreign: Iterable[str] = (),
) -> dict[str, Value]:
    """Return what `values` (as the parameter server gives them) has for the names in `defaults`.

    Args:
        namespace: of the values, for what is said of them.
        foreign: names of others that may stand there; whole namespaces may as well.

    Raises:
        InvalidParameterError: one is unknown, or of the wrong type.
    """
    checked = {}
    for name, value in values.items():
        if name in defaults:
            checked[name] = converted(f"{namespace}/{name}", value, defaults[name])
        elif name not in foreign and not isinstance(value, Mapping):
            hint = nearest(name, defaults)
            raise InvalidParameterError(f"{namespace}/{name}", f"is unknown; {hint}")
    return checked
