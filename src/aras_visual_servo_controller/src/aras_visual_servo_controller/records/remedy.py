"""Remedies: a sentence for users, with changes of settings that a program can apply."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

OPERATIONS = ("set", "multiply", "remove")
# Descriptions of the scaled quantities whose key is not self-explanatory.
KEY_DESCRIPTIONS = {
    "start": "the start's offset from the goal",
    "goal": "the goal's offset from the start",
    "jitter": "the features' jitter",
    "noise": "the images' noise",
}


@dataclass(frozen=True)
class Change:
    """One change of a setting.

    key: dotted key of the experiment, or a parameter of the controller: 'gain', 'target.motion'.
    operation: 'set' the key to the value, 'multiply' its value by the value, or 'remove' the key,
        so that its default is used.
    """

    key: str
    operation: str
    value: Any = None

    def __post_init__(self) -> None:
        if self.operation not in OPERATIONS:
            raise ValueError(f"operation '{self.operation}' is none of {', '.join(OPERATIONS)}")

    def __str__(self) -> str:
        if self.operation == "remove":
            return f"remove {self.key}"
        value = _format_value(self.value)
        if self.operation == "multiply":
            return f"multiply {KEY_DESCRIPTIONS.get(self.key, self.key)} by {value}"
        return f"set {self.key} to {value}"


class Remedy(str):
    """Advice as a sentence that ends with its changes.

    Attributes:
        changes: that a program can apply; empty if only a person can help.
    """

    __slots__ = ("changes",)
    changes: tuple[Change, ...]

    def __new__(cls, advice: str = "", *changes: Change) -> Remedy:
        """Create the remedy from `advice`, which says what a person should do, and its changes."""
        text = " and ".join(map(str, changes))
        remedy = super().__new__(cls, ": ".join(filter(None, (advice, text))))
        remedy.changes = changes
        return remedy

    def __reduce__(self) -> tuple:
        return _restore, (str(self), self.changes)


def set_value(key: str, value: Any) -> Change:
    """Return the change that sets a key."""
    return Change(key, "set", value)


def multiply(key: str, factor: float) -> Change:
    """Return the change that multiplies the value of a key; the factor is rounded to two digits."""
    return Change(key, "multiply", float(f"{factor:.2g}"))


def remove(key: str) -> Change:
    """Return the change that removes a key."""
    return Change(key, "remove")


def _restore(sentence: str, changes: tuple[Change, ...]) -> Remedy:
    remedy = Remedy(sentence)
    remedy.changes = changes
    return remedy


def _format_value(value: Any) -> str:
    """Format a value as YAML in one line."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {_format_value(one)}" for key, one in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_format_value, value)) + "]"
    return f"{value:g}" if isinstance(value, float) else str(value)
