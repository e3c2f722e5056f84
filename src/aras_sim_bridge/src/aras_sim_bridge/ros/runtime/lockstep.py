"""Lockstep mode: simulated time waits for the replies to each camera frame.

The user selects the topics on which nodes publish their replies. Just before a frame is published,
simulated time stops. It continues when a message has arrived on each selected topic. A command that
is computed from a frame therefore takes effect in the first step after this frame, however slow the
node is. Instead of each frame, a fixed period of simulated time can be set. The time from one stop
to the next is called a round.

Select all topics that act on the simulation, because messages of different topics arrive in any
order.

Simulated time also stops while a subscriber has not received all images and states yet, so that a
recorder receives all of them.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence

import rosgraph
import rospy

from aras_sim_bridge.errors import SimError
from aras_visual_servo_ros.send_queue import QUEUE_FLUSHER, QueueFlusher

_TIMEOUT_WARNING = (
    "lockstep: after waiting %g s of wall time for %s, simulated time continues; check that these "
    "nodes run. Simulated time waits again after the next message"
)


class Lockstep:
    """Gate that stops simulated time until all selected topics have delivered a message.

    `start_round` and `compute_remaining` may only be called in the simulation thread.

    Lockstep subscribes to the selected topics itself. If another subscriber of this process handles
    the messages of a topic, it calls `claim` first, and `note_message` after each message that it
    has applied. A message of this topic then counts only after it has been applied.
    """

    def __init__(
        self,
        topics: Sequence[str],
        timeout: float,
        wake: Callable[[], None],
        period: float = 0.0,
        clock: Callable[[], float] = time.monotonic,
        flusher: QueueFlusher = QUEUE_FLUSHER,
    ) -> None:
        """Create a gate; in every round, simulated time waits for a message on each of `topics`.

        A round lasts from one stop of simulated time to the next.

        Args:
            topics: names of the topics.
            timeout: wall time after which simulated time continues without a message, s.
            wake: function that is called when simulated time may continue; any thread may call it.
            period: simulated time of a round, s; 0 starts a round with each camera frame.
            clock: function that returns the wall time, s.
            flusher: object that sends the messages that subscribers have not received yet.

        Raises:
            SimError: `topics` is empty or a number is out of range.
        """
        if not topics:
            raise SimError(
                "speed_mode is lockstep, but lockstep_topics is empty; set the topics that "
                "simulated time shall wait for, e.g. the command topics of the controllers"
            )
        if timeout <= 0.0:
            raise SimError(f"lockstep_timeout is {timeout:g}; set a time above 0 s")
        if period < 0.0:
            raise SimError(
                f"lockstep_period is {period:g}; set a time in s, or 0 to wait after each frame"
            )
        self.topics = tuple(dict.fromkeys(rospy.resolve_name(topic) for topic in topics))
        self._timeout = timeout
        self._wake = wake
        self._clock = clock
        self._period_ns = round(period * 1e9)
        self._next_ns = self._period_ns
        self._lock = threading.Lock()
        self._claimed_topics: set[str] = set()
        self._listeners: dict[str, rospy.Subscriber] = {}
        self._missing_topics: set[str] = set()
        self._silent_topics: set[str] = set()
        # wall time at which the present wait ends, s; None if simulated time does not wait
        self._deadline: float | None = None
        self._flusher = flusher
        flusher.on_progress = wake

    @property
    def is_closed(self) -> bool:
        """Whether no step may be made now.

        A message is missing, or a subscriber has not received all messages of this node yet.
        """
        return bool(self._missing_topics or self._flusher.list_behind())

    def claim(self, topic: str) -> None:
        """Stop receiving the messages of `topic`, because the caller receives them.

        The caller calls `note_message` for each message.
        """
        with self._lock:
            self._claimed_topics.add(topic)
            listener = self._listeners.pop(topic, None)
        if listener is not None:
            listener.unregister()

    def release(self, topic: str) -> None:
        """Undo `claim` for `topic`; call this after its subscriber has been closed."""
        with self._lock:
            self._claimed_topics.discard(topic)

    def note_message(self, topic: str) -> None:
        """Register that a message of `topic` has been applied; may be called from any thread."""
        with self._lock:
            self._silent_topics.discard(topic)
            if topic not in self._missing_topics:
                return
            self._missing_topics.discard(topic)
            if self._missing_topics:
                return
            self._deadline = None
        self._wake()

    def after_step(self, time_ns: int) -> None:
        """Wait for messages from now on, if a new period of simulated time has started."""
        if self._period_ns and time_ns >= self._next_ns:
            self._next_ns = (time_ns // self._period_ns + 1) * self._period_ns
            self.start_round()

    def before_frame(self) -> None:
        """Wait for messages that reply to the frame that is about to be published.

        If a fixed period is set, this has no effect.
        """
        if not self._period_ns:
            self.start_round()

    def start_round(self) -> None:
        """Stop simulated time until a new message has arrived on every selected topic."""
        for topic in self.topics:
            self._subscribe(topic)
        with self._lock:
            self._missing_topics = set(self.topics) - self._silent_topics
            self._deadline = self._clock() + self._timeout

    def end_round(self) -> None:
        """Stop waiting, because simulated time has been reset or resumed."""
        with self._lock:
            self._missing_topics.clear()
            self._deadline = None
            self._next_ns = self._period_ns

    def compute_remaining(self) -> float | None:
        """Return how long to wait for missing messages, s of wall time; None means no wait.

        After the timeout a warning is logged. A topic without a message is then ignored until its
        next message.
        """
        with self._lock:
            behind = self._flusher.list_behind()
            if not (self._missing_topics or behind):
                self._deadline = None
                return None
            now = self._clock()
            if self._deadline is None:
                self._deadline = now + self._timeout
            if self._deadline > now:
                return self._deadline - now
            self._deadline = None
            late = sorted(self._missing_topics)
            self._missing_topics.clear()
            self._silent_topics.update(late)
            for queue in behind:
                queue.is_abandoned = True
        # Log the warning in another thread: it names the publishers, which the ROS master reports
        # slowly.
        slow = sorted(queue.name for queue in behind)
        threading.Thread(target=self._warn_late, args=(late, slow), daemon=True).start()
        return None

    def _subscribe(self, topic: str) -> None:
        with self._lock:
            # rospy allows only one message type per topic in a process. A listener with AnyMsg
            # would conflict with a subscriber of this process that has claimed the topic.
            if topic not in self._claimed_topics and topic not in self._listeners:
                self._listeners[topic] = rospy.Subscriber(
                    topic, rospy.AnyMsg, lambda _message: self.note_message(topic), tcp_nodelay=True
                )

    def _warn_late(self, topics: list[str], slow: list[str]) -> None:
        publishers = find_publishers(topics)
        descriptions = [
            f"{topic} (published by {', '.join(publishers[topic])})"
            if publishers.get(topic)
            else f"{topic} (no publisher)"
            for topic in topics
        ]
        rospy.logwarn(_TIMEOUT_WARNING, self._timeout, ", ".join(descriptions + slow))


def find_publishers(topics: Sequence[str]) -> dict[str, list[str]]:
    """Return the names of the nodes that publish each topic, or {} if the master is unreachable."""
    try:
        published, _, _ = rosgraph.Master(rospy.get_name()).getSystemState()
    except (OSError, rosgraph.MasterException):
        return {}
    return {topic: sorted(nodes) for topic, nodes in published if topic in topics}
