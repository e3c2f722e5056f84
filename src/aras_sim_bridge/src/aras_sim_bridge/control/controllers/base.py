"""Base class of the controllers, and their connections to topics and actions.

A controller uses joint handles and simulated time, but not ROS. Its class attributes declare which
topics and actions the ROS layer creates. `C` stands for <robot namespace>/<controller name>:

| class attribute | value | connection made by the ROS layer |
|---|---|---|
| command_kind | 'float64' | C/command std_msgs/Float64 → set_command(float) |
| | 'float64_array' | C/command std_msgs/Float64MultiArray → set_command(list[float]) |
| | 'joint_trajectory' | C/command trajectory_msgs/JointTrajectory → set_command(Trajectory) |
| state_kind | 'joint_controller_state' | on_state(JointControllerState) → C/state |
| | 'joint_trajectory_state' | on_state(TrajectoryControllerState) → C/state |
| | 'joint_states' | on_state(JointStates) → <robot namespace>/joint_states |
| action_kind | 'follow_joint_trajectory' | C/follow_joint_trajectory and C/query_state |
| | 'gripper_command' | C/gripper_cmd |
| pids (instance) | {path below C: Pid} | dynamic_reconfigure server and PidState at C/<path> |

An attribute that is None creates no connection. The paths in pids are 'pid', '<joint>/pid' (groups)
or 'gains/<joint>' (trajectories, grippers). The types of commands, states and goals are defined in
this module, in trajectory_types.py and in gripper.py. Actions call submit_goal and cancel_goal, see
action_controller.py. update() calls on_state, if it is not None, with an object that the controller
does not modify afterwards.

set_command checks a command and stores it; the next update() uses the last stored command.
starting() and reset() discard it. set_command may be called from any thread, except for trajectory
controllers. All other methods may only be called in the simulation thread.

A controller of your own derives from Controller and sets these attributes; registry.py describes
how to select it.
"""

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import inf, isfinite
from typing import ClassVar

from aras_sim_bridge.control.hardware import RobotHardware
from aras_sim_bridge.control.joints import JointHandle
from aras_sim_bridge.control.pid import Pid
from aras_sim_bridge.description.types import RobotDescription
from aras_sim_bridge.errors import ControllerError
from aras_visual_servo_base.settings import read

# a controller publishes its state in every tenth update, as in ros_controllers
STATE_EVERY = 10


@dataclass(frozen=True, slots=True)
class ControllerContext:
    """Name, namespace and robot of a controller.

    Attributes:
        namespace: namespace of the robot, without trailing slash.
        description: description of the robot, or None.
        robot_parameters: parameters in the robot's namespace.
    """

    name: str
    namespace: str = ""
    description: RobotDescription | None = None
    robot_parameters: Mapping = field(default_factory=dict)

    @property
    def where(self) -> str:
        """Absolute ROS name of the controller, such as /arm/J1_controller."""
        return f"{self.namespace}/{self.name}"


@dataclass(frozen=True, slots=True)
class ClaimedResources:
    """Joints claimed through one interface, e.g. 'hardware_interface::EffortJointInterface'."""

    hardware_interface: str
    resources: tuple[str, ...]


@dataclass(slots=True)
class JointControllerState:
    """State of a PID position or velocity controller (control_msgs/JointControllerState)."""

    stamp_ns: int
    set_point: float
    process_value: float
    process_value_dot: float
    error: float
    time_step: float
    command: float
    p: float
    i: float
    d: float
    i_clamp: float
    antiwindup: bool


@dataclass(slots=True)
class JointStates:
    """States of all joints at one time (sensor_msgs/JointState); all lists have the same length."""

    stamp_ns: int
    names: tuple[str, ...]
    positions: list[float]
    velocities: list[float]
    efforts: list[float]


class Controller:
    """Base class of all joint controllers, as in ros_control, including users' controllers.

    Times are int ns of simulated time, periods are float s.

    Attributes:
        interface: ros_control interface through which the controller claims its joints.
        slot: the last command of `set_command`, until an update uses it; otherwise empty.
        is_compilable: whether compiled code may do the work of `update`; only for a
            JointCommandController.
        is_read_only: whether `update` only reads the joints.
    """

    interface: ClassVar[str] = ""
    command_kind: ClassVar[str | None] = None
    state_kind: ClassVar[str | None] = None
    action_kind: ClassVar[str | None] = None
    is_compilable = is_read_only = False

    def __init__(self) -> None:
        self.context = ControllerContext("")
        self.joints: tuple[str, ...] = ()
        self.pids: dict[str, Pid] = {}
        self.on_state: Callable[[object], None] | None = None
        self.slot: deque[object] = deque(maxlen=1)

    def init(
        self, hardware: RobotHardware, parameters: Mapping, context: ControllerContext
    ) -> None:
        """Read the parameters and get the joint handles.

        Args:
            parameters: parameters in the controller's namespace.

        Raises:
            ControllerError: a parameter or joint is missing.
        """
        self.context = context

    def get_loop_gains(self) -> dict[str, tuple[float, float]]:
        """Return (stiffness, damping) of each joint that the controller drives by effort.

        The stiffness is the decrease of the effort per unit of joint position, and the damping is
        its decrease per unit of joint velocity.
        """
        return {}

    def starting(self, time_ns: int) -> None:
        """Choose the set point such that the joints do not jump; called before the first update."""
        self.slot.clear()

    def update(self, time_ns: int, period: float) -> None:
        """Run one control cycle."""

    def idle_until(self, time_ns: int) -> float:
        """Return the last time, ns, at which `update` would still do nothing.

        Updates from `time_ns` to this time may be skipped. A result before `time_ns` means that no
        update may be skipped. The method is not called for controllers with `is_compilable`.
        """
        return -inf

    def reset(self) -> None:
        """Discard pending commands, because the clock or the robot was reset."""
        self.slot.clear()

    def restart(self, time_ns: int) -> None:
        """Restart together with the simulation: keep the set point, and reset the PIDs."""
        for pid in self.pids.values():
            pid.reset()

    def stopping(self, time_ns: int) -> None:
        """Stop the controller; its last commands remain in the joint handles."""

    def set_command(self, value: object) -> None:
        """Store a command, from any thread. Raises ControllerError for an invalid command."""
        raise ControllerError(f"controller '{self.context.name}' takes no commands")

    @property
    def claimed_resources(self) -> tuple[ClaimedResources, ...]:
        """Joints that only this controller may command."""
        return (
            ClaimedResources(f"hardware_interface::{self.interface}", tuple(sorted(self.joints))),
        )

    def read_pid(self, parameters: Mapping, path: str) -> Pid:
        """Create a PID with the gains at `path`, such as 'gains/J1', and store it in `pids`.

        `parameters` are those in the controller's namespace.

        Raises:
            ControllerError: a gain is missing or invalid.
        """
        where = self.context.where
        for key in path.split("/"):
            parameters = read(parameters, key, Mapping, where, ControllerError, {})
            where = f"{where}/{key}"
        pid = self.pids[path] = Pid.from_parameters(parameters, where)
        return pid

    def take_handle(self, hardware: RobotHardware, joint: str) -> JointHandle:
        """Return the handle of a joint that the controller's `interface` offers.

        Raises:
            ControllerError: the interface has no such joint; the message lists its joints.
        """
        known = hardware.interfaces[self.interface]
        if joint not in known:
            other = hardware.handles.get(joint)
            hint = f", only the {other.interface}" if other else ""
            raise ControllerError(
                f"controller '{self.context.name}': joint '{joint}' does not have the "
                f"{self.interface}{hint}; joints with it: {', '.join(sorted(known)) or 'none'}. "
                f"Correct {self.context.where} or the robot's <transmission> tags"
            )
        return hardware.handles[joint]


def read_joint_names(parameters: Mapping, key: str, where: str) -> tuple[str, ...]:
    """Return the joint names that the parameter `key` lists.

    Raises:
        ControllerError: the list is empty, or a name is empty or repeated.
    """
    found = read(parameters, key, tuple[str, ...], where, ControllerError)
    if not all(found) or not found or len(set(found)) < len(found):
        raise ControllerError(
            f"parameter {where}/{key} is {list(found)}, must be a non-empty list of "
            "different names"
        )
    return found


def check_number(value: object, controller: str, what: str = "command") -> float:
    """Return `value` as float. Raises ControllerError if it is not a finite number."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise ControllerError(
            f"controller '{controller}': {what} {value!r} is not a number; send a finite number"
        ) from None
    if not isfinite(number):
        raise ControllerError(
            f"controller '{controller}': {what} {number} is not finite; "
            "the last valid value stays in use"
        )
    return number
