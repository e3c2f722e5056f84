"""Call of a scheme for one image, with checks of its output."""

from __future__ import annotations

import dataclasses
import math
from math import inf
from operator import is_

import numpy as np

from ..errors import SchemeError
from ..goals.goal import Goal
from ..kinematics.algebra import are_finite
from ..kinematics.task import Task
from ..observation.observation import Observation
from .base import JointController, Scheme, SchemeOutput
from .output_checks import to_float_array
from .time_limit import call_user_code

# fields of SchemeOutput with one number for each name
COMPONENT_FIELDS = ("features", "desired", "error")


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
    is_controller = isinstance(scheme, JointController)
    answer = scheme.process_image if is_controller else scheme.compute
    output = call_user_code(answer, observation, goal, t, limit=limit, scheme=name)
    if not isinstance(output, SchemeOutput):
        raise SchemeError(
            f"scheme {name} returned {type(output).__name__} instead of a SchemeOutput"
        )
    count = len(tuple(output.names))
    given = output.features, output.desired, output.error
    arrays = [to_float_array(values) for values in given]
    for field, array in zip(COMPONENT_FIELDS, arrays, strict=True):
        if array is None or array.shape != (count,):
            shape = "no numbers" if array is None else f"shape {array.shape}"
            raise SchemeError(
                f"scheme {name} returned {field} of {shape}, must return one number for each of "
                f"the {count} names"
            )
    if not are_finite(*arrays):
        for field, array in zip(COMPONENT_FIELDS, arrays, strict=True):
            if not np.isfinite(array).all():
                raise SchemeError(
                    f"scheme {name} returned {field} that are not finite: {array.tolist()}"
                )
    tolerances = to_float_array(getattr(scheme, "tolerances", None))
    if tolerances is None or tolerances.shape != (count,) or not all((tolerances > 0.0).tolist()):
        raise SchemeError(
            f"scheme {name} has tolerances {getattr(scheme, 'tolerances', None)}, must have "
            f"{count} numbers above 0, one for each name"
        )
    if type(output.error_drift) is not float or not math.isfinite(output.error_drift):
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
    if not is_controller and L is output.L and all(map(is_, arrays, given)):
        return output  # the usual case: all arrays were valid and need no conversion
    features, desired, error = arrays
    task = None if is_controller else output.task
    return dataclasses.replace(
        output, features=features, desired=desired, error=error, L=L, task=task
    )
