"""Notices that the ROS master is gone: rospy itself would go on for ever without a word."""

from __future__ import annotations

import os
import threading
import xmlrpc.client
from collections.abc import Callable

import rospy


class MasterWatch:
    """Asks the master for its process id now and then, on a thread of its own."""

    def __init__(self, period: float, on_gone: Callable[[str], None]) -> None:
        """Ask every `period` s of wall time; `on_gone(why)` is called once."""
        self._period = period
        self._on_gone = on_gone
        self._uri = os.environ.get("ROS_MASTER_URI", "http://localhost:11311")
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="master watch", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Ask no more."""
        self._stop.set()

    def _pid(self) -> int | None:
        try:
            code, _, pid = xmlrpc.client.ServerProxy(self._uri).getPid(rospy.get_name())
        except (OSError, xmlrpc.client.Error):
            return None
        return pid if code == 1 else None

    def _run(self) -> None:
        first = self._pid()
        missed = 0
        while not self._stop.wait(self._period if not missed else 0.5):
            pid = self._pid()
            missed = missed + 1 if pid is None else 0
            if missed >= 2:
                self._on_gone(f"the ROS master at {self._uri} is gone; start it and launch anew")
                return
            first = first or pid
            if pid is not None and pid != first:
                self._on_gone(
                    f"the ROS master at {self._uri} was restarted and no longer knows this node; "
                    "launch anew"
                )
                return
