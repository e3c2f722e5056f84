"""/clock: simulated time for everybody, throttled.

A tick goes out before every camera frame is drawn too, so that no node is handed a picture whose
stamp lies in its future.
"""

from __future__ import annotations

import struct

from rosgraph_msgs.msg import Clock

from aras_sim_bridge.ros.runtime.publisher import NonBlockingPublisher

_TIME = struct.Struct("<II")  # a serialised Clock: secs, nsecs


class ClockPublisher:
    """Publishes /clock every 1/rate s of simulated time, at multiples of that period."""

    def __init__(self, rate: float) -> None:
        """Advertise /clock; rate in Hz of simulated time, 0 publishes every step."""
        self._period_ns = round(1e9 / rate) if rate > 0 else 0
        self._next_ns = 0
        self._last_ns = -1
        self._publisher = NonBlockingPublisher("/clock", Clock, queue_size=10)

    def update(self, time_ns: int) -> None:
        """Publish when the period since the last multiple of it is over."""
        if time_ns < self._next_ns:
            return
        if self._period_ns:
            self._next_ns = (time_ns // self._period_ns + 1) * self._period_ns
        self.publish(time_ns)

    def publish(self, time_ns: int) -> None:
        """Publish now, whatever the period says; the same time only once."""
        if time_ns == self._last_ns:
            return
        self._last_ns = time_ns
        self._publisher.publish_bytes(_TIME.pack(*divmod(time_ns, 1_000_000_000)))

    def restart(self) -> None:
        """Go on at once after simulated time was set back to zero."""
        self._next_ns = 0
        self._last_ns = -1
