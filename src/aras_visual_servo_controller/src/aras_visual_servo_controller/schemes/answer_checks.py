"""The wall round a user's code: whatever it raises or answers becomes one line."""

from __future__ import annotations

import dataclasses
import traceback
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from aras_visual_servo_base.names import words

from ..arm.algebra import finite
from ..arm.task import Task
from ..errors import ConfigurationError, MeasurementError, SchemeError
from .base import Decision, JointController, Scheme

T = TypeVar("T")


def guarded(name: str, call: Callable[..., T], *arguments: object) -> T:
    """The call's answer.

    Raises:
        MeasurementError: as raised by the call: this image cannot be servoed on.
        SchemeError: whatever else it raised, SystemExit included.
    """
    try:
        return call(*arguments)
    except (MeasurementError, SchemeError, KeyboardInterrupt):
        raise
    except BaseException as error:
        raise SchemeError(
            f"scheme {name} raised {words(error)}", traceback.format_exc()
        ) from error


def checked_goal(name: str, scheme: Scheme | JointController, goal: object) -> None:
    """Let the scheme refuse its goal.

    Raises:
        ConfigurationError: it did, or it raised.
    """
    try:
        scheme.check(goal)
    except ConfigurationError:
        raise
    except (Exception, SystemExit) as error:
        raise ConfigurationError(
            f"scheme '{name}' cannot use {getattr(goal, 'name', 'the goal')}: {words(error)}"
        ) from error


def checked_decision(name: str, decision: object, scheme: Scheme | JointController) -> Decision:
    """The decision with arrays in float64, if it is one.

    Raises:
        SchemeError: what is wrong with it.
    """

    def fault(text: str) -> SchemeError:
        return SchemeError(f"scheme {name} {text}")

    if not isinstance(decision, Decision):
        raise fault(f"answered {type(decision).__name__} instead of a Decision")
    count = len(tuple(decision.names))
    arrays = {}
    for field in ("features", "desired", "error"):
        array = _array(getattr(decision, field))
        if array is None or array.shape != (count,):
            shape = "no numbers" if array is None else f"shape {array.shape}"
            raise fault(f"answered {field} of {shape} for {count} names")
        arrays[field] = array
    if not finite(*arrays.values()):
        for field, array in arrays.items():
            if not np.isfinite(array).all():
                raise fault(f"answered {field} that are not finite: {array.tolist()}")
    tolerances = _array(getattr(scheme, "tolerances", None))
    if tolerances is None or tolerances.shape != (count,) or not all(
        tolerance > 0.0 for tolerance in tolerances.tolist()
    ):
        raise fault(
            f"has tolerances {getattr(scheme, 'tolerances', None)}: {count} numbers above 0 are "
            "needed, one for each name"
        )
    own = _array(decision.rate)
    if own is None or own.shape not in ((), (count,)) or not np.isfinite(own).all():
        raise fault(f"answered the rate {decision.rate}: one finite number for each name")
    task = decision.task
    if isinstance(scheme, JointController):
        return dataclasses.replace(decision, task=None, **arrays)
    if not isinstance(task, Task):
        raise fault(f"answered the task {type(task).__name__} instead of a Task")
    if all(arrays[field] is getattr(decision, field) for field in arrays):
        return decision  # as most are
    return dataclasses.replace(decision, **arrays)


def checked_joints(name: str, answer: object, count: int) -> np.ndarray:
    """The joints (n,) that a controller answered, if they are some.

    Raises:
        SchemeError: wrong shape, or not finite.
    """
    array = _array(answer)
    if array is None or array.shape != (count,):
        shape = "no numbers" if array is None else f"shape {array.shape}"
        raise SchemeError(f"scheme {name} answered joints of {shape}, ({count},) is needed")
    if not np.isfinite(array).all():
        raise SchemeError(f"scheme {name} answered joints that are not finite")
    return array


def _array(values: object) -> np.ndarray | None:
    if values is None:
        return None
    try:
        return np.asarray(values, float)
    except (TypeError, ValueError):
        return None
