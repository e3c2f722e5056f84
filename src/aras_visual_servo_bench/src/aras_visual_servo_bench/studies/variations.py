"""Variations of a study: lists and grids of values, and random values from distributions.

Each dotted key under `vary` has a list of values, or one of

    linear: [from, to, count]     evenly spaced
    log: [from, to, count]        with a constant ratio
    uniform: [low, high]          random
    loguniform: [low, high]       random, with uniform logarithm
    normal: [mean, deviation]     random
    integers: [low, high]         random, both ends included
    choice: [values]              random

Lists, linear and log form a grid. Values of the random keys are drawn `samples` times; each draw
gives a value for all random keys.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import scipy

from aras_visual_servo_base.names import suggest
from aras_visual_servo_base.settings import convert

from ..errors import StudyError

SOBOL_BLOCK = 1024  # number of points of a Sobol sequence that are computed together
# Part of the seed of randomly varied settings. Without it, these settings would be drawn with the
# same random numbers as the starts and the noise of the runs.
STREAM_KEY = 0x706F696E
MAX_VALUES = 1_000_000


@dataclass(frozen=True)
class VariationAxis:
    """Setting of a study with a list of values."""

    key: str
    values: tuple[Any, ...]


@dataclass(frozen=True)
class RandomVariation:
    """Setting of a study whose values are drawn from a distribution.

    key: dotted key of the experiment.
    value: function that converts a uniform random number from 0 to 1 into the value of the key.
    ends: extreme values of the distribution, which are checked before the first run.
    """

    key: str
    value: Callable[[float], Any]
    ends: tuple[Any, ...]


def parse_variation(key: str, value: Any) -> VariationAxis | RandomVariation:
    """Parse the value of a key under `vary`.

    Raises:
        StudyError: the value is wrong.
    """
    if isinstance(value, list | tuple):
        if not value:
            raise StudyError(f"vary.{key} is an empty list: give at least one value")
        return VariationAxis(key, tuple(value))
    if not (isinstance(value, Mapping) and len(value) == 1):
        raise StudyError(
            f"vary.{key} is {value!r}, must be a list of values, or numbers under one of the keys "
            f"{', '.join(_PARSERS)}; put a constant value under experiment"
        )
    kind, numbers = next(iter(value.items()))
    if kind not in _PARSERS:
        raise StudyError(
            f"vary.{key} has the unknown key '{kind}': {suggest(kind, _PARSERS)} (to vary the key "
            f"{kind} of {key}, write {key}.{kind})"
        )
    return _PARSERS[kind](key, kind, numbers)


def _parse_numbers(key: str, kind: str, value: Any, count: int) -> list[float]:
    return list(convert(value, tuple[(float,) * count], f"vary.{key}.{kind}", StudyError))


def _parse_range(
    key: str, kind: str, value: Any, lower_bound: float = -math.inf
) -> tuple[float, float]:
    low, high = _parse_numbers(key, kind, value, 2)
    if not lower_bound < low < high:
        floor = "" if lower_bound == -math.inf else f"{lower_bound:g} < "
        raise StudyError(f"vary.{key}.{kind} is [{low:g}, {high:g}], must be [low, high] with "
                         f"{floor}low < high")
    return low, high


def _parse_grid(key: str, kind: str, value: Any) -> VariationAxis:
    first, last, count = _parse_numbers(key, kind, value, 3)
    if not (count == int(count) and 2 <= count <= MAX_VALUES):
        raise StudyError(f"vary.{key}.{kind}: count is {count:g}, must be from 2 to {MAX_VALUES}")
    if kind == "log" and min(first, last) <= 0.0:
        raise StudyError(f"vary.{key}.log: both ends must be above 0")
    make = np.geomspace if kind == "log" else np.linspace
    return VariationAxis(key, tuple(make(first, last, int(count)).tolist()))


def _parse_uniform(key: str, kind: str, value: Any) -> RandomVariation:
    low, high = _parse_range(key, kind, value)
    return RandomVariation(key, lambda u: low + u * (high - low), (low, high))


def _parse_loguniform(key: str, kind: str, value: Any) -> RandomVariation:
    low, high = _parse_range(key, kind, value, 0.0)
    return RandomVariation(
        key, lambda u: math.exp(math.log(low) + u * math.log(high / low)), (low, high)
    )


def _parse_normal(key: str, kind: str, value: Any) -> RandomVariation:
    mean, deviation = _parse_numbers(key, kind, value, 2)
    if deviation <= 0.0:
        raise StudyError(f"vary.{key}.normal: the deviation is {deviation:g}, must be above 0")

    def convert(u: float) -> float:
        # The lower bound prevents -infinity, the quantile at 0. An upper bound is not needed,
        # because the random numbers are always below 1.
        return mean + deviation * float(scipy.special.ndtri(max(u, 1e-12)))

    return RandomVariation(key, convert, (mean,))


def _parse_integers(key: str, kind: str, value: Any) -> RandomVariation:
    low, high = _parse_range(key, kind, value)
    if low != int(low) or high != int(high):
        raise StudyError(f"vary.{key}.integers is {low:g} to {high:g}, must be whole numbers")
    first, count = int(low), int(high - low) + 1
    return RandomVariation(
        key, lambda u: first + min(int(u * count), count - 1), (int(low), int(high))
    )


def _parse_choice(key: str, kind: str, value: Any) -> RandomVariation:
    if not (isinstance(value, list | tuple) and value):
        raise StudyError(f"vary.{key}.choice is {value!r}, must be a list of values")
    values = tuple(value)
    return RandomVariation(
        key, lambda u: values[min(int(u * len(values)), len(values) - 1)], values
    )


_PARSERS: dict[str, Callable[[str, str, Any], VariationAxis | RandomVariation]] = {
    "linear": _parse_grid,
    "log": _parse_grid,
    "uniform": _parse_uniform,
    "loguniform": _parse_loguniform,
    "normal": _parse_normal,
    "integers": _parse_integers,
    "choice": _parse_choice,
}


def derive_seed(entropy: int, number: int) -> int:
    """Derive the seed of a run or a repeat.

    Args:
        entropy: seed of the study.
        number: number of the run or the repeat.
    """
    state = np.random.SeedSequence(entropy, spawn_key=(number,)).generate_state(1, np.uint64)
    # The seed has 63 bits. With 32 bits, two of 1e5 runs would probably have the same seed.
    return int(state[0] >> np.uint64(1))


def draw_values(
    variations: Sequence[RandomVariation], sampling: str, entropy: int, sample: int
) -> dict[str, Any]:
    """Draw the values of all random keys; the values are the same on every machine.

    Args:
        variations: random keys with their distributions.
        sampling: 'random' or 'sobol'.
        entropy: seed of the study.
        sample: number of the draw, which gives a value for all random keys.
    """
    if not variations:
        return {}
    if sampling == "sobol":
        unit = _make_sobol_points(len(variations), entropy, sample // SOBOL_BLOCK)[
            sample % SOBOL_BLOCK
        ]
    else:
        seeds = np.random.SeedSequence(entropy, spawn_key=(STREAM_KEY, sample))
        unit = np.random.default_rng(seeds).random(len(variations))
    return {draw.key: draw.value(u) for draw, u in zip(variations, unit.tolist(), strict=True)}


@lru_cache(maxsize=4)
def _make_sobol_points(dimensions: int, entropy: int, block: int) -> np.ndarray:
    """Compute a block of points (SOBOL_BLOCK, dimensions) of the scrambled Sobol sequence.

    Args:
        dimensions: number of coordinates of a point.
        entropy: seed of the study.
        block: number of the block.
    """
    seeds = np.random.SeedSequence(entropy, spawn_key=(STREAM_KEY,))
    sequence = scipy.stats.qmc.Sobol(dimensions, rng=np.random.default_rng(seeds))
    if block:
        sequence.fast_forward(block * SOBOL_BLOCK)
    return sequence.random(SOBOL_BLOCK)
