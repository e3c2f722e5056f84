"""The parameter server: what it holds, and the fault of what cannot be used."""

from __future__ import annotations

import rosgraph
import rospy

Value = float | int | bool | str | tuple[str, ...]


class InvalidParameterError(ValueError):
    """A parameter is unknown, of the wrong type or out of range."""


def get_parameter(name: str) -> object:
    """Return what the parameter server holds under a name; {} where there is nothing.

    It is asked itself: rospy keeps a copy of some of it, which it takes for the whole of `/`.
    """
    try:
        return rosgraph.Master(rospy.get_name()).getParam(rospy.resolve_name(name))
    except rosgraph.MasterError:
        return {}


def get_namespace(name: str) -> dict[str, object]:
    """Return the parameters below a name; none where it is a single one."""
    values = get_parameter(name)
    return values if isinstance(values, dict) else {}
