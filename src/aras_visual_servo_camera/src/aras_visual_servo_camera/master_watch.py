"""Notice that the ROS master has gone: rospy itself would wait for ever."""

import time

import rosgraph

PATIENCE = 3


class MasterWatch:
    """Asks the master for its process id now and then."""

    def __init__(self, name: str, every: float = 2.0) -> None:
        self._master = rosgraph.Master(name)
        self._every = every
        self._next = 0.0
        self._failures = 0
        self._pid: int | None = None

    def lost(self) -> str:
        """Why this node has no master any more, or '' while it has; cheap to call often."""
        now = time.monotonic()
        if now < self._next:
            return ""
        self._next = now + self._every
        try:
            pid = self._master.getPid()
        except (OSError, rosgraph.MasterException):
            self._failures += 1
            if self._failures < PATIENCE:
                return ""
            return "the ROS master does not answer any more"
        self._failures = 0
        if self._pid is None:
            self._pid = pid
        return "" if pid == self._pid else "the ROS master was restarted and does not know us"
