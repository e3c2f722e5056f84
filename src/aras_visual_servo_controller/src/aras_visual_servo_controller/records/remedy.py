"""Remedies: advice for users, with changes of settings that a program can apply."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

OPERATIONS = ("set", "multiply", "remove")
# Descriptions of experiment settings that a remedy may multiply. The controller has no parameter
# with such a key, or one with another meaning.
KEY_DESCRIPTIONS = {
    "start": "the start's offset from the goal",
    "goal": "the goal's offset from the start",
    "jitter": "the features' jitter",
    "noise": "the images' noise",
    "target.size": "the target's size",
}
# Keys of a simulated experiment that are disturbances: removing such a key removes the disturbance.
# A robot has no such key, so the advice describes how to avoid the disturbance.
DISTURBANCES = ("calibration_offset", "target.motion", "target.occluded", "target.occluder")


@dataclass(frozen=True)
class SettingChange:
    """One change of a setting.

    Attributes:
        key: dotted key of the experiment, such as 'target.motion', or a parameter of the
            controller, such as 'gain'.
        operation: 'set' the setting to `value`, 'multiply' the setting by `value`, or 'remove' the
            key, so that the default is used.
        value: value of the operation; None for 'remove'.
    """

    key: str
    operation: str
    value: Any = None

    def __post_init__(self) -> None:
        if self.operation not in OPERATIONS:
            raise ValueError(
                f"operation '{self.operation}' is unknown; use one of {', '.join(OPERATIONS)}"
            )

    def __str__(self) -> str:
        if self.operation == "remove":
            return f"remove {self.key}"
        value = _format_value(self.value)
        if self.operation == "multiply":
            return f"multiply {KEY_DESCRIPTIONS.get(self.key, self.key)} by {value}"
        return f"set {self.key} to {value}"


class Remedy(str):
    """Advice to the user, as a text that ends with the changes of settings.

    The text also applies to a real robot: it names only parameters of the controller. A setting
    that only a simulated experiment has is described in words.

    Attributes:
        advice: the text without the changes.
        changes: changes that a program can apply; empty if only a person can help.
    """

    __slots__ = ("advice", "changes")
    advice: str
    changes: tuple[SettingChange, ...]

    def __new__(cls, advice: str = "", *changes: SettingChange) -> Remedy:
        """Create the remedy.

        Args:
            advice: what a person should do.
            changes: changes that a program can apply.

        Raises:
            TypeError: the advice is a Remedy, whose changes would be lost, or a change is no
                Change.
        """
        if isinstance(advice, Remedy) or not all(isinstance(one, SettingChange) for one in changes):
            raise TypeError(
                "a Remedy is made of a text and of Changes: pass the advice as str, then each "
                "Change"
            )
        text = " and ".join(str(one) for one in changes if one.key not in DISTURBANCES)
        remedy = super().__new__(cls, ": ".join(filter(None, (advice, text))))
        remedy.advice, remedy.changes = advice, changes
        return remedy

    def __reduce__(self) -> tuple:
        return Remedy, (self.advice, *self.changes)


def set_value(key: str, value: Any) -> SettingChange:
    """Return the change that sets a key."""
    return SettingChange(key, "set", value)


def multiply(key: str, factor: float) -> SettingChange:
    """Return the change that multiplies a key's value; the factor is rounded to two digits."""
    return SettingChange(key, "multiply", float(f"{factor:.2g}"))


def remove(key: str) -> SettingChange:
    """Return the change that removes a key."""
    return SettingChange(key, "remove")


def _format_value(value: Any) -> str:
    """Format a value as one line of YAML."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {_format_value(one)}" for key, one in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_format_value, value)) + "]"
    return f"{value:g}" if isinstance(value, float) else str(value)
