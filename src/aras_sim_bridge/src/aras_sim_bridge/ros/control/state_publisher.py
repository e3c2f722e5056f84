"""Publisher of the state of a controller, PID or sensor while it has subscribers."""

from __future__ import annotations

from collections.abc import Callable

from genpy import Message

from aras_sim_bridge.control.controllers import Controller
from aras_sim_bridge.control.pid import Pid
from aras_sim_bridge.ros.runtime.publisher import NonBlockingPublisher
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread
from aras_sim_bridge.sensors import PeriodicSensor


class StatePublisher(NonBlockingPublisher):
    """Topic with the states that a source passes to its function `on_state`.

    The source computes states only while the topic has subscribers; otherwise `on_state` is None.
    """

    def __init__(
        self,
        topic: str,
        message: type[Message],
        queue_size: int,
        source: Controller | Pid | PeriodicSensor,
        fill: Callable[[Message, object], object],
        thread: SimulationThread,
    ) -> None:
        """Advertise the topic.

        `fill` writes a state to a message; the same message is used for all publications. Only the
        simulation thread changes `on_state` of the source.
        """
        self._source = source
        self._fill = fill
        self._thread = thread
        self._message = message()
        super().__init__(topic, message, queue_size, on_change=self._on_subscribers)

    def shutdown(self) -> None:
        """Unregister the topic."""
        self.unregister()

    def _on_subscribers(self) -> None:
        self._thread.post(self._update_listener)

    def _update_listener(self) -> None:
        self._source.on_state = self._publish_state if self.subscriber_count else None

    def _publish_state(self, state: object) -> None:
        self._fill(self._message, state)
        self.publish(self._message)
