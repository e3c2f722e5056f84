"""Topics that the joints' controllers are commanded by: one each, or one for the group."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence

import numpy as np
import rospy
from std_msgs.msg import Float64, Float64MultiArray
from std_srvs.srv import Trigger

from ..settings import Settings

STOPPING = 0.5  # s of wall time for the controller's services to be there
KEPT = 10  # commands that wait for a slow connection; the last one counts, a recorder wants all


class CommandTopics:
    """Publishers of one arm's commands."""

    def __init__(self, settings: Settings, names: Sequence[str]) -> None:
        """`names`: of the joints, in the order of the numbers that are put."""
        space, group = settings.namespace.rstrip("/"), settings.command_topic
        self._group: rospy.Publisher | None = None
        self._each: list[rospy.Publisher] = []
        if group:
            topic = group if group.startswith("/") else f"{space}/{group}"
            self._group = rospy.Publisher(topic, Float64MultiArray, queue_size=KEPT)
            return
        for name in names:
            controller = settings.controllers.get(name, f"{name}_{settings.output}_controller")
            topic = f"{space}/{controller}/command"
            self._each.append(rospy.Publisher(topic, Float64, queue_size=KEPT))

    def put(self, values: np.ndarray) -> None:
        """Numbers (n,): m and rad, m/s and rad/s, or N and N m, whichever the controllers take."""
        numbers = values.tolist()
        if self._group is not None:
            publish(self._group, Float64MultiArray(data=numbers))
        for publisher, value in zip(self._each, numbers, strict=False):
            publish(publisher, Float64(value))

    def close(self) -> None:
        """Publish no more."""
        for publisher in (*self._each, self._group):
            if publisher is not None:
                publisher.unregister()


def publish(publisher: rospy.Publisher, message: object) -> None:
    """Publish, but not into topics that the shutdown has closed while we were computing."""
    try:
        publisher.publish(message)
    except rospy.ROSException:
        if not rospy.core.is_shutdown_requested():
            raise


def stop_controller(space: str) -> bool:
    """Have the controller of a namespace, which would command the joints as well, stop; whether it
    answered."""
    with contextlib.suppress(rospy.ROSException, rospy.ServiceException, OSError):
        name = f"{space}/controller/stop"
        rospy.wait_for_service(name, STOPPING)
        rospy.ServiceProxy(name, Trigger)()
        return True
    return False
