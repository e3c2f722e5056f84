"""The wall round a user's code: whatever it raises or answers becomes one line."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, TypeVar

import numpy as np

from aras_visual_servo_base.names import words

from ..errors import ConfigurationError, SchemeError
from ..features.base import Feature, Measured
from .base import JointController, Scheme
from .time_limit import call_user_code

T = TypeVar("T")


def checked_goal(
    name: str, scheme: Scheme | JointController, goal: object, limit: float
) -> None:
    """Let the scheme refuse its goal, within `limit`, s.

    Raises:
        ConfigurationError: it did, or it raised, or took longer.
    """
    try:
        call_user_code(scheme.check, goal, limit=limit)
    except ConfigurationError:
        raise
    except (Exception, SystemExit) as error:
        raise ConfigurationError(
            f"scheme '{name}' cannot use {getattr(goal, 'name', 'the goal')}: {words(error)}"
        ) from error


def checked_measured(feature: Feature, found: object) -> Measured:
    """What a feature measured, with arrays in float64: lists, tuples, scalars and columns as well.

    Raises:
        SchemeError: naming the class, what it returned and what is needed.
    """
    where = f"{type(feature).__name__}.measure returned"
    if not isinstance(found, Measured):
        if not all(hasattr(found, field) for field in ("s", "desired", "error", "L")):
            raise SchemeError(f"{where} {_described(found)}: a Measured is needed")
        fields = (field.name for field in dataclasses.fields(Measured))
        found = Measured(**{name: getattr(found, name) for name in fields if hasattr(found, name)})
    names, judged = len(tuple(feature.names)), found.judged
    count = names if judged is None else np.size(found.error)
    arrays = {
        field: _shaped(where, field, getattr(found, field), (count,))
        for field in ("s", "desired", "error")
    }
    arrays["L"] = _shaped(where, "L", found.L, (count, 6))
    if np.ndim(found.rate) or not isinstance(found.rate, float):
        shape = () if np.ndim(found.rate) == 0 else (count,)
        arrays["rate"] = _shaped(where, "rate", found.rate, shape)
    if judged is not None:
        arrays["judged"] = _shaped(where, "judged", judged, (names,))
    if isinstance(found.notes, str):
        arrays["notes"] = (found.notes,)
    if not isinstance(found.up_to, str):
        raise SchemeError(f"{where} up_to {_described(found.up_to)}: a text is needed")
    if all(value is getattr(found, field) for field, value in arrays.items()):
        return found  # as most are
    return dataclasses.replace(found, **arrays)


def checked_array(
    owner: object, method: str, answer: object, shape: tuple[int, ...]
) -> np.ndarray:
    """The array of this shape that a method of a feature or a law returned.

    Raises:
        SchemeError: naming the class, the method, what it returned and what is needed.
    """
    return _shaped(f"{type(owner).__name__}.{method} returned", "", answer, shape)


def checked_accuracy(feature: Feature, answer: object, count: int) -> np.ndarray | float | None:
    """Feature.accuracy of `count` numbers; (count,) are their standard deviations.

    Raises:
        SchemeError: naming the class, what it returned and what is needed.
    """
    if answer is None:
        return None
    values, where = as_numbers(answer), f"{type(feature).__name__}.accuracy returned"
    if values is None or values.ndim > 2 or values.ndim and len(values) != count:
        raise SchemeError(
            f"{where} {_described(answer)}: None, one number, ({count},) or ({count}, m) is needed"
        )
    if not np.isfinite(values).all():
        raise SchemeError(f"{where} {_described(answer)}: it must be finite")
    if values.ndim == 1:
        return np.diag(values)
    return abs(float(values)) if values.ndim == 0 else values


def checked_entry(feature: Feature, entry: object) -> Mapping[str, Any]:
    """What a feature teaches.

    Raises:
        ConfigurationError: it is no mapping.
    """
    if isinstance(entry, Mapping):
        return entry
    raise ConfigurationError(
        f"{type(feature).__name__}.teach returned {_described(entry)}: a mapping of names to "
        "numbers, lists or texts is needed"
    )


def _shaped(where: str, field: str, value: object, shape: tuple[int, ...]) -> np.ndarray:
    """The finite numbers of this shape, also without its lengths of 1; SchemeError."""
    array, field = as_numbers(value), f"{field} " if field else ""
    needed = f"{shape} finite numbers are needed" if shape else "a finite number is needed"
    if array is not None and array.shape != shape and (
        tuple(n for n in array.shape if n != 1) == tuple(n for n in shape if n != 1)
    ):
        array = array.reshape(shape)
    if array is None or array.shape != shape:
        raise SchemeError(f"{where} {field}{_described(value)}: {needed}")
    if not np.isfinite(array).all():
        raise SchemeError(f"{where} {field}that is not finite, {_described(value)}: {needed}")
    return array


def _described(value: object) -> str:
    """A value for a message: short ones as they are."""
    text = " ".join(repr(value).split())
    shape = f" of shape {value.shape}" if isinstance(value, np.ndarray) else ""
    return f"{type(value).__name__}{shape} {text if len(text) <= 60 else text[:57] + '...'}"


def checked_joints(name: str, answer: object, count: int) -> np.ndarray:
    """The joints (n,) that a controller answered, if they are some.

    Raises:
        SchemeError: wrong shape, or not finite.
    """
    array = as_numbers(answer)
    if array is None or array.shape != (count,):
        shape = "no numbers" if array is None else f"shape {array.shape}"
        raise SchemeError(f"scheme {name} answered joints of {shape}, ({count},) is needed")
    if not np.isfinite(array).all():
        raise SchemeError(f"scheme {name} answered joints that are not finite")
    return array


def as_numbers(values: object) -> np.ndarray | None:
    """The values as an array of float64; None: they are no numbers."""
    if values is None:
        return None
    if type(values) is np.ndarray and values.dtype == float:
        return values
    try:
        array = np.asarray(values)
        return array.astype(float) if array.dtype.kind in "fiu" else None
    except (TypeError, ValueError):
        return None
