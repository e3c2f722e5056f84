"""A topic of what a controller or a PID tells of itself, while somebody listens."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from genpy import Message

from aras_sim_bridge.ros.runtime.publisher import QuickPublisher
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread


class StatePort(Protocol):
    """What tells of itself: a controller or a PID."""

    on_state: Callable[[object], None] | None


class StateTopic:
    """A topic of what a port tells, which builds nothing while nobody listens."""

    def __init__(
        self,
        topic: str,
        message: type[Message],
        queue_size: int,
        port: StatePort,
        fill: Callable[[Message, object], object],
        thread: SimulationThread,
    ) -> None:
        """Advertise; `fill` writes a state into the one message that is published again and again.

        The port is switched in the simulation's thread alone, by who listens then.
        """
        self._port = port
        self._fill = fill
        self._thread = thread
        self._message = message()
        self._publisher: QuickPublisher | None = None
        self._publisher = QuickPublisher(topic, message, queue_size, changed=self._changed)
        self._changed()

    def shutdown(self) -> None:
        """Take the topic off the graph."""
        self._publisher.unregister()
        self._changed()

    def _changed(self) -> None:
        self._thread.post(self._switch)

    def _switch(self) -> None:
        wanted = self._publisher is not None and self._publisher.listeners > 0
        self._port.on_state = self._publish if wanted else None

    def _publish(self, state: object) -> None:
        self._fill(self._message, state)
        self._publisher.publish(self._message)
