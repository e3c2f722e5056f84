"""Functions that read the parameter server, and the exception for invalid parameters."""

from __future__ import annotations

import rosgraph
import rospy

Value = float | int | bool | str | tuple[str, ...]


class InvalidParameterError(ValueError):
    """A parameter is unknown, of the wrong type or out of range."""


def get_parameter(name: str) -> object:
    """Return the value of a parameter or namespace from the parameter server, or {} if unset.

    The value is read from the server and not from rospy's cache, because the cache of the namespace
    `/` contains only those parameters that the node has already read.
    """
    try:
        return rosgraph.Master(rospy.get_name()).getParam(rospy.resolve_name(name))
    except rosgraph.MasterError:
        return {}


def get_namespace(name: str) -> dict[str, object]:
    """Return the parameters in a namespace, or {} if the name belongs to a single parameter."""
    values = get_parameter(name)
    return values if isinstance(values, dict) else {}
