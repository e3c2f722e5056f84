"""What a controller is, and the ports through which a ROS skin (or a test) reaches it.

A controller runs in the simulation's thread, sees joint handles and simulated time, and knows
nothing of ROS. It declares its ports; the skin gives them their topics. `C` stands for
<robot namespace>/<controller name>:

| class attribute | value | what the skin makes of it |
|---|---|---|
| command_kind | 'float64' | C/command std_msgs/Float64 → set_command(float) |
| | 'float64_array' | C/command std_msgs/Float64MultiArray → set_command(list[float]) |
| | 'joint_trajectory' | C/command trajectory_msgs/JointTrajectory → set_command(Trajectory) |
| state_kind | 'joint_controller_state' | on_state(JointControllerState) → C/state |
| | 'joint_trajectory_state' | on_state(TrajectoryState) → C/state |
| | 'joint_states' | on_state(JointStates) → <robot namespace>/joint_states |
| action_kind | 'follow_joint_trajectory' | C/follow_joint_trajectory and C/query_state |
| | 'gripper_command' | C/gripper_cmd |
| pids (instance) | {path below C: Pid} | dynamic_reconfigure server and PidState at C/<path> |

None means no such port. The paths in pids are 'pid', '<joint>/pid' (groups) or 'gains/<joint>'
(trajectories, grippers). The types that a command, state or goal consists of stand in this module,
in trajectory_types.py and in gripper.py; an action goes through submit_goal and cancel_goal, and
the handles of goals.py. on_state is called synchronously from update() with an object that the
controller does not touch again; as long as it is None, nothing is built. Every set_command may be
called from any thread: it checks the command and puts it into the controller's slot, where the
next update() finds the latest; starting() and a reset empty the slot. All else is the
simulation's thread's, trajectories too.

A controller of your own derives from Controller, sets these attributes and is named by parameter
(see registry.py); it gets its topics without a change here.
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

STATE_EVERY = 10  # updates per published state, as in ros_controllers


def _ignore(text: str) -> None:
    """Stand-in for a logger."""


@dataclass(frozen=True, slots=True)
class Context:
    """Where a controller lives.

    `namespace` is the robot's, without trailing slash; `description` the robot's
    (description.RobotDescription) or None; `robot_parameters` the mapping of the robot's
    namespace; `warn` and `error` take a line for the log.
    """

    name: str
    namespace: str = ""
    description: RobotDescription | None = None
    robot_parameters: Mapping = field(default_factory=dict)
    warn: Callable[[str], None] = _ignore
    error: Callable[[str], None] = _ignore

    @property
    def where(self) -> str:
        """Full name of the controller's own namespace."""
        return f"{self.namespace}/{self.name}"


@dataclass(frozen=True, slots=True)
class ClaimedResources:
    """Joints claimed through one interface, e.g. 'hardware_interface::EffortJointInterface'."""

    hardware_interface: str
    resources: tuple[str, ...]


@dataclass(slots=True)
class JointControllerState:
    """One sample of a PID position or velocity controller (control_msgs/JointControllerState)."""

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
    """All joints at one instant (sensor_msgs/JointState); lists of equal length."""

    stamp_ns: int
    names: tuple[str, ...]
    positions: list[float]
    velocities: list[float]
    efforts: list[float]


class Controller:
    """A joint controller as ros_control has them. Base class of all, also of your own.

    `interface` is the ros_control interface whose joints it claims; `slot` holds the last checked
    command that no update has seen; `compiled`: it is a CommandedController whose loops the
    compiled cycle may follow in place of `update`; `looks`: its update but looks at the joints.
    Times are int ns of the simulated clock, periods float s.
    """

    interface: ClassVar[str] = ""
    command_kind: ClassVar[str | None] = None
    state_kind: ClassVar[str | None] = None
    action_kind: ClassVar[str | None] = None
    is_compilable = is_read_only = False

    def __init__(self) -> None:
        self.context = Context("")
        self.joints: tuple[str, ...] = ()
        self.pids: dict[str, Pid] = {}
        self.on_state: Callable[[object], None] | None = None
        self.slot: deque[object] = deque(maxlen=1)

    def init(self, hardware: RobotHardware, parameters: Mapping, context: Context) -> None:
        """Read the parameters and take the handles.

        `hardware` is a RobotHardware, `parameters` the mapping of the controller's namespace.
        Raises ControllerError with what is missing.
        """
        self.context = context

    def get_loop_gains(self) -> dict[str, tuple[float, float]]:
        """By joint, for joints that it drives by efforts: how much the effort falls with the
        joint's position, and with its velocity."""
        return {}

    def starting(self, time_ns: int) -> None:
        """Choose the set point so that nothing jumps; called before the first update."""
        self.slot.clear()

    def update(self, time_ns: int, period: float) -> None:
        """One control cycle."""

    def idle_until(self, time_ns: int) -> float:
        """Up to when, ns, updates from `time_ns` on do nothing; a time before it: the next does.
        Not asked of controllers that are `compiled`."""
        return -inf

    def reset(self) -> None:
        """The clock or the robot was put back: commands from before do not count any more."""
        self.slot.clear()

    def restart(self, time_ns: int) -> None:
        """The simulation began anew: the set point stays, integrals and last errors do not."""
        for pid in self.pids.values():
            pid.reset()

    def stopping(self, time_ns: int) -> None:
        """Called when the controller stops; commands in the handles stay."""

    def set_command(self, value: object) -> None:
        """Take a command, from any thread. Raises ControllerError if it cannot be used."""
        raise ControllerError(f"controller '{self.context.name}' takes no commands")

    @property
    def claimed_resources(self) -> tuple[ClaimedResources, ...]:
        """Joints this controller alone may command."""
        return (
            ClaimedResources(f"hardware_interface::{self.interface}", tuple(sorted(self.joints))),
        )

    def take_handle(self, hardware: RobotHardware, joint: str) -> JointHandle:
        """The handle of `joint` through `interface`.

        Raises ControllerError naming the joint and those there are.
        """
        known = hardware.interfaces[self.interface]
        if joint not in known:
            other = hardware.handles.get(joint)
            hint = f" ('{joint}' has a {other.interface})" if other else ""
            raise ControllerError(
                f"controller '{self.context.name}': no joint '{joint}' in the "
                f"{self.interface}{hint}; it has {', '.join(sorted(known)) or 'none'}. Look at "
                f"{self.context.where} and at the robot's <transmission> tags"
            )
        return hardware.handles[joint]


def read_joint_names(parameters: Mapping, key: str, where: str) -> tuple[str, ...]:
    """The joints that a parameter names: at least one, each once; ControllerError else."""
    found = read(parameters, key, tuple[str, ...], where, ControllerError)
    if not all(found) or not found or len(set(found)) < len(found):
        raise ControllerError(
            f"parameter {where}/{key} is {list(found)}, must be a non-empty list of names, none "
            "twice"
        )
    return found


def check_number(value: object, controller: str, what: str = "command") -> float:
    """`value` as float. Raises ControllerError if it is no finite number."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise ControllerError(f"controller '{controller}': {what} {value!r} is no number") from None
    if not isfinite(number):
        raise ControllerError(
            f"controller '{controller}': {what} {number} is not finite; the last one is kept"
        )
    return number
