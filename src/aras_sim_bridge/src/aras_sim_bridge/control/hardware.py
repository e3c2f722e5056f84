"""Hardware interface between the controllers and the simulated joints.

`RobotHardware.read` copies positions, velocities and efforts into the handles; `write` limits the
commands and applies them. The order of these steps, the limits and the emergency stop are the same
as in gazebo_ros_control.
"""

import logging
from collections.abc import Iterable, Mapping

import numpy as np

from aras_sim_bridge.control.drives import (
    DRIVE_COLUMNS,
    JOINT,
    SETS_POSITION,
    Drive,
    SimulatedRobot,
    compute_outputs,
)
from aras_sim_bridge.control.joints import (
    COMMAND_INTERFACES,
    EFFORT,
    HANDLE_COLUMNS,
    STATE,
    TAU,
    JointBounds,
    JointHandle,
    resolve_limits,
)
from aras_sim_bridge.control.pid import Pid
from aras_sim_bridge.description.types import RobotDescription, Transmission
from aras_sim_bridge.errors import ControllerError, HardwareError
from aras_visual_servo_base.setting_values import find_value
from aras_visual_servo_base.settings import read

_PREFIX = "hardware_interface/"
_GAINS = "gazebo_ros_control/pid_gains"
_HARD_VELOCITY_LIMITS = "hard_velocity_limits"
log = logging.getLogger(__name__)


class RobotHardware:
    """Joint handles, limits and drives of one robot.

    Attributes:
        handles: handles of all joints with a valid transmission, in the order of transmissions.
        interfaces: names of the joints in each of the four ros_control interfaces.
        limits: limits of each joint, from URDF and parameters.
        pids: PIDs of position and velocity joints, by joint name, with the gains of
            <namespace>/gazebo_ros_control/pid_gains/<joint>.
        drives: drives in the order of `handles`.
        handle_rows: (m, 6) states of the m handles, one row each.
        drive_rows: (m, 49) states of the m drives, one row each.
        has_position_drives: whether a drive sets the position of its joint directly.
        e_stop: whether the emergency stop is active; may be set from any thread.

    Raises:
        HardwareError: a transmission names an unknown interface or a joint that the model does not
            have, two transmissions have the same joint, or limits or gains are invalid.
    """

    def __init__(
        self,
        description: RobotDescription,
        model: SimulatedRobot,
        parameters: Mapping | None = None,
        namespace: str = "",
    ) -> None:
        self.description = description
        self.model = model
        self.e_stop = False
        self.handles: dict[str, JointHandle] = {}
        self.limits: dict[str, JointBounds | None] = {}
        self.interfaces: dict[str, set[str]] = {n: set() for n in (*COMMAND_INTERFACES, STATE)}
        self.pids: dict[str, Pid] = {}
        self._namespace = namespace.rstrip("/")
        self._parameters = parameters or {}
        self.drives: list[Drive] = []
        count = len(description.transmissions)
        self.handle_rows = np.zeros((count, HANDLE_COLUMNS))
        self.drive_rows = np.zeros((count, DRIVE_COLUMNS))
        interfaces = [(t, _find_interface(t)) for t in description.transmissions]
        for transmission, interface in interfaces:
            if interface:
                self._add(transmission, interface)
        unprefixed = [t.joint for t, name in interfaces if name and not name.startswith(_PREFIX)]
        if unprefixed:
            log.warning(
                f"transmissions of {', '.join(unprefixed)}: <hardwareInterface> without "
                f"'{_PREFIX}' is deprecated; add this prefix"
            )
        where = f"{self._namespace}/gazebo_ros_control"
        plugin_parameters = read(
            self._parameters, "gazebo_ros_control", Mapping, self._namespace, HardwareError, {}
        )
        if read(plugin_parameters, _HARD_VELOCITY_LIMITS, bool, where, HardwareError, False):
            for name, limits in self.limits.items():
                if limits is not None and limits.max_velocity is not None:
                    model.bound_speed(name, limits.max_velocity)
        self.handle_rows = self.handle_rows[: len(self.handles)]
        self.drive_rows = self.drive_rows[: len(self.handles)]
        self._read = self.drive_rows[:, JOINT].astype(int)
        self.has_position_drives = any(drive.kind == SETS_POSITION for drive in self.drives)
        self.start()

    def _add(self, transmission: Transmission, interface: str) -> None:
        """Register the joint of a transmission with its command interface."""
        label, name = f"transmission '{transmission.name}'", transmission.joint
        short = interface.removeprefix(_PREFIX)
        if short not in COMMAND_INTERFACES:
            raise HardwareError(
                f"{label}: unknown hardware interface '{interface}' for joint '{name}'; "
                f"known are {', '.join(_PREFIX + n for n in COMMAND_INTERFACES)}"
            )
        joint = self.description.joints.get(name)
        if joint is None or name not in self.model.joint_names:
            remedy = "correct the name"
            if joint is not None:
                remedy += ", or make the joint movable and give mass to the links that it moves"
            raise HardwareError(
                f"{label}: joint '{name}' is not a movable joint of the simulated model; "
                f"the model has {', '.join(self.model.joint_names) or 'none'}; {remedy}"
            )
        if name in self.handles:
            raise HardwareError(
                f"{label}: joint '{name}' already has a transmission; remove one of the two"
            )
        row = self.handle_rows[len(self.handles)]
        handle = JointHandle(name, joint.kind, joint.limits, joint.soft_limits, short, row)
        overrides = find_value(self._parameters, f"joint_limits/{name}")
        where = f"{self._namespace}/joint_limits/{name}"
        limits = resolve_limits(joint, overrides or {}, where)
        self.handles[name] = handle
        self.limits[name] = limits
        self.interfaces[short].add(name)
        self.interfaces[STATE].add(name)
        pid = None if short == EFFORT else self._make_pid(name)
        row, index = self.drive_rows[len(self.drives)], self.model.joint_names.index(name)
        self.drives.append(Drive(row, handle, limits, index, pid))

    def _make_pid(self, joint: str) -> Pid | None:
        where = f"{self._namespace}/{_GAINS}/{joint}"
        gains = find_value(self._parameters, f"{_GAINS}/{joint}")
        if gains is None:
            return None
        if not isinstance(gains, Mapping) or "p" not in gains:
            log.warning(f"{where} has no p: joint '{joint}' is driven without PID; set p")
            return None
        try:
            pid = Pid.from_parameters(gains, where)
        except ControllerError as error:
            raise HardwareError(str(error)) from error
        self.pids[joint] = pid
        return pid

    def read(self) -> None:
        """Copy the model's joint states into the handles; angles are not wrapped to one turn."""
        measured = np.array(self.model.read_joints())
        self.handle_rows[:, : TAU + 1] = measured[:, self._read].T

    def write(self, time_ns: int, period: float) -> None:
        """Limit the commands and apply them; `period` is the time since the last write, in s."""
        for pid in self.pids.values():
            pid.apply_gains()
        news = compute_outputs(self.drive_rows, self.handle_rows, time_ns, period, self.e_stop)
        self.apply(time_ns)
        for pid in self.pids.values():
            pid.notify_listener(period)
        if news:
            self.log_warnings()

    def apply(self, time_ns: int) -> None:
        """Apply the drives' outputs to the model."""
        for drive in self.drives:
            drive.apply(self.model, time_ns)

    def log_warnings(self) -> None:
        """Log the warnings of all drives."""
        for drive in self.drives:
            drive.log_warnings()

    def start(self) -> None:
        """Reset the drives; the joints hold their positions until they receive a command."""
        self.read()
        for drive in self.drives:
            drive.start()

    def hold_positions(self, joints: Iterable[str]) -> None:
        """Command joints that were moved directly to hold their current positions.

        Joints without a transmission are ignored.
        """
        self.read()
        for drive in self.drives:
            if drive.handle.name in joints:
                drive.start()


def _find_interface(transmission: Transmission) -> str:
    """Return the command interface of a transmission; '' if the transmission is skipped.

    A warning is logged for a transmission that is skipped or has several command interfaces.
    """
    label, interface = f"transmission '{transmission.name}'", transmission.interface
    commanded = [i for i in transmission.interfaces if i.removeprefix(_PREFIX) != STATE]
    if interface.removeprefix(_PREFIX) == STATE:
        if not commanded:
            log.warning(f"{label} is skipped: {interface} takes no commands; add a command "
                        "interface")
            return ""
        interface = commanded[0]
    if not (transmission.type and transmission.joint and interface and transmission.has_actuator):
        log.warning(f"{label} is skipped: it needs a <type>, a <joint> with a <hardwareInterface> "
                    "and an <actuator>")
        return ""
    if len(transmission.joints) > 1:
        log.warning(f"{label} is skipped: only one joint per transmission is supported, but it "
                    f"has {', '.join(transmission.joints)}; write one transmission for each")
        return ""
    if len(commanded) > 1:
        log.warning(f"{label}: only the first of the interfaces {', '.join(commanded)} is "
                    "used; remove the others")
    return interface
