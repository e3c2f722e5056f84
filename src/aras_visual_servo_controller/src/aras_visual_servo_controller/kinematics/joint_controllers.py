"""Controllers of ros_control that take the joints' commands, found by joint and type."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..errors import ConfigurationError

KINDS = ("position", "velocity", "effort")
_TYPE = re.compile(r"^\w+_controllers/Joint(Group)?(Position|Velocity|Effort)Controller$")


@dataclass(frozen=True)
class RosController:
    """One controller of a robot's namespace.

    name: of its parameters. joints: that it moves, in the order of its commands. kind: of command
    that it takes: 'position', 'velocity' or 'effort'. group: whether it takes them as an array.
    """

    name: str
    joints: tuple[str, ...]
    kind: str
    is_group: bool


def find_joint_controllers(parameters: Mapping[str, Any]) -> Iterator[RosController]:
    """Those among the parameters of a robot's namespace, in their order.

    Args:
        parameters: by name, as the YAML of a robot's controllers holds them below its namespace;
            what is no controller of joints is passed over.
    """
    for name, settings in parameters.items():
        if not isinstance(settings, Mapping):
            continue
        kind = _TYPE.match(str(settings.get("type", "")))
        joints = settings.get("joints" if kind and kind[1] else "joint")
        if kind and joints:
            listed = tuple(joints) if kind[1] else (joints,)
            yield RosController(name, listed, kind[2].lower(), bool(kind[1]))


def choose_controllers(
    parameters: Mapping[str, Any],
    joints: Sequence[str],
    kind: str,
    controller_names: Mapping[str, str],
    namespace: str,
) -> list[RosController]:
    """What takes commands of this kind for each of the joints: one each, or one group for all.

    Where nothing is known of a controller, as on a robot whose parameters lie elsewhere, its name
    counts: the one in `controller_names` unless it speaks of another kind, or
        JOINT_KIND_controller.

    Args:
        parameters: of the robot's namespace.
        joints: that are commanded.
        kind: 'position', 'velocity' or 'effort'.
        named: names of controllers by joint; one that takes another kind is not taken.
        space: the namespace, for messages.

    Raises:
        ConfigurationError: a joint whose controllers all take commands of other kinds.
    """
    known = list(find_joint_controllers(parameters))
    found = []
    for joint in joints:
        name = controller_names.get(joint, "")
        if not name or kind not in name and any(other in name for other in KINDS):
            name = f"{joint}_{kind}_controller"
        single = [one for one in known if one.joints == (joint,) and not one.is_group]
        fit = sorted((one for one in single if one.kind == kind), key=lambda one: one.name != name)
        if fit:
            found.append(fit[0])
            continue
        group = next((one for one in known if one.is_group and one.kind == kind
                      and set(one.joints) == set(joints)), None)  # fmt: skip
        if group is not None:
            return [group]
        others = ", ".join(f"{one.name} takes {one.kind}" for one in single)
        if others:
            raise ConfigurationError(
                f"no controller in {namespace} takes {kind} commands for {joint} ({others}): load "
                "and "
                f"start one of type .../Joint{kind.capitalize()}Controller, or set ~output"
            )
        found.append(RosController(name, (joint,), kind, False))
    return found
