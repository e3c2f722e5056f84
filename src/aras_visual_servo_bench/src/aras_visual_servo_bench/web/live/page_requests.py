"""Requests of the live page, their fields, and the limits of these fields.

For an invalid request, the answer is a one-line error message.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, make_dataclass
from typing import Any

from aras_visual_servo_base.names import suggest
from aras_visual_servo_base.setting_values import format_value
from aras_visual_servo_base.settings import build, parameter

from ...errors import RefusedRequestError

MAX_STEPS = 10_000  # largest number of simulation steps in one request: 10 s with steps of 1 ms
# largest distance (m) and angle (rad) of the offset from the goal
MAX_OFFSET, MAX_TURN = 0.3, math.pi
# largest speed (m/s) and angular speed (rad/s) of the camera when jogging
MAX_SPEED, MAX_TURN_RATE = 0.25, 1.0
NAME_PATTERN = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,39}")


@dataclass(frozen=True)
class GoalName:
    """Name of a taught goal, which is also the name of its file."""

    name: str

    def __post_init__(self) -> None:
        if not NAME_PATTERN.fullmatch(self.name):
            raise RefusedRequestError(f"teach: name is {format_value(self.name)}, must be 1 to 40 "
                                      "letters, digits, - or _, and start with a letter or "
                                      "digit")  # fmt: skip


def _make_request_type(**fields: type | tuple[type, Any]) -> type:
    """Create the dataclass with the fields of a request.

    fields: for each field its type, or a tuple of its type and its constraints, such as bounds.
    """
    found = [(name, *(kind if isinstance(kind, tuple) else (kind,)))
             for name, kind in fields.items()]  # fmt: skip
    return make_dataclass("RequestFields", found)


def _limit_magnitude(most: float) -> tuple[type, Any]:
    return float, parameter(0.0, least=-most, most=most)


# Type with the fields of a request, by the name of the request.
REQUESTS: dict[str, type] = {
    **dict.fromkeys(("start", "stop", "hold", "reset", "pause", "resume", "record", "stop_record",
                     "report"), _make_request_type()),
    "step": _make_request_type(steps=(int, parameter(least=1, most=MAX_STEPS))),
    "gain": _make_request_type(name=str, value=(float, parameter(least=1e-3, most=100.0))),
    "servo": _make_request_type(scheme=str, law=str, start=str, goal=str),
    "goal": _make_request_type(**{axis: _limit_magnitude(MAX_OFFSET) for axis in "xyz"},
                               turn=_limit_magnitude(MAX_TURN)),
    "camera": _make_request_type(preset=str),
    "target": _make_request_type(name=str),
    "teach": GoalName,
    "jog": _make_request_type(
        **{axis: _limit_magnitude(MAX_SPEED) for axis in ("vx", "vy", "vz")},
        **{axis: _limit_magnitude(MAX_TURN_RATE) for axis in ("wx", "wy", "wz")},
    ),
    "jog_joint": _make_request_type(joint=str, speed=(float, parameter(least=-1.0, most=1.0))),
}  # fmt: skip
# For each request, the fields whose value must be in a selection list of the page, and the key of
# this list in `choices`.
CHOICE_FIELDS = {
    "gain": {"name": "gains"}, "camera": {"preset": "cameras"}, "target": {"name": "targets"},
    "servo": {"scheme": "schemes", "law": "laws", "start": "starts", "goal": "goals"},
    "jog_joint": {"joint": "joints"},
}  # fmt: skip


@dataclass(frozen=True)
class PageRequest:
    """A valid request: its name, and the values of its fields."""

    do: str
    arguments: Mapping[str, Any]


def read_request(
    do: str, fields: Mapping[str, Any], choices: Mapping[str, Collection[str]]
) -> PageRequest:
    """Check the fields of a request, and return the request.

    Args:
        do: name of the request, one of REQUESTS.
        fields: values of its fields.
        choices: names in each selection list of the page, by the key of the list.

    Raises:
        RefusedRequestError: a field is missing, unknown or invalid.
    """
    values = vars(build(REQUESTS[do], fields, f"{do}: ", RefusedRequestError))
    for name, kind in CHOICE_FIELDS.get(do, {}).items():
        names = choices.get(kind, ())
        if values[name] not in names:
            raise RefusedRequestError(
                f"{do}: {name} is {format_value(values[name])}, which does not "
                f"exist: {suggest(values[name], names)}"
            )
    return PageRequest(do, values)
