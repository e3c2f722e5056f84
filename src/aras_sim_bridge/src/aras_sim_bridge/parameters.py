"""Typed look-ups in the nested mappings that the ROS parameter server hands out.

Every function takes `where`, the full name of the mapping, so that a complaint names the
parameter as the user wrote it. `fault` is the exception class to raise.
"""

from collections.abc import Mapping
from math import isfinite

from aras_sim_bridge.errors import ControllerError, SimError

_MISSING = object()


def lookup(parameters: Mapping, path: str) -> object:
    """Value at 'a/b/c', or None where a step is missing or is no mapping."""
    node: object = parameters
    for key in path.strip("/").split("/"):
        if not isinstance(node, Mapping) or key not in node:
            return None
        node = node[key]
    return node


def section(
    parameters: Mapping, key: str, where: str, fault: type[SimError] = ControllerError
) -> Mapping:
    """The mapping under `key`; an absent one is empty.

    Raises `fault` if something other than a mapping stands there.
    """
    value = parameters.get(key)
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise fault(f"parameter {where}/{key} must hold named values, found {value!r}")
    return value


def number(
    parameters: Mapping,
    key: str,
    where: str,
    default: float | None = None,
    fault: type[SimError] = ControllerError,
) -> float:
    """A finite number as float; `default` if absent.

    Raises `fault` if it is missing without a default, no number, or not finite.
    """
    value = parameters.get(key, _MISSING)
    if value is _MISSING:
        if default is None:
            raise fault(f"parameter {where}/{key} is missing; set it to a number")
        return default
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise fault(f"parameter {where}/{key} must be a number, found {value!r}")
    value = float(value)
    if not isfinite(value):
        raise fault(f"parameter {where}/{key} must be finite, found {value}")
    return value


def flag(
    parameters: Mapping,
    key: str,
    where: str,
    default: bool | None = False,
    fault: type[SimError] = ControllerError,
) -> bool | None:
    """A true or false; `default` if absent. Raises `fault` on anything else."""
    value = parameters.get(key, _MISSING)
    if value is _MISSING:
        return default
    if not isinstance(value, bool):
        raise fault(f"parameter {where}/{key} must be true or false, found {value!r}")
    return value


def name(
    parameters: Mapping, key: str, where: str, fault: type[SimError] = ControllerError
) -> str:
    """A non-empty text. Raises `fault` if it is missing or no text."""
    value = parameters.get(key)
    if not isinstance(value, str) or not value:
        raise fault(f"parameter {where}/{key} is missing or no text, found {value!r}")
    return value


def names(
    parameters: Mapping, key: str, where: str, fault: type[SimError] = ControllerError
) -> tuple[str, ...]:
    """A non-empty list of different texts. Raises `fault` on anything else."""
    value = parameters.get(key)
    if (
        not isinstance(value, list | tuple)
        or not value
        or not all(isinstance(item, str) and item for item in value)
    ):
        raise fault(f"parameter {where}/{key} must be a non-empty list of names, found {value!r}")
    if len(set(value)) != len(value):
        raise fault(f"parameter {where}/{key} names a joint twice: {list(value)}")
    return tuple(value)
