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

from ...drawing.feature_units import find_feature_units
from ...drawing.run_trace import RunTrace
from ...drawing.shapes import DIGITS, TEXT, Shape

MAX_SAMPLES = 900  # samples: half a minute at 30 images/s
CLOCK_RESET = -1.0  # s; a stamp that much older than the last begins anew


def to_json_numbers(values: Sequence[float], digits: int = 6) -> list[float | None]:
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
        self._samples: deque[list[Any]] = deque(maxlen=MAX_SAMPLES)
        self._new_samples: list[list[Any]] = []
        self._sent_values: dict[str, str | bytes] = {}
        self._controller_state: dict[str, Any] = {}
        self._shapes: dict[str, dict[str, Any]] = {}

    # -- what it is told -------------------------------------------------------------------

    def set_robot(self, names: Sequence[str], lower: Sequence[float], upper: Sequence[float],
              velocity: Sequence[float], prismatic: Sequence[bool]) -> None:  # fmt: skip
        """The joints (n,) and their limits; infinite ones are null."""
        self._limits = {
            "names": list(names), "lower": to_json_numbers(lower), "upper": to_json_numbers(upper),
            "velocity": to_json_numbers(velocity), "prismatic": [bool(p) for p in prismatic],
        }  # fmt: skip

    def add_sample(self, state: ServoState, joints: Sequence[float]) -> None:
        """One state of the controller, for the plots."""
        if self._samples and (
            state.names != self._names or state.stamp - self._samples[-1][0] < CLOCK_RESET
        ):
            self._samples.clear()
            self._new_samples = [["clear"]]
        self._names = state.names
        error = () if state.error is None else state.error
        row = [
            round(state.stamp, 4), to_json_numbers(error), to_json_numbers(state.desired_twist),
            to_json_numbers(state.achieved_twist),
            to_json_numbers(joints),
        ]  # fmt: skip
        self._samples.append(row)
        self._new_samples.append(row)
        if len(self._new_samples) > MAX_SAMPLES:  # nobody looks
            self._new_samples = []

    # -- what it answers -------------------------------------------------------------------

    def make_full_message(self) -> dict[str, Any]:
        """Everything, for a viewer that has just come."""
        return {
            "kind": "whole",
            "limits": self._limits,
            "choices": self.choices,
            "state": self.state,
            "told": self._controller_state,
            "names": list(self._names),
            "samples": list(self._samples),
            "shapes": self._shapes,
        }

    def make_update(
        self, run_trace: RunTrace | None, joints: Sequence[float], velocities: Sequence[float],
        stamp: float,
    ) -> dict[str, Any]:  # fmt: skip
        """What has changed since the last call, for those who are there."""
        message: dict[str, Any] = {"kind": "news", "stamp": round(stamp, 3)}
        if run_trace is not None:
            told = run_trace.state
            message["joints"], message["speeds"] = (
                to_json_numbers(joints),
                to_json_numbers(velocities, 4),
            )
            message["factor"] = None if run_trace.factor is None else round(run_trace.factor, 3)
            self._controller_state = {
                "scheme": told.scheme, "phase": told.phase, "outcome": told.outcome,
                "reason": told.reason, "remedy": told.remedy,
                "units": list(find_feature_units(told.scheme, len(told.names))),
            }  # fmt: skip
            self._add_if_changed(message, "told", self._controller_state)
            shapes = self._find_changed_shapes(run_trace.make_shapes())
            if shapes:
                message["shapes"] = shapes
        self._add_if_changed(message, "limits", self._limits)
        self._add_if_changed(message, "choices", self.choices)
        self._add_if_changed(message, "state", self.state)
        if self._new_samples:
            message["samples"], self._new_samples = self._new_samples, []
            message["names"] = list(self._names)
        return message

    def _add_if_changed(self, message: dict[str, Any], key: str, value: Mapping[str, Any]) -> None:
        mark = repr(value)
        if self._sent_values.get(key) != mark:
            self._sent_values[key] = mark
            message[key] = value

    def _find_changed_shapes(self, shapes: Sequence[Shape]) -> dict[str, dict[str, Any] | None]:
        """By name; null for what is no more."""
        changed: dict[str, dict[str, Any] | None] = {}
        names = set()
        for shape in shapes:
            if shape.kind == TEXT:
                continue  # the page says it in its own place
            names.add(shape.name)
            mark = np.round(shape.points, DIGITS).tobytes()
            if self._sent_values.get(f"shape {shape.name}") == mark:
                continue
            self._sent_values[f"shape {shape.name}"] = mark
            changed[shape.name] = self._shapes[shape.name] = shape.to_json()
        for name in set(self._shapes) - names:
            del self._shapes[name]
            del self._sent_values[f"shape {name}"]
            changed[name] = None
        return changed
