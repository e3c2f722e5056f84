"""Call of a scheme, and checks of the values that user-defined schemes and features return."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from math import inf, isfinite
from typing import Any, TypeVar

import numpy as np

from aras_visual_servo_base.names import format_error

from ..errors import ConfigurationError, SchemeError
from ..features.base import Feature, FeatureMeasurement
from ..goals.goal import Goal
from ..kinematics.algebra import is_finite
from ..kinematics.task import Task
from ..observation.observation import Observation
from .base import JointController, Scheme, SchemeOutput
from .time_limit import call_user_code

T = TypeVar("T")

# fields of SchemeOutput with one number for each name
COMPONENT_FIELDS = ("features", "desired", "error")
FLOAT = np.dtype(float)


def compute(
    scheme: Scheme | JointController,
    observation: Observation,
    goal: Goal,
    t: float = 0.0,
    name: str = "",
    limit: float = inf,
) -> SchemeOutput:
    """Compute s, s*, the error e = s - s*, L and the task L v = e_dot of one image.

    Args:
        scheme: scheme or joint controller.
        observation: measurements of the image.
        goal: goal with its desired features.
        t: time since servoing started, s.
        name: name of the scheme, for messages.
        limit: wall time that the scheme may take, s.

    Returns:
        The output for k features, with float64 arrays. Its task contains L (k, 6) and the desired
        rate (k,) of the error; the task of a joint controller is None.

    Raises:
        MeasurementError: this image cannot be used for control.
        SchemeError: the scheme raised another exception, or its output is not valid.
        UnresponsiveSchemeError: the scheme took longer than `limit`.
    """
    name = name or type(scheme).__name__
    # `isinstance` would call a Python function, because JointController is an abstract base class
    is_controller = JointController in type(scheme).__mro__
    answer = scheme.process_image if is_controller else scheme.compute
    output = call_user_code(answer, observation, goal, t, limit=limit, scheme=name)
    if not isinstance(output, SchemeOutput):
        raise SchemeError(
            f"scheme {name} returned {type(output).__name__} instead of a SchemeOutput"
        )
    count = len(tuple(output.names))
    given = output.features, output.desired, output.error
    is_usual = _are_finite_vectors(*given, count)
    arrays = given if is_usual else _read_components(name, given, count)
    tolerances = to_float_array(getattr(scheme, "tolerances", None))
    if tolerances is None or tolerances.shape != (count,) or not all((tolerances > 0.0).tolist()):
        raise SchemeError(
            f"scheme {name} has tolerances {getattr(scheme, 'tolerances', None)}, must have "
            f"{count} numbers above 0, one for each name"
        )
    if type(output.error_drift) is not float or not isfinite(output.error_drift):
        rate = to_float_array(output.error_drift)
        if rate is None or rate.shape not in ((), (count,)) or not np.isfinite(rate).all():
            raise SchemeError(
                f"scheme {name} returned the error_drift {output.error_drift}, must return one "
                "finite number for each name"
            )
    if not (is_controller or isinstance(output.task, Task)):
        raise SchemeError(
            f"scheme {name} returned the task {type(output.task).__name__} instead of a Task"
        )
    L = output.L if type(output.L) is np.ndarray else to_float_array(output.L)
    if not is_controller and L is output.L and arrays is given:
        return output  # the usual case: all arrays were valid and need no conversion
    features, desired, error = arrays
    task = None if is_controller else output.task
    return dataclasses.replace(
        output, features=features, desired=desired, error=error, L=L, task=task
    )


def _read_components(
    name: str, given: tuple[object, ...], count: int
) -> tuple[np.ndarray, ...]:
    """Convert the features, desired features and error that a scheme returned to arrays (count,).

    Raises:
        SchemeError: an array has a wrong shape, or is not finite.
    """
    arrays = tuple(to_float_array(values) for values in given)
    for field, array in zip(COMPONENT_FIELDS, arrays, strict=True):
        if array is None or array.shape != (count,):
            shape = "no numbers" if array is None else f"shape {array.shape}"
            raise SchemeError(
                f"scheme {name} returned {field} of {shape}, must return one number for each of "
                f"the {count} names"
            )
    for field, array in zip(COMPONENT_FIELDS, arrays, strict=True):
        if not np.isfinite(array).all():
            raise SchemeError(
                f"scheme {name} returned {field} that are not finite: {array.tolist()}"
            )
    return arrays


def check_goal(
    name: str, scheme: Scheme | JointController, goal: object, limit: float
) -> None:
    """Call the scheme's own check of the goal, for at most `limit` s of wall time.

    Raises:
        ConfigurationError: the scheme does not accept the goal, raised another exception, or timed
            out.
    """
    try:
        call_user_code(scheme.check, goal, limit=limit)
    except ConfigurationError:
        raise
    except (Exception, SystemExit) as error:
        raise ConfigurationError(
            f"scheme '{name}' cannot use {getattr(goal, 'name', 'the goal')}: {format_error(error)}"
        ) from error


def check_measurement(feature: Feature, measurement: object) -> FeatureMeasurement:
    """Return the measurement of a feature with float64 arrays.

    Lists, tuples, scalars and column vectors are converted.

    Raises:
        SchemeError: the measurement is not valid; the message names the class, the value that it
            returned and what is needed.
    """
    names = len(tuple(feature.names))
    if (
        type(measurement) is FeatureMeasurement and measurement.error_summary is None
        and type(measurement.error_drift) is float and isfinite(measurement.error_drift)
        and type(measurement.notes) is tuple and type(measurement.ambiguity) is str
    ):  # fmt: skip
        L = measurement.L
        if (
            _are_finite_vectors(measurement.s, measurement.desired, measurement.error, names)
            and type(L) is np.ndarray and L.dtype is FLOAT and L.shape == (names, 6)
            and is_finite(L.ravel())
        ):  # fmt: skip
            return measurement  # the usual case: all arrays are valid and need no conversion
    where = f"{type(feature).__name__}.measure returned"
    if not isinstance(measurement, FeatureMeasurement):
        if not all(hasattr(measurement, field) for field in ("s", "desired", "error", "L")):
            raise SchemeError(f"{where} {_describe(measurement)}, must return a FeatureMeasurement")
        fields = (field.name for field in dataclasses.fields(FeatureMeasurement))
        measurement = FeatureMeasurement(
            **{name: getattr(measurement, name) for name in fields if hasattr(measurement, name)}
        )
    summary = measurement.error_summary
    count = names if summary is None else np.size(measurement.error)
    arrays = {
        field: _read_shaped(where, field, getattr(measurement, field), (count,))
        for field in ("s", "desired", "error")
    }
    arrays["L"] = _read_shaped(where, "L", measurement.L, (count, 6))
    if np.ndim(measurement.error_drift) or not isinstance(measurement.error_drift, float):
        shape = () if np.ndim(measurement.error_drift) == 0 else (count,)
        arrays["error_drift"] = _read_shaped(where, "error_drift", measurement.error_drift, shape)
    if summary is not None:
        arrays["error_summary"] = _read_shaped(where, "error_summary", summary, (names,))
    if isinstance(measurement.notes, str):
        arrays["notes"] = (measurement.notes,)
    if not isinstance(measurement.ambiguity, str):
        raise SchemeError(f"{where} ambiguity {_describe(measurement.ambiguity)}, must return a "
                          "text")
    return dataclasses.replace(measurement, **arrays)


def _are_finite_vectors(a: object, b: object, c: object, count: int) -> bool:
    """Return whether three values are float64 arrays (count,) of finite numbers."""
    return (
        type(a) is type(b) is type(c) is np.ndarray and a.dtype is b.dtype is c.dtype is FLOAT
        and a.shape == b.shape == c.shape == (count,)
        and is_finite(a) and is_finite(b) and is_finite(c)
    )  # fmt: skip


def check_array(
    owner: object, method: str, value: object, shape: tuple[int, ...]
) -> np.ndarray:
    """Return the value that a method of a feature or law returned, as an array of this shape.

    Raises:
        SchemeError: the value is not valid; the message names the class, the method, the value and
            what is needed.
    """
    if (
        type(value) is np.ndarray and value.dtype is FLOAT and value.shape == shape
        and is_finite(value.ravel())
    ):  # fmt: skip
        return value  # the usual case: the value is valid and needs no conversion
    return _read_shaped(f"{type(owner).__name__}.{method} returned", "", value, shape)


def check_accuracy(feature: Feature, accuracy: object, count: int) -> np.ndarray | float | None:
    """Return the value of Feature.accuracy for `count` components, or None.

    An array (count,) contains the standard deviations of independent components. It is returned as
    a diagonal matrix, the general form (count, m) of an accuracy.

    Raises:
        SchemeError: the value is not valid; the message names the class, the value and what is
            needed.
    """
    if accuracy is None:
        return None
    values, where = to_float_array(accuracy), f"{type(feature).__name__}.accuracy returned"
    if values is None or values.ndim > 2 or values.ndim and len(values) != count:
        raise SchemeError(
            f"{where} {_describe(accuracy)}, must return None, one number, or an array of shape "
            f"({count},) or ({count}, m)"
        )
    if not is_finite(values.ravel()):
        raise SchemeError(f"{where} {_describe(accuracy)}, must return finite numbers")
    if values.ndim == 1:
        return np.diag(values)
    return abs(float(values)) if values.ndim == 0 else values


def check_taught_entry(feature: Feature, entry: object) -> Mapping[str, Any]:
    """Return the entry that a feature teaches for the goal file.

    Raises:
        ConfigurationError: the entry is not a mapping.
    """
    if isinstance(entry, Mapping):
        return entry
    raise ConfigurationError(
        f"{type(feature).__name__}.teach returned {_describe(entry)}, must return a mapping of "
        "names to numbers, lists or texts"
    )


def _read_shaped(where: str, field: str, value: object, shape: tuple[int, ...]) -> np.ndarray:
    """Return the value as a finite array of this shape; axes of length 1 are ignored.

    Raises:
        SchemeError: the value is not valid.
    """
    array, field = to_float_array(value), f"{field} " if field else ""
    if array is not None and array.shape == shape and np.isfinite(array).all():
        return array
    needed = f"finite numbers of shape {shape}" if shape else "a finite number"
    if array is not None and array.shape != shape and (
        tuple(n for n in array.shape if n != 1) == tuple(n for n in shape if n != 1)
    ):
        array = array.reshape(shape)
    if array is None or array.shape != shape:
        raise SchemeError(f"{where} {field}{_describe(value)}, must return {needed}")
    if not np.isfinite(array).all():
        raise SchemeError(f"{where} {field}that is not finite, {_describe(value)}; return "
                          f"{needed}")
    return array


def _describe(value: object) -> str:
    """Describe a value for a message; long values are truncated."""
    text = " ".join(repr(value).split())
    shape = f" of shape {value.shape}" if isinstance(value, np.ndarray) else ""
    return f"{type(value).__name__}{shape} {text if len(text) <= 60 else text[:57] + '...'}"


def check_joint_output(name: str, output: object, count: int) -> np.ndarray:
    """Return the array (n,) that `JointController.update` returned, checked and as float64.

    Raises:
        SchemeError: the array has a wrong shape, or is not finite.
    """
    array = to_float_array(output)
    if array is None or array.shape != (count,):
        shape = "no numbers" if array is None else f"shape {array.shape}"
        raise SchemeError(f"scheme {name} returned joints of {shape}, must return shape ({count},)")
    if not np.isfinite(array).all():
        raise SchemeError(f"scheme {name} returned joints that are not finite")
    return array


def to_float_array(values: object) -> np.ndarray | None:
    """Return the values as a float64 array; None if they are not numbers."""
    if values is None:
        return None
    if type(values) is np.ndarray and values.dtype == float:
        return values
    try:
        array = np.asarray(values)
        return array.astype(float) if array.dtype.kind in "fiu" else None
    except (TypeError, ValueError):
        return None

