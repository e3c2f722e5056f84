"""Detection and reading of the robot description on the parameter server."""

from __future__ import annotations

import math
import time

import rospy

from aras_visual_servo_base import safe_xml

PERIOD = 0.2  # wall time between two checks for a new robot description, s


class DescriptionWatch:
    """Detection of a new robot description.

    A description is new at the start, and after a robot has been started again.
    """

    def __init__(self, parameter: str) -> None:
        self._parameter = parameter
        self._urdf, self._has_warned = "", False
        self._start_count, self._check_time = 0, -math.inf

    def find_new(self, start_count: int | None) -> str:
        """Return a robot description that was not returned before; '' if there is none.

        Args:
            start_count: how often joint states have started to arrive, which increases if the robot
                is restarted; None if there is no loop yet.
        """
        now = time.monotonic()
        if start_count == self._start_count or now - self._check_time < PERIOD:
            return ""
        self._check_time = now
        try:
            urdf = str(rospy.get_param(self._parameter, ""))
        except OSError:
            return ""  # the ROS master is not reachable, which the node reports elsewhere
        if urdf and urdf != self._urdf:
            self._urdf, self._start_count = urdf, 0
            return urdf
        if not urdf and not self._has_warned:
            self._has_warned = True
            rospy.logwarn("waiting: no robot description on parameter %s yet", self._parameter)
        elif start_count is not None:
            self._start_count = start_count
        return ""


def find_e_stop_topic(urdf: str, namespace: str) -> str:
    """Return the topic (std_msgs/Bool) of the robot's emergency stop; '' if there is none.

    Raises:
        DescriptionError: the description cannot be read.
    """
    plugins = safe_xml.parse(urdf, "URDF").iter("eStopTopic")
    topic = next((plugin.text.strip() for plugin in plugins if plugin.text), "")
    return topic if not topic or topic.startswith("/") else f"{namespace.rstrip('/')}/{topic}"
