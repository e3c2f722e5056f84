"""What to change about a run: a sentence for people, with the changes that a program makes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

OPERATIONS = ("set", "multiply", "remove")
# How to name what a factor acts on, where the key's own name does not say it.
KEY_DESCRIPTIONS = {
    "start": "the start's offset from the goal",
    "goal": "the goal's offset from the start",
    "jitter": "the features' jitter",
    "noise": "the images' noise",
}


@dataclass(frozen=True)
class Change:
    """One change of a setting.

    key: of the experiment, dotted, or a parameter of the controller: 'gain', 'target.motion'.
    operation: 'set' it to the value, 'multiply' what is there by the value, or 'remove' it, so that
        its default holds.
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
    """The advice as a sentence that ends with its changes.

    Attributes:
        changes: that a program makes, all of them; none where only a person can help.
    """

    __slots__ = ("changes",)
    changes: tuple[Change, ...]

    def __new__(cls, advice: str = "", *changes: Change) -> Remedy:
        """`advice`: what the changes are for, or what else a person should do."""
        words = " and ".join(map(str, changes))
        remedy = super().__new__(cls, ": ".join(filter(None, (advice, words))))
        remedy.changes = changes
        return remedy

    def __reduce__(self) -> tuple:
        return _restore, (str(self), self.changes)


def set_value(key: str, value: Any) -> Change:
    """The change that sets a key."""
    return Change(key, "set", value)


def multiply(key: str, factor: float) -> Change:
    """The change that multiplies what a key has; the factor is rounded to two digits."""
    return Change(key, "multiply", float(f"{factor:.2g}"))


def remove(key: str) -> Change:
    """The change that leaves a key out."""
    return Change(key, "remove")


def _restore(sentence: str, changes: tuple[Change, ...]) -> Remedy:
    remedy = Remedy(sentence)
    remedy.changes = changes
    return remedy


def _format_value(value: Any) -> str:
    """A value as YAML has it in a line."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {_format_value(one)}" for key, one in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_format_value, value)) + "]"
    return f"{value:g}" if isinstance(value, float) else str(value)
