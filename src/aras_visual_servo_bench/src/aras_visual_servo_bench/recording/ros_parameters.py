"""Access to the parameters of a ROS parameter server, as nested mappings."""

from __future__ import annotations

from collections.abc import Mapping


def find_branch(parameters: Mapping[str, object], name: str) -> dict[str, object]:
    """Return the parameters below a name; {} if there are none."""
    found: object = parameters
    for part in filter(None, name.split("/")):
        found = found.get(part, {}) if isinstance(found, Mapping) else {}
    return dict(found) if isinstance(found, Mapping) else {}
