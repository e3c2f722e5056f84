"""/gazebo/real_time_factor: how fast simulated time goes, once a second of wall time."""

from __future__ import annotations

import threading
from collections.abc import Callable

import rospy
from std_msgs.msg import Float64

PERIOD = 1.0  # seconds of wall time


class RealTimeFactor:
    """Publishes on a thread of its own, also while the simulation is paused."""

    def __init__(self, measure: Callable[[], float]) -> None:
        """`measure()` gives the factor: 1 is real time, 0 is standing still."""
        self._measure = measure
        self._publisher = rospy.Publisher("/gazebo/real_time_factor", Float64, queue_size=1)
        self._stop = threading.Event()
        rospy.on_shutdown(self._stop.set)
        threading.Thread(target=self._run, name="real-time factor", daemon=True).start()

    def _run(self) -> None:
        while not self._stop.wait(PERIOD):
            if self._publisher.get_num_connections():
                self._publisher.publish(self._measure())
