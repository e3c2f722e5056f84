"""Topics of a controller.

Its attributes command_kind, state_kind and action_kind determine which topics it has. Only the
simulation thread accesses the controller; rospy's threads only post jobs to it.
"""

from __future__ import annotations

from collections.abc import Callable

from control_msgs.msg import JointControllerState, JointTrajectoryControllerState, PidState
from genpy import Message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from aras_sim_bridge.control.controllers import Controller, base
from aras_sim_bridge.control.pid import Pid, PidGains
from aras_sim_bridge.ros.control.command_subscriber import CommandSubscriber
from aras_sim_bridge.ros.control.controller_action_server import (
    ControllerActionServer,
    GripperActionServer,
)
from aras_sim_bridge.ros.control.state_publisher import StatePublisher
from aras_sim_bridge.ros.control.trajectory import (
    TrajectoryActionServer,
    fill_state,
    from_trajectory,
)
from aras_sim_bridge.ros.conversions import to_duration, to_time
from aras_sim_bridge.ros.runtime.reconfigure_parameters import PID_FIELDS
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread
from aras_visual_servo_ros.parameters import Value
from aras_visual_servo_ros.reconfigure import ReconfigureServer


class PidTopics:
    """Reconfigurable gains and state topic of one PID."""

    def __init__(self, namespace: str, pid: Pid, thread: SimulationThread) -> None:
        """Advertise the gains of `pid` in `namespace`, and its state if it is to be published."""
        self._pid = pid
        values = dict(zip(_GAINS, pid.gains, strict=True))
        self._server = ReconfigureServer(namespace, PID_FIELDS, values, self._apply)
        self._state: StatePublisher | None = None
        if pid.publish_state:

            def fill(message: PidState, state: object) -> None:
                message.header.stamp = to_time(thread.simulation.time_ns)
                message.timestep = to_duration(state.time_step)
                _copy_fields(message, state, _PID_FIELDS)

            self._state = StatePublisher(f"{namespace}/state", PidState, 1, pid, fill, thread)

    def shutdown(self) -> None:
        """Shut down the reconfigure server and the state topic."""
        self._server.shutdown()
        if self._state is not None:
            self._state.shutdown()

    def _apply(self, values: dict[str, Value]) -> None:
        self._pid.set_gains(PidGains(*(values[name] for name in _GAINS)))


class ControllerTopics:
    """All topics of one loaded controller."""

    def __init__(
        self, controller: Controller, robot_namespace: str, thread: SimulationThread
    ) -> None:
        """Advertise the command and state topics, PIDs and action of `controller`."""
        self.controller = controller
        where = controller.context.where
        self._parts: list[
            CommandSubscriber | StatePublisher | PidTopics | ControllerActionServer
        ] = [PidTopics(f"{where}/{name}", pid, thread) for name, pid in controller.pids.items()]
        if controller.command_kind in COMMANDS:
            message, decode = COMMANDS[controller.command_kind]
            self._parts.append(
                CommandSubscriber(
                    f"{where}/command",
                    message,
                    lambda received: controller.set_command(decode(received)),
                    thread,
                )
            )
        if controller.state_kind in STATES:
            message, queue_size, fill = STATES[controller.state_kind]
            topic = f"{where}/state"
            if controller.state_kind == "joint_states":
                topic = f"{robot_namespace}/joint_states"
                if getattr(controller, "true_stamps", False):
                    fill = _restamp(fill, thread)
            self._parts.append(StatePublisher(topic, message, queue_size, controller, fill, thread))
        if controller.action_kind in ACTIONS:
            self._parts.append(ACTIONS[controller.action_kind](controller, where, thread))

    def shutdown(self) -> None:
        """Shut down all topics and actions."""
        for part in self._parts:
            part.shutdown()


def fill_controller_state(message: JointControllerState, state: base.JointControllerState) -> None:
    """Write the state of a PID controller to its message."""
    message.header.stamp = to_time(state.stamp_ns)
    _copy_fields(message, state, _CONTROLLER_FIELDS)


def fill_joint_states(message: JointState, states: base.JointStates) -> None:
    """Write the states of all joints to the message."""
    message.header.stamp = to_time(states.stamp_ns)
    message.name = states.names
    message.position = states.positions
    message.velocity = states.velocities
    message.effort = states.efforts


def _restamp(
    fill: Callable[[Message, object], None], thread: SimulationThread
) -> Callable[[Message, object], None]:
    """Return a function that calls `fill` and stamps the message with the current simulated time.

    Controllers publish states before the physics step, when the current time is still the time at
    which the joints were measured.
    """

    def fill_and_stamp(message: Message, state: object) -> None:
        fill(message, state)
        message.header.stamp = to_time(thread.simulation.time_ns)

    return fill_and_stamp


def _copy_fields(message: Message, state: object, names: tuple[str, ...]) -> None:
    for name in names:
        setattr(message, name, getattr(state, name))


# For each command_kind of a controller: message type of its command topic, and function that
# converts a message to the argument of set_command.
COMMANDS = {
    "float64": (Float64, lambda message: message.data),
    "float64_array": (Float64MultiArray, lambda message: list(message.data)),
    "joint_trajectory": (JointTrajectory, from_trajectory),
}
# For each state_kind of a controller: message type of its state topic, queue size, and function
# that writes a state to a message.
STATES = {
    "joint_controller_state": (JointControllerState, 1, fill_controller_state),
    "joint_states": (JointState, 4, fill_joint_states),
    "joint_trajectory_state": (JointTrajectoryControllerState, 1, fill_state),
}
# For each action_kind of a controller: class of its action server.
ACTIONS = {
    "follow_joint_trajectory": TrajectoryActionServer,
    "gripper_command": GripperActionServer,
}
# Names of the fields of PidGains in dynamic_reconfigure.
_GAINS = ("p", "i", "d", "i_clamp_max", "i_clamp_min", "antiwindup")
_PID_FIELDS = tuple(name for name in PidState.__slots__ if name not in ("header", "timestep"))
_CONTROLLER_FIELDS = tuple(name for name in JointControllerState.__slots__ if name != "header")
