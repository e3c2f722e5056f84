"""Notices that the ROS master has gone: rospy itself would go on for ever without a word."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import rosgraph

PATIENCE = 2  # so many questions in a row without an answer, and it is gone
RETRY = 0.5  # seconds of wall time after a question without an answer


class MasterWatch:
    """Asks the master for its process id now and then."""

    def __init__(self, name: str, period: float = 2.0) -> None:
        """Ask in the name of the node `name`, `period` so many seconds of wall time."""
        self._master = rosgraph.Master(name)
        self._period = period
        self._next = 0.0
        self._failures = 0
        self._pid: int | None = None

    def find_loss_reason(self) -> str:
        """Why this node has no master any more, or '' while it has; cheap to call often."""
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
        return "" if pid == self._pid else "the ROS master was restarted and does not know us"

    def watch(self, on_loss: Callable[[str], None]) -> None:
        """Look from a thread of its own, and call `on_loss` with the reason, once."""

        def run() -> None:
            while not (why := self.find_loss_reason()):
                time.sleep(RETRY)
            on_loss(why)

        threading.Thread(target=run, name="master watch", daemon=True).start()
