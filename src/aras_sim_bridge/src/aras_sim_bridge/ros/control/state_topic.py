"""A topic of what a controller or a PID tells of itself, while somebody listens."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from genpy import Message

from aras_sim_bridge.ros.runtime.publisher import NonBlockingPublisher
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread


class StateSource(Protocol):
    """What tells of itself: a controller or a PID."""

    on_state: Callable[[object], None] | None


class StateTopic:
    """A topic of what a port tells, which builds nothing while nobody listens."""

    def __init__(
        self,
        topic: str,
        message: type[Message],
        queue_size: int,
        source: StateSource,
        fill: Callable[[Message, object], object],
        thread: SimulationThread,
    ) -> None:
        """Advertise; `fill` writes a state into the one message that is published again and again.

        The port is switched in the simulation's thread alone, by who listens then.
        """
        self._source = source
        self._fill = fill
        self._thread = thread
        self._message = message()
        self._publisher: NonBlockingPublisher | None = None
        self._publisher = NonBlockingPublisher(
            topic, message, queue_size, on_change=self._on_subscribers
        )
        self._on_subscribers()

    def shutdown(self) -> None:
        """Take the topic off the graph."""
        self._publisher.unregister()
        self._on_subscribers()

    def _on_subscribers(self) -> None:
        self._thread.post(self._update_listener)

    def _update_listener(self) -> None:
        wanted = self._publisher is not None and self._publisher.subscriber_count > 0
        self._source.on_state = self._publish if wanted else None

    def _publish(self, state: object) -> None:
        self._fill(self._message, state)
        self._publisher.publish(self._message)
