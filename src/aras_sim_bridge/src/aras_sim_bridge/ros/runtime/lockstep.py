"""Lockstep: simulated time waits until named topics have answered the last camera frame.

A round begins just before a frame is published (or when a period of simulated time is over). From
then on every one of the topics must deliver a message; until the last has, no step is made. So a
command that answers a frame acts from the step after that frame on, in every run, however slow
the node behind it is. Messages of different topics come over different connections, in any order:
name all topics that act on the simulation, not only the last one that a node publishes.

Nor is a step made while a listener has not taken an image or a state: a recorder loses none.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence

import rosgraph
import rospy

from aras_sim_bridge.errors import SimError
from aras_sim_bridge.ros.runtime.send_queue import QUEUE_FLUSHER, QueueFlusher

_TIMEOUT_WARNING = (
    "lockstep: simulated time waited %g s of wall time in vain for %s; it goes on without, until "
    "heard again"
)


class Lockstep:
    """Says when simulated time may go on. `start_round` and `compute_remaining` are the
    simulation's thread's.

    Who subscribes to a command topic himself claims it, and calls `note_message` once a
    message was handed on: so a command that counts is a command that acts.
    Other topics are listened to.
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
        """Wait for a message on each of `topics` a round.

        Args:
            timeout: s of wall time after which a round is given up.
            wake: called from any thread when a round may be over.
            period: s of simulated time between two rounds; 0: after each camera frame.
            flusher: sends what listeners have not taken yet.

        Raises:
            SimError: when there is no topic, or a number is out of range.
        """
        if not topics:
            raise SimError(
                "speed_mode is lockstep, but lockstep_topics is empty; name the topics that "
                "simulated time shall wait for, e.g. the command topics of the controllers"
            )
        if timeout <= 0.0:
            raise SimError(f"lockstep_timeout is {timeout:g}; give seconds above 0")
        if period < 0.0:
            raise SimError(f"lockstep_period is {period:g}; give seconds, or 0: camera frames")
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
        self._deadline: float | None = None  # of the wait that has begun
        self._flusher = flusher
        flusher.on_progress = wake

    @property
    def is_closed(self) -> bool:
        """Whether an answer is missing or a listener behind, so that no step may be made."""
        return bool(self._missing_topics or self._flusher.list_behind())

    def claim(self, topic: str) -> None:
        """Leave it to the caller to subscribe to `topic`, and to call `note_message`."""
        with self._lock:
            self._claimed_topics.add(topic)
            listener = self._listeners.pop(topic, None)
        if listener is not None:
            listener.unregister()

    def release(self, topic: str) -> None:
        """The subscriber that claimed `topic` is gone."""
        with self._lock:
            self._claimed_topics.discard(topic)

    def note_message(self, topic: str) -> None:
        """A message of `topic` was taken; from any thread."""
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
        """Begin a round when a period of simulated time is over."""
        if self._period_ns and time_ns >= self._next_ns:
            self._next_ns = (time_ns // self._period_ns + 1) * self._period_ns
            self.start_round()

    def before_frame(self) -> None:
        """Begin a round, unless rounds go by periods: a frame is about to be published."""
        if not self._period_ns:
            self.start_round()

    def start_round(self) -> None:
        """Begin a round: messages that came before do not count."""
        for topic in self.topics:
            self._subscribe(topic)
        with self._lock:
            self._missing_topics = set(self.topics) - self._silent_topics
            self._deadline = self._clock() + self._timeout

    def end_round(self) -> None:
        """End the round: simulated time was set back."""
        with self._lock:
            self._missing_topics.clear()
            self._deadline = None
            self._next_ns = self._period_ns

    def compute_remaining(self) -> float | None:
        """Seconds of wall time for which to wait on; None: go on. Complains when time is up."""
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
            for lane in behind:
                lane.is_abandoned = True
        # Asking the master who they are takes its time: not in the simulation's thread.
        slow = sorted(lane.name for lane in behind)
        threading.Thread(target=self._warn_late, args=(late, slow), daemon=True).start()
        return None

    def _subscribe(self, topic: str) -> None:
        with self._lock:
            # One process has one subscription a topic, of one type: never a second, of any type.
            if topic not in self._claimed_topics and topic not in self._listeners:
                self._listeners[topic] = rospy.Subscriber(
                    topic, rospy.AnyMsg, lambda _message: self.note_message(topic), tcp_nodelay=True
                )

    def _warn_late(self, topics: list[str], slow: list[str]) -> None:
        who = find_publishers(topics)
        named = [
            f"{topic} (published by {', '.join(who[topic])})"
            if who.get(topic)
            else f"{topic} (nobody publishes it)"
            for topic in topics
        ]
        rospy.logwarn(_TIMEOUT_WARNING, self._timeout, ", ".join(named + slow))


def find_publishers(topics: Sequence[str]) -> dict[str, list[str]]:
    """Return the names of the nodes that publish each topic; empty when the master is gone."""
    try:
        published, _, _ = rosgraph.Master(rospy.get_name()).getSystemState()
    except (OSError, rosgraph.MasterException):
        return {}
    return {topic: sorted(nodes) for topic, nodes in published if topic in topics}
