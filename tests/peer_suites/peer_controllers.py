"""Controllers of upstream's controller_manager_tests, implemented by what the tests require."""

from __future__ import annotations

from collections.abc import Mapping

from aras_sim_bridge.control.controllers.base import ClaimedResources, Controller, ControllerContext
from aras_sim_bridge.control.hardware import RobotHardware
from aras_sim_bridge.errors import ControllerError

PREFIX = "hardware_interface::"


class MultiInterface(Controller):
    """Controller that claims the joints in its parameters, each list with a separate interface.

    asked: parameter of the joints by interface. optional: interfaces that may have no joint at all.
    """

    asked: Mapping[str, str] = {}
    defaults: Mapping[str, tuple[str, ...]] = {}
    optional = False

    def init(
        self, hardware: RobotHardware, parameters: Mapping, context: ControllerContext
    ) -> None:
        """Claim the joints; ControllerError if the interface or a joint is missing."""
        super().init(hardware, parameters, context)
        self._claims: list[ClaimedResources] = []
        for interface, parameter in self.asked.items():
            known = hardware.interfaces.get(interface, set())
            if not known and self.optional:
                continue
            joints = parameters.get(parameter, self.defaults.get(parameter))
            joints = (joints,) if isinstance(joints, str) else tuple(joints or ())
            missing = [joint for joint in joints if joint not in known]
            if missing or not joints:
                raise ControllerError(f"{context.name}: the {interface} lacks {missing}")
            self._claims.append(ClaimedResources(f"{PREFIX}{interface}", joints))

    @property
    def claimed_resources(self) -> tuple[ClaimedResources, ...]:
        """Return the resources that init has claimed."""
        return tuple(self._claims)


class EffortTestController(MultiInterface):
    """Controller of the efforts of `joints`, by default the first two."""

    asked = {"EffortJointInterface": "joints"}
    defaults = {"joints": ("hiDOF_joint1", "hiDOF_joint2")}


class MyDummyController(MultiInterface):
    """Controller with an interface that no robot has."""

    asked = {"MyDummyInterface": "joints"}


class VelEffController(MultiInterface):
    """Controller of the velocities of some joints and the efforts of others."""

    asked = {"VelocityJointInterface": "velocity_joints", "EffortJointInterface": "effort_joints"}


class PosEffController(MultiInterface):
    """Controller of the positions of some joints and the efforts of others."""

    asked = {"PositionJointInterface": "position_joints", "EffortJointInterface": "effort_joints"}


class PosEffOptController(PosEffController):
    """Controller like PosEffController that leaves out interfaces that the robot lacks."""

    optional = True


class ExtensibleController(MultiInterface):
    """Controller of the velocity of one joint."""

    asked = {"VelocityJointInterface": "velocity_joint"}


class DerivedController(ExtensibleController):
    """Controller of the velocity of one joint and the effort of another."""

    asked = {"VelocityJointInterface": "velocity_joint", "EffortJointInterface": "effort_joint"}
