"""Detection of the loss of the ROS master, which rospy itself does not report."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import rosgraph

PATIENCE = 2  # number of consecutive failed queries after which the master counts as lost
RETRY = 0.5  # time between a failed query of the master and the next query, s of wall time


class MasterWatch:
    """Monitor of the ROS master; it queries the master's process ID periodically."""

    def __init__(self, name: str, period: float = 2.0) -> None:
        """Create a monitor for the node `name` with a query every `period` s of wall time."""
        self._master = rosgraph.Master(name)
        self._period = period
        self._next = 0.0
        self._failures = 0
        self._pid: int | None = None

    def find_loss_reason(self) -> str:
        """Return the reason why this node has lost its master, or '' if it has not.

        Frequent calls are cheap, because the master is queried only once in each period.
        """
        now = time.monotonic()
        if now < self._next:
            return ""
        try:
            pid = self._master.getPid()
        except (OSError, rosgraph.MasterException):
            self._failures += 1
            self._next = now + min(RETRY, self._period)
            if self._failures < PATIENCE:
                return ""
            return "the ROS master does not answer any more"
        self._failures = 0
        self._next = now + self._period
        self._pid = self._pid or pid
        return "" if pid == self._pid else "the ROS master was restarted"

    def watch(self, on_loss: Callable[[str], None]) -> None:
        """Monitor the master in a new thread and call `on_loss` once with the reason."""

        def run() -> None:
            while not (reason := self.find_loss_reason()):
                time.sleep(RETRY)
            on_loss(reason)

        threading.Thread(target=run, name="master watch", daemon=True).start()
