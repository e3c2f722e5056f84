"""Publisher of simulated time on /clock at a limited rate.

The time is also published before every camera frame is rendered. Therefore no node receives an
image with a stamp later than the node's own time.
"""

from __future__ import annotations

import struct

from rosgraph_msgs.msg import Clock

from aras_sim_bridge.ros.runtime.publisher import NonBlockingPublisher

_TIME = struct.Struct("<II")  # layout of a serialised Clock message: secs, nsecs


class ClockPublisher:
    """Publisher of the simulated time on /clock, once per period of 1 / rate."""

    def __init__(self, rate: float) -> None:
        """Advertise /clock; `rate` is in Hz of simulated time, and 0 means every step."""
        self._period_ns = round(1e9 / rate) if rate > 0 else 0
        self._next_ns = 0
        self._last_ns = -1
        self._publisher = NonBlockingPublisher("/clock", Clock, queue_size=10)

    def update(self, time_ns: int) -> None:
        """Publish `time_ns` if a new period has started since the last call."""
        if time_ns < self._next_ns:
            return
        if self._period_ns:
            self._next_ns = (time_ns // self._period_ns + 1) * self._period_ns
        self.publish(time_ns)

    def publish(self, time_ns: int) -> None:
        """Publish `time_ns` even within a period, but never the same time twice."""
        if time_ns == self._last_ns:
            return
        self._last_ns = time_ns
        self._publisher.publish_bytes(_TIME.pack(*divmod(time_ns, 1_000_000_000)))

    def restart(self) -> None:
        """Publish again from the next step on, because simulated time has been reset to zero."""
        self._next_ns = 0
        self._last_ns = -1
