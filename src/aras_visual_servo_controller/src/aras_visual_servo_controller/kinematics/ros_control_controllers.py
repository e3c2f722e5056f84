"""Selection of the ros_control controllers that receive the joint commands."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..errors import ConfigurationError

KINDS = ("position", "velocity", "effort")
_TYPE = re.compile(r"^\w+_controllers/Joint(Group)?(Position|Velocity|Effort)Controller$")


@dataclass(frozen=True)
class RosControlController:
    """A joint controller of ros_control.

    name: name of the controller.
    joints: joints that the controller moves, in the order of its commands.
    kind: command type: 'position', 'velocity' or 'effort'.
    is_group: whether a command is an array of all joints.
    """

    name: str
    joints: tuple[str, ...]
    kind: str
    is_group: bool


def find_joint_controllers(parameters: Mapping[str, Any]) -> Iterator[RosControlController]:
    """Iterate over the joint controllers in the parameters of a robot's namespace.

    Args:
        parameters: parameters by name, as in the YAML file of the controllers. Entries that are
            not joint controllers are skipped.
    """
    for name, settings in parameters.items():
        if not isinstance(settings, Mapping):
            continue
        kind = _TYPE.match(str(settings.get("type", "")))
        joints = settings.get("joints" if kind and kind[1] else "joint")
        if kind and joints:
            listed = tuple(joints) if kind[1] else (joints,)
            yield RosControlController(name, listed, kind[2].lower(), bool(kind[1]))


def choose_controllers(
    parameters: Mapping[str, Any],
    joints: Sequence[str],
    kind: str,
    controller_names: Mapping[str, str],
    namespace: str,
) -> list[RosControlController]:
    """Choose the controllers for commands of one type: one for each joint, or one for all.

    If the parameters contain no controller of a joint, the name in `controller_names` is used. If
    that has no name for the joint, or a name with another command type, the name is made of joint
    and command type, such as J1_position_controller.

    Args:
        parameters: parameters of the robot's namespace.
        joints: joints to command.
        kind: command type: 'position', 'velocity' or 'effort'.
        controller_names: names of controllers by joint; a controller of another type is ignored.
        namespace: namespace, for messages.

    Raises:
        ConfigurationError: all controllers of a joint accept commands of other types.
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
                f"and start one of type .../Joint{kind.capitalize()}Controller, or set ~output"
            )
        found.append(RosControlController(name, (joint,), kind, False))
    return found
