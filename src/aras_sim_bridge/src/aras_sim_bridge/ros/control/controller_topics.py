"""The topics of one controller, made from the ports that its class declares (controllers.base).

A command topic may be flooded: the original nodes publish from a loop without sleep. rospy decodes
one message a wake-up, the last of what the socket held, when queue_size is 1; so the callback
sleeps a little when commands come faster than the controller can use them, and the rest of the
flood passes by undecoded.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Any

import rospy
from control_msgs.msg import JointControllerState, JointTrajectoryControllerState, PidState
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from aras_sim_bridge.control.controllers import Controller
from aras_sim_bridge.control.pid import Gains, Pid
from aras_sim_bridge.errors import SimError
from aras_sim_bridge.ros.camera.quick_publisher import QuickPublisher
from aras_sim_bridge.ros.control.reconfigure import PID_FIELDS, ReconfigureServer
from aras_sim_bridge.ros.control.trajectory_topics import (
    TrajectoryAction,
    from_trajectory,
    to_state,
)
from aras_sim_bridge.ros.conversions import to_duration, to_time
from aras_sim_bridge.ros.runtime.lockstep import COUNT

log = logging.getLogger("rosout.controllers")

FLOOD_PERIOD = 0.004  # seconds of wall time between two decoded commands: a batch of steps
BUFFER_SIZE = 1 << 20  # bytes taken from the socket in one go
COMPLAINT_PERIOD = 5.0  # seconds of wall time between two lines about the same fault


class _Toggle(rospy.SubscribeListener):
    """Switches a producer on while its topic has subscribers."""

    def __init__(self, switch: Any) -> None:
        super().__init__()
        self._switch = switch

    def peer_subscribe(self, *_args: object) -> None:
        self._switch(True)

    def peer_unsubscribe(self, _name: str, remaining: int) -> None:
        self._switch(remaining > 0)


class CommandTopic:
    """Hands the latest message of a topic to a controller."""

    def __init__(self, topic: str, message: type, take: Any, decode: Any) -> None:
        """Subscribe; `take(decode(message))` gets the commands and may raise SimError."""
        self._topic = topic
        self._take = take
        self._decode = decode
        self._last = 0.0
        self._complained = -COMPLAINT_PERIOD
        self._refused = 0
        COUNT.claim(topic)
        self._subscriber = rospy.Subscriber(
            topic,
            message,
            self._on_message,
            queue_size=1,
            buff_size=BUFFER_SIZE,
            tcp_nodelay=True,
        )

    def _on_message(self, message: Any) -> None:
        try:
            self._take(self._decode(message))
        except SimError as error:
            self._complain(error)
        COUNT.note(self._topic)
        now = time.monotonic()
        if now - self._last < FLOOD_PERIOD:
            time.sleep(FLOOD_PERIOD)
            now += FLOOD_PERIOD
        self._last = now

    def _complain(self, error: SimError) -> None:
        self._refused += 1
        now = time.monotonic()
        if now - self._complained >= COMPLAINT_PERIOD:
            more = f" ({self._refused} refused so far)" if self._refused > 1 else ""
            rospy.logerr("%s: %s%s", self._topic, error, more)
            self._complained = now

    def shutdown(self) -> None:
        """Unsubscribe."""
        self._subscriber.unregister()
        COUNT.release(self._topic)


class PidTopics:
    """dynamic_reconfigure and PidState of one PID."""

    def __init__(self, namespace: str, pid: Pid, now_ns: Callable[[], int]) -> None:
        """Serve `pid` in `namespace`; `now_ns` gives the simulated time."""
        self._pid = pid
        self._now_ns = now_ns
        gains = pid.gains
        self._server = ReconfigureServer(
            namespace,
            PID_FIELDS,
            {
                "p": gains.p,
                "i": gains.i,
                "d": gains.d,
                "i_clamp_min": gains.i_min,
                "i_clamp_max": gains.i_max,
                "antiwindup": gains.antiwindup,
            },
            self._apply,
        )
        self._publisher: QuickPublisher | None = None
        if pid.publish_state:
            self._publisher = QuickPublisher(
                f"{namespace}/state",
                PidState,
                queue_size=1,
                subscriber_listener=_Toggle(self._listen),
            )

    def _apply(self, values: dict[str, Any]) -> None:
        self._pid.set_gains(
            Gains(
                values["p"],
                values["i"],
                values["d"],
                values["i_clamp_max"],
                values["i_clamp_min"],
                values["antiwindup"],
            )
        )

    def _listen(self, on: bool) -> None:
        self._pid.on_state = self._on_state if on else None

    def _on_state(self, state: Any) -> None:
        message = PidState(timestep=to_duration(state.time_step))
        message.header.stamp = to_time(self._now_ns())
        for field in PidState.__slots__:
            if field not in ("header", "timestep"):
                setattr(message, field, getattr(state, field))
        self._publisher.publish(message)

    def shutdown(self) -> None:
        """Take everything off the graph."""
        self._pid.on_state = None
        self._server.shutdown()
        if self._publisher is not None:
            self._publisher.unregister()


class ControllerTopics:
    """All topics of one loaded controller."""

    def __init__(
        self, controller: Controller, robot_namespace: str, now_ns: Callable[[], int]
    ) -> None:
        """Put the controller's ports on the graph; `now_ns` gives the simulated time."""
        self.controller = controller
        self._namespace = controller.context.where
        self._robot_namespace = robot_namespace.rstrip("/")
        self._parts: list[Any] = []
        self._state: QuickPublisher | None = None
        self._open_command()
        self._open_state()
        for name, pid in controller.pids.items():
            self._parts.append(PidTopics(f"{self._namespace}/{name}", pid, now_ns))
        if controller.action_kind == "follow_joint_trajectory":
            self._parts.append(TrajectoryAction(controller, self._namespace, now_ns))

    def shutdown(self) -> None:
        """Take the ports off the graph."""
        self.controller.on_state = None
        for part in self._parts:
            part.shutdown()
        if self._state is not None:
            self._state.unregister()

    def _open_command(self) -> None:
        kinds = {
            "float64": (Float64, lambda message: message.data),
            "float64_array": (Float64MultiArray, lambda message: list(message.data)),
            "joint_trajectory": (JointTrajectory, from_trajectory),
        }
        kind = self.controller.command_kind
        if kind in kinds:
            message, decode = kinds[kind]
            topic = f"{self._namespace}/command"
            self._parts.append(CommandTopic(topic, message, self.controller.set_command, decode))

    def _open_state(self) -> None:
        kinds = {
            "joint_controller_state": (
                f"{self._namespace}/state",
                JointControllerState,
                1,
                self._on_controller_state,
            ),
            "joint_states": (
                f"{self._robot_namespace}/joint_states",
                JointState,
                4,
                self._on_joint_states,
            ),
            "joint_trajectory_state": (
                f"{self._namespace}/state",
                JointTrajectoryControllerState,
                1,
                lambda state: self._state.publish(to_state(state)),
            ),
        }
        kind = self.controller.state_kind
        if kind not in kinds:
            return
        topic, message, queue_size, on_state = kinds[kind]

        def switch(on: bool) -> None:
            self.controller.on_state = on_state if on else None

        self._state_message = message()
        self._state = QuickPublisher(
            topic, message, queue_size, subscriber_listener=_Toggle(switch)
        )

    def _on_controller_state(self, state: Any) -> None:
        message = self._state_message
        message.header.stamp = to_time(state.stamp_ns)
        for field in _CONTROLLER_STATE_FIELDS:
            setattr(message, field, getattr(state, field))
        self._state.publish(message)

    def _on_joint_states(self, states: Any) -> None:
        message = self._state_message
        message.header.stamp = to_time(states.stamp_ns)
        message.name = states.names
        message.position = states.positions
        message.velocity = states.velocities
        message.effort = states.efforts
        self._state.publish(message)


_CONTROLLER_STATE_FIELDS = tuple(
    field for field in JointControllerState.__slots__ if field != "header"
)
