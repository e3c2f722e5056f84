"""Topics that the joints' controllers are commanded by: one each, or one for the group."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence

import numpy as np
import rospy
from std_msgs.msg import Float64, Float64MultiArray
from std_srvs.srv import Trigger

from aras_visual_servo_ros.parameters import get_namespace

from ..kinematics.joint_controllers import choose_controllers
from ..settings import Settings

STOP_TIMEOUT = 0.5  # s of wall time for the controller's services to be there
# commands that wait for a slow connection; the last one counts, a recorder wants all
QUEUE_SIZE = 10


class CommandTopics:
    """Publishers of one arm's commands: to each joint's controller, or to one for all.

    Attributes:
        echoed: whether this node itself subscribes to them.
    """

    def __init__(self, settings: Settings, names: Sequence[str], kind: str) -> None:
        """Find who takes them, by the parameters of the controllers.

        Args:
            settings: where, and which controllers.
            names: of the joints, in the order of the numbers that are put.
            kind: of the commands: 'position', 'velocity' or 'effort'.

        Raises:
            ConfigurationError: a joint whose controllers take other commands.
        """
        space, group = settings.namespace.rstrip("/"), settings.command_topic
        self._names, self.is_self_subscribed = tuple(names), False
        self._order = range(len(names))
        self._group_publisher: rospy.Publisher | None = None
        self._joint_publishers: dict[str, rospy.Publisher] = {}
        if group:
            topic = group if group.startswith("/") else f"{space}/{group}"
            self._group_publisher = rospy.Publisher(topic, Float64MultiArray, queue_size=QUEUE_SIZE)
            return
        found = choose_controllers(
            get_namespace(space or "/"), names, kind, settings.controllers, space
        )
        if found[0].is_group:
            topic = f"{space}/{found[0].name}/command"
            self._order = [list(names).index(joint) for joint in found[0].joints]
            self._group_publisher = rospy.Publisher(topic, Float64MultiArray, queue_size=QUEUE_SIZE)
            return
        for name, one in zip(names, found, strict=True):
            topic = f"{space}/{one.name}/command"
            self._joint_publishers[name] = rospy.Publisher(topic, Float64, queue_size=QUEUE_SIZE)

    def send(self, values: np.ndarray, joint: str = "") -> None:
        """Numbers (n,): m and rad, m/s and rad/s, or N and N m, whichever the controllers take.

        only: name of the joint that is commanded alone; a group gets all numbers all the same.
        """
        numbers = values.tolist()
        if self._group_publisher is not None:
            publish(
                self._group_publisher, Float64MultiArray(data=[numbers[i] for i in self._order])
            )
        for (name, publisher), value in zip(self._joint_publishers.items(), numbers, strict=False):
            if joint in ("", name):
                publish(publisher, Float64(value))

    def list_topics(self) -> Iterator[tuple[str, tuple[str, ...]]]:
        """Each topic with the joints that it commands."""
        for name, publisher in self._joint_publishers.items():
            yield publisher.resolved_name, (name,)
        if self._group_publisher is not None:
            yield self._group_publisher.resolved_name, self._names

    def list_unsubscribed(self) -> list[str]:
        """Topics of commands to which nobody listens, this node itself left out."""
        publishers = [
            p for p in (*self._joint_publishers.values(), self._group_publisher) if p is not None
        ]
        own = int(self.is_self_subscribed)
        return [p.resolved_name for p in publishers if p.get_num_connections() <= own]

    def close(self) -> None:
        """Publish no more."""
        for publisher in (*self._joint_publishers.values(), self._group_publisher):
            if publisher is not None:
                publisher.unregister()


def publish(publisher: rospy.Publisher, message: object) -> None:
    """Publish, but not into topics that the shutdown has closed while we were computing."""
    try:
        publisher.publish(message)
    except rospy.ROSException:
        if not rospy.core.is_shutdown_requested():
            raise


def stop_controller(namespace: str) -> bool:
    """Have the controller of a namespace, which would command the joints as well, stop; whether it
    answered."""
    with contextlib.suppress(rospy.ROSException, rospy.ServiceException, OSError):
        name = f"{namespace}/controller/stop"
        rospy.wait_for_service(name, STOP_TIMEOUT)
        rospy.ServiceProxy(name, Trigger)()
        return True
    return False
