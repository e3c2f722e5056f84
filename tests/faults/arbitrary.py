"""Random ROS messages of any type, generated from the message definitions."""

from __future__ import annotations

import random
from collections.abc import Sequence
from typing import Any

import genpy
import roslib.message

FLOATS = (0.0, -0.0, 1.0, -1.0, 1e-308, 1e9, -1e9, 1e308, -1e308,
          float("nan"), float("inf"), float("-inf"))  # fmt: skip
TEXTS = ("", " ", "/", "//", "a//b", "~", "../../etc/passwd", "\u2603", "\x00", "x" * 10_000,
         "<robot/>", "world", "/world", "%s%n", "{}")  # fmt: skip
LENGTHS = (0, 1, 2, 6, 100)
INTEGERS = {
    f"{sign}int{bits}": (0 if sign else -(2 ** (bits - 1)), 2 ** (bits - (not sign)) - 1)
    for sign in ("", "u")
    for bits in (8, 16, 32, 64)
} | {"byte": (-128, 127), "char": (0, 255)}


class Arbitrary:
    """Generator of random messages; equal seeds give equal messages."""

    def __init__(self, seed: int, names: Sequence[str] = (), likely: float = 0.5) -> None:
        """`names`: that exist, of models and the like, drawn with probability `likely`."""
        self._draw = random.Random(seed)
        self._names, self._likely = tuple(names), likely

    def message(self, kind: type[genpy.Message], depth: int = 0) -> genpy.Message:
        made = kind()
        for name, of in zip(kind.__slots__, kind._slot_types, strict=True):
            setattr(made, name, self._value(of, depth))
        return made

    def _value(self, of: str, depth: int) -> Any:
        element, is_array, length = _parsed(of)
        if is_array:
            count = self._draw.choice(LENGTHS[: 5 - min(depth, 3)]) if length is None else length
            if element in ("uint8", "char"):
                return bytes(self._draw.randrange(256) for _ in range(count))
            return [self._value(element, depth + 1) for _ in range(count)]
        if element in ("float32", "float64"):
            number = self._draw.choice((*FLOATS, self._draw.gauss(0.0, 1.0)))
            return max(min(number, 3.4e38), -3.4e38) if element == "float32" else number
        if element == "string":
            if self._names and self._draw.random() < self._likely:
                return self._draw.choice(self._names)
            return self._draw.choice(TEXTS)
        if element == "bool":
            return self._draw.random() < 0.5
        if element in INTEGERS:
            low, high = INTEGERS[element]
            return self._draw.choice((low, high, max(low, -1), 0, 1, self._draw.randint(low, high)))
        if element in ("time", "duration"):
            nanoseconds = self._draw.choice((0, 999_999_999))
            if element == "time":
                return genpy.Time(self._draw.choice((0, 1, 2**32 - 1)), nanoseconds)
            return genpy.Duration(self._draw.choice((0, 1, -1, 2**31 - 1, -(2**31))), nanoseconds)
        if element == "Header":
            element = "std_msgs/Header"
        return self.message(roslib.message.get_message_class(element), depth + 1)


def _parsed(of: str) -> tuple[str, bool, int | None]:
    """Return the element type of a field, whether it is an array, and its length if it is fixed."""
    if not of.endswith("]"):
        return of, False, None
    element, _, length = of[:-1].partition("[")
    return element, True, int(length) if length else None
