"""What a page may ask for: each request checked, one line for what is refused."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

from aras_visual_servo_base.names import likely

from ..errors import BenchError

LARGEST = 4096  # bytes of a request
STEPS = 10_000  # physics steps of one request: 10 s of simulated time
OFFSET, TURN = 0.3, math.pi  # greatest shift (m) and turn (rad) of a goal by the page
SPEED, TURN_RATE = 0.25, 1.0  # m/s and rad/s of a camera that is driven by hand
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,39}")


class RefusedError(BenchError):
    """A request that is not carried out, with the reason."""


@dataclass(frozen=True)
class Number:
    """A field that holds a number between two bounds; whole: no fraction."""

    least: float
    greatest: float
    whole: bool = False
    default: float | None = None

    def read(self, name: str, value: Any) -> float:
        """The number; RefusedError naming the field."""
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise RefusedError(f"{name} is {str(value)[:40]!r}: it must be a number")
        try:
            value = float(value)
        except OverflowError:  # a whole number of hundreds of digits
            value = math.inf if value > 0 else -math.inf
        if not self.least <= value <= self.greatest:  # NaN fails, too
            raise RefusedError(f"{name} is {value:g}: it must be {self.least:g} to "
                               f"{self.greatest:g}")  # fmt: skip
        if self.whole and value != int(value):
            raise RefusedError(f"{name} is {value:g}: it must be a whole number")
        return int(value) if self.whole else float(value)


@dataclass(frozen=True)
class Choice:
    """A field that holds one of the page's choices of a kind."""

    kind: str


@dataclass(frozen=True)
class Word:
    """A field that holds a name: letters, digits, - and _, at most 40."""


Spec = Number | Choice | Word
MOVE, ROTATE = Number(-SPEED, SPEED, default=0.0), Number(-TURN_RATE, TURN_RATE, default=0.0)
SHIFT = Number(-OFFSET, OFFSET, default=0.0)
# What may be asked for, and with what.
REQUESTS: dict[str, dict[str, Spec]] = {
    "start": {}, "stop": {}, "hold": {}, "reset": {}, "pause": {}, "resume": {},
    "step": {"steps": Number(1, STEPS, whole=True)},
    "gain": {"name": Choice("gains"), "value": Number(1e-3, 100.0)},
    "servo": {
        "scheme": Choice("schemes"), "law": Choice("laws"), "start": Choice("starts"),
        "goal": Choice("goals"),
    },
    "goal": {"x": SHIFT, "y": SHIFT, "z": SHIFT, "turn": Number(-TURN, TURN, default=0.0)},
    "camera": {"preset": Choice("cameras")},
    "target": {"name": Choice("targets")},
    "teach": {"name": Word()},
    "record": {}, "stop_record": {}, "report": {},
    "jog": {"vx": MOVE, "vy": MOVE, "vz": MOVE, "wx": ROTATE, "wy": ROTATE, "wz": ROTATE},
    "jog_joint": {"joint": Choice("joints"), "speed": Number(-1.0, 1.0)},
}  # fmt: skip


@dataclass(frozen=True)
class Request:
    """A checked request: what is to be done, and with what."""

    do: str
    given: Mapping[str, Any]


def read_request(text: str | bytes, choices: Mapping[str, Collection[str]]) -> Request:
    """A request of a page's message, a JSON object {"do": NAME, ...}.

    Raises:
        RefusedError: it is none, is too long, or one of its fields is missing, unknown or wrong.
    """
    if not isinstance(text, str) or len(text) > LARGEST:
        raise RefusedError(f"a request is a text of at most {LARGEST} characters")
    try:
        data = json.loads(text)
    except (ValueError, RecursionError):
        raise RefusedError("a request is a JSON object") from None
    if not isinstance(data, dict) or not isinstance(data.get("do"), str):
        raise RefusedError("a request is a JSON object with a key 'do'")
    do = data.pop("do")
    if do not in REQUESTS:
        near = likely(do, REQUESTS)
        raise RefusedError(f"there is no request '{do[:40]}'" + (
            f": did you mean '{near}'?" if near else f"; there are {', '.join(REQUESTS)}"))
    specs = REQUESTS[do]
    for name in data:
        if name not in specs:
            raise RefusedError(f"{do} takes no '{name[:40]}'" + (
                f"; it takes {', '.join(specs)}" if specs else ""))
    return Request(do, {name: _read(name, spec, data, choices) for name, spec in specs.items()})


def _read(
    name: str, spec: Spec, data: Mapping[str, Any], choices: Mapping[str, Collection[str]]
) -> Any:
    if name not in data:
        if isinstance(spec, Number) and spec.default is not None:
            return spec.default
        raise RefusedError(f"'{name}' is missing")
    value = data[name]
    if isinstance(spec, Number):
        return spec.read(name, value)
    if isinstance(spec, Choice):
        known = choices.get(spec.kind, ())
        if not isinstance(value, str) or value not in known:
            raise RefusedError(f"{name} is {str(value)[:40]!r}: there are "
                               f"{', '.join(known) or 'none now'}")  # fmt: skip
        return value
    if not isinstance(value, str) or not NAME.fullmatch(value):
        raise RefusedError(
            f"{name} is {str(value)[:40]!r}: letters, digits, - and _ are allowed, 40 at most"
        )
    return value
