"""What a study varies: values in turn, and numbers drawn from distributions.

Written under `vary`, by dotted key: a list of values, or one of

    linear: [from, to, count]     evenly spaced         log: [from, to, count]   by equal factors
    uniform: [low, high]          drawn                 loguniform: [low, high]
    normal: [mean, deviation]     integers: [low, high] (both included)          choice: [values]

Lists and spacings make a grid; what is drawn is drawn for all keys together, `samples` times.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import scipy

from aras_visual_servo_base.names import nearest
from aras_visual_servo_base.settings import convert

from ..errors import StudyError

BLOCK = 1024  # Sobol points made at a time
POINTS = 0x706F696E  # tells the stream of parameters from those of runs
MOST_VALUES = 1_000_000


@dataclass(frozen=True)
class Axis:
    """A key whose values are taken in turn."""

    key: str
    values: tuple[Any, ...]


@dataclass(frozen=True)
class Draw:
    """A key whose value is drawn; value: of a number from 0 to 1. ends: of the range, to check."""

    key: str
    value: Callable[[float], Any]
    ends: tuple[Any, ...]


def variation(key: str, given: Any) -> Axis | Draw:
    """What is written under a key of `vary`.

    Raises:
        StudyError: naming what is wrong.
    """
    if isinstance(given, list | tuple):
        if not given:
            raise StudyError(f"vary.{key} is an empty list: a study of no runs")
        return Axis(key, tuple(given))
    if not (isinstance(given, Mapping) and len(given) == 1):
        raise StudyError(
            f"vary.{key} is {given!r}, must be a list, or one of {', '.join(_KINDS)} with its "
            "numbers; what does not vary belongs under experiment"
        )
    kind, numbers = next(iter(given.items()))
    if kind not in _KINDS:
        raise StudyError(
            f"vary.{key}: unknown '{kind}': {nearest(kind, _KINDS)}; a key below {key} is written "
            f"with a dot: {key}.{kind}"
        )
    return _KINDS[kind](key, kind, numbers)


def _numbers(key: str, kind: str, given: Any, count: int) -> list[float]:
    return list(convert(given, tuple[(float,) * count], f"vary.{key}.{kind}", StudyError))


def _ordered(key: str, kind: str, given: Any, above: float = -math.inf) -> tuple[float, float]:
    low, high = _numbers(key, kind, given, 2)
    if not above < low < high:
        floor = "" if above == -math.inf else f" from above {above:g}"
        raise StudyError(f"vary.{key}.{kind} is {low:g} to {high:g}, must rise{floor}")
    return low, high


def _spaced(key: str, kind: str, given: Any) -> Axis:
    first, last, count = _numbers(key, kind, given, 3)
    if not (count == int(count) and 2 <= count <= MOST_VALUES):
        raise StudyError(f"vary.{key}.{kind}: {count:g} is no count from 2 to {MOST_VALUES}")
    if kind == "log" and min(first, last) <= 0.0:
        raise StudyError(f"vary.{key}.log: both ends must be above 0")
    make = np.geomspace if kind == "log" else np.linspace
    return Axis(key, tuple(make(first, last, int(count)).tolist()))


def _uniform(key: str, kind: str, given: Any) -> Draw:
    low, high = _ordered(key, kind, given)
    return Draw(key, lambda u: low + u * (high - low), (low, high))


def _loguniform(key: str, kind: str, given: Any) -> Draw:
    low, high = _ordered(key, kind, given, 0.0)
    return Draw(key, lambda u: math.exp(math.log(low) + u * math.log(high / low)), (low, high))


def _normal(key: str, kind: str, given: Any) -> Draw:
    mean, deviation = _numbers(key, kind, given, 2)
    if deviation <= 0.0:
        raise StudyError(f"vary.{key}.normal: the deviation is {deviation:g}, must be above 0")
    return Draw(key, lambda u: mean + deviation * float(scipy.special.ndtri(u)), (mean,))


def _integers(key: str, kind: str, given: Any) -> Draw:
    low, high = _ordered(key, kind, given)
    if low != int(low) or high != int(high):
        raise StudyError(f"vary.{key}.integers is {low:g} to {high:g}, must be whole numbers")
    first, count = int(low), int(high - low) + 1
    return Draw(key, lambda u: first + min(int(u * count), count - 1), (int(low), int(high)))


def _choice(key: str, kind: str, given: Any) -> Draw:
    if not (isinstance(given, list | tuple) and given):
        raise StudyError(f"vary.{key}.choice is {given!r}, must be a list of values")
    values = tuple(given)
    return Draw(key, lambda u: values[min(int(u * len(values)), len(values) - 1)], values)


_KINDS: dict[str, Callable[[str, str, Any], Axis | Draw]] = {
    "linear": _spaced,
    "log": _spaced,
    "uniform": _uniform,
    "loguniform": _loguniform,
    "normal": _normal,
    "integers": _integers,
    "choice": _choice,
}


def drawn(draws: Sequence[Draw], sampling: str, entropy: int, sample: int) -> dict[str, Any]:
    """Values of the keys that are drawn, in the sample of that number; the same on any machine."""
    if not draws:
        return {}
    if sampling == "sobol":
        unit = _sobol(len(draws), entropy, sample // BLOCK)[sample % BLOCK]
    else:
        seeds = np.random.SeedSequence(entropy, spawn_key=(POINTS, sample))
        unit = np.random.default_rng(seeds).random(len(draws))
    inside = np.maximum(unit, 1e-12).tolist()  # of a normal 0 is infinite, and 1 never comes
    return {draw.key: draw.value(u) for draw, u in zip(draws, inside, strict=True)}


@lru_cache(maxsize=4)
def _sobol(dimensions: int, entropy: int, block: int) -> np.ndarray:
    """Points (BLOCK, dimensions) of the scrambled sequence, from block * BLOCK on."""
    seeds = np.random.SeedSequence(entropy, spawn_key=(POINTS,))
    sequence = scipy.stats.qmc.Sobol(dimensions, rng=np.random.default_rng(seeds))
    if block:
        sequence.fast_forward(block * BLOCK)
    return sequence.random(BLOCK)
