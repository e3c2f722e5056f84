"""Command topics of the joint controllers: one topic for each joint, or one for the group."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence

import numpy as np
import rospy
from std_msgs.msg import Float64, Float64MultiArray
from std_srvs.srv import Trigger

from aras_visual_servo_ros.parameters import get_namespace

from ..kinematics.ros_control_controllers import choose_controllers
from ..settings import ControllerSettings

STOP_TIMEOUT = 0.5  # longest wait for the controller node's service, s of wall time
# Number of commands that can wait for a slow connection. Controllers use only the last command, but
# recorders need all.
QUEUE_SIZE = 10


class CommandPublishers:
    """Publishers of one arm's commands.

    There is one topic for the controller of each joint, or one topic for the controller of all.

    Attributes:
        is_self_subscribed: whether this node itself subscribes to the topics.
    """

    def __init__(self, settings: ControllerSettings, names: Sequence[str], kind: str) -> None:
        """Find the controllers of the joints in their parameters, and advertise the topics.

        Args:
            settings: settings with the namespace and the names of controllers.
            names: names of the joints, in the order of the values that are sent.
            kind: type of the commands: 'position', 'velocity' or 'effort'.

        Raises:
            ConfigurationError: the controllers of a joint accept other commands only.
        """
        namespace, group = settings.namespace.rstrip("/"), settings.command_topic
        self._names, self.is_self_subscribed = tuple(names), False
        self._order = range(len(names))
        self._group_publisher: rospy.Publisher | None = None
        self._joint_publishers: dict[str, rospy.Publisher] = {}
        if group:
            topic = group if group.startswith("/") else f"{namespace}/{group}"
            self._group_publisher = rospy.Publisher(topic, Float64MultiArray, queue_size=QUEUE_SIZE)
            return
        found = choose_controllers(
            get_namespace(namespace or "/"), names, kind, settings.controllers, namespace
        )
        if found[0].is_group:
            topic = f"{namespace}/{found[0].name}/command"
            self._order = [list(names).index(joint) for joint in found[0].joints]
            self._group_publisher = rospy.Publisher(topic, Float64MultiArray, queue_size=QUEUE_SIZE)
            return
        for name, one in zip(names, found, strict=True):
            topic = f"{namespace}/{one.name}/command"
            self._joint_publishers[name] = rospy.Publisher(topic, Float64, queue_size=QUEUE_SIZE)

    def send(self, values: np.ndarray, joint: str = "") -> None:
        """Publish values (n,) for the controllers.

        Args:
            values: values of all joints: positions in rad or m, velocities in rad/s or m/s, or
                efforts in N m or N.
            joint: name of the only joint to command; '' for all. A group controller always gets all
                values.
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
        """Iterate over the command topics, each with the names of the joints that it commands."""
        for name, publisher in self._joint_publishers.items():
            yield publisher.resolved_name, (name,)
        if self._group_publisher is not None:
            yield self._group_publisher.resolved_name, self._names

    def list_unsubscribed(self) -> list[str]:
        """Return the command topics that have no subscribers apart from this node."""
        publishers = [
            p for p in (*self._joint_publishers.values(), self._group_publisher) if p is not None
        ]
        own = int(self.is_self_subscribed)
        return [p.resolved_name for p in publishers if p.get_num_connections() <= own]

    def close(self) -> None:
        """Unregister all publishers."""
        for publisher in (*self._joint_publishers.values(), self._group_publisher):
            if publisher is not None:
                publisher.unregister()


def publish(publisher: rospy.Publisher, message: object) -> None:
    """Publish a message, unless the shutdown of the node has closed the topic."""
    try:
        publisher.publish(message)
    except rospy.ROSException:
        if not rospy.core.is_shutdown_requested():
            raise


def stop_controller(namespace: str) -> bool:
    """Stop the controller node in a namespace, because it also commands the joints.

    Return whether its service answered.
    """
    with contextlib.suppress(rospy.ROSException, rospy.ServiceException, OSError):
        name = f"{namespace}/controller/stop"
        rospy.wait_for_service(name, STOP_TIMEOUT)
        rospy.ServiceProxy(name, Trigger)()
        return True
    return False
