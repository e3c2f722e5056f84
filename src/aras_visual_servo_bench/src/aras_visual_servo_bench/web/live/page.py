"""What the live page is told: from a story to messages, each thing once.

A viewer that comes gets everything; after that all viewers get what has changed.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from aras_visual_servo_controller.records.state import ServoState

from ...drawing.shapes import DIGITS, TEXT, Shape
from ...drawing.story import Story
from ...drawing.units import feature_units

KEPT = 900  # samples: half a minute at 30 images/s
NEW_RUN = -1.0  # s; a stamp that much older than the last begins anew


def finite(values: Sequence[float], digits: int = 6) -> list[float | None]:
    """Numbers as JSON may hold them; null for what is none."""
    return [round(float(v), digits) if math.isfinite(v) else None for v in values]


class Page:
    """The page's contents.

    Attributes:
        choices: what may be chosen, by kind: lists of names.
        state: further words and numbers for the page, plain for JSON; sent when they change.
    """

    def __init__(self) -> None:
        self.choices: dict[str, list[str]] = {}
        self.state: dict[str, Any] = {}
        self._limits: dict[str, Any] = {}
        self._names: tuple[str, ...] = ()
        self._samples: deque[list[Any]] = deque(maxlen=KEPT)
        self._fresh: list[list[Any]] = []
        self._sent: dict[str, str | bytes] = {}
        self._told: dict[str, Any] = {}
        self._shapes: dict[str, dict[str, Any]] = {}

    # -- what it is told -------------------------------------------------------------------

    def robot(self, names: Sequence[str], lower: Sequence[float], upper: Sequence[float],
              velocity: Sequence[float], prismatic: Sequence[bool]) -> None:  # fmt: skip
        """The joints (n,) and their limits; infinite ones are null."""
        self._limits = {
            "names": list(names), "lower": finite(lower), "upper": finite(upper),
            "velocity": finite(velocity), "prismatic": [bool(p) for p in prismatic],
        }  # fmt: skip

    def sample(self, told: ServoState, joints: Sequence[float]) -> None:
        """One state of the controller, for the plots."""
        if self._samples and (
            told.names != self._names or told.stamp - self._samples[-1][0] < NEW_RUN
        ):
            self._samples.clear()
            self._fresh = [["clear"]]
        self._names = told.names
        error = () if told.error is None else told.error
        row = [
            round(told.stamp, 4), finite(error), finite(told.twist), finite(told.achieved),
            finite(joints),
        ]  # fmt: skip
        self._samples.append(row)
        self._fresh.append(row)
        if len(self._fresh) > KEPT:  # nobody looks
            self._fresh = []

    # -- what it answers -------------------------------------------------------------------

    def whole(self) -> dict[str, Any]:
        """Everything, for a viewer that has just come."""
        return {
            "kind": "whole",
            "limits": self._limits,
            "choices": self.choices,
            "state": self.state,
            "told": self._told,
            "names": list(self._names),
            "samples": list(self._samples),
            "shapes": self._shapes,
        }

    def news(
        self, story: Story | None, joints: Sequence[float], velocities: Sequence[float],
        stamp: float,
    ) -> dict[str, Any]:  # fmt: skip
        """What has changed since the last call, for those who are there."""
        message: dict[str, Any] = {"kind": "news", "stamp": round(stamp, 3)}
        if story is not None:
            told = story.told
            message["joints"], message["speeds"] = finite(joints), finite(velocities, 4)
            message["factor"] = None if story.factor is None else round(story.factor, 3)
            self._told = {
                "scheme": told.scheme, "phase": told.phase, "outcome": told.outcome,
                "reason": told.reason, "remedy": told.remedy,
                "units": list(feature_units(told.scheme, len(told.names))),
            }  # fmt: skip
            self._changed(message, "told", self._told)
            shapes = self._changed_shapes(story.shapes())
            if shapes:
                message["shapes"] = shapes
        self._changed(message, "limits", self._limits)
        self._changed(message, "choices", self.choices)
        self._changed(message, "state", self.state)
        if self._fresh:
            message["samples"], self._fresh = self._fresh, []
            message["names"] = list(self._names)
        return message

    def _changed(self, message: dict[str, Any], key: str, value: Mapping[str, Any]) -> None:
        mark = repr(value)
        if self._sent.get(key) != mark:
            self._sent[key] = mark
            message[key] = value

    def _changed_shapes(self, shapes: Sequence[Shape]) -> dict[str, dict[str, Any] | None]:
        """By name; null for what is no more."""
        changed: dict[str, dict[str, Any] | None] = {}
        names = set()
        for shape in shapes:
            if shape.kind == TEXT:
                continue  # the page says it in its own place
            names.add(shape.name)
            mark = np.round(shape.points, DIGITS).tobytes()
            if self._sent.get(f"shape {shape.name}") == mark:
                continue
            self._sent[f"shape {shape.name}"] = mark
            changed[shape.name] = self._shapes[shape.name] = shape.plain()
        for name in set(self._shapes) - names:
            del self._shapes[name]
            del self._sent[f"shape {name}"]
            changed[name] = None
        return changed
