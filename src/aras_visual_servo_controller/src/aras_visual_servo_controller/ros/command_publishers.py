"""Command topics of the joint controllers: one topic for each joint, or one for the group."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence

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
        self.is_self_subscribed = False
        if group:
            topic = group if group.startswith("/") else f"{namespace}/{group}"
            topics, self._is_group = [(topic, tuple(names))], True
        else:
            found = choose_controllers(
                get_namespace(namespace or "/"), names, kind, settings.controllers, namespace
            )
            topics = [(f"{namespace}/{one.name}/command", one.joints) for one in found]
            self._is_group = found[0].is_group
        self._rows = {name: row for row, name in enumerate(names)}
        message = Float64MultiArray if self._is_group else Float64
        # each publisher, with the joints that its controller commands
        self._publishers = [
            (rospy.Publisher(topic, message, queue_size=QUEUE_SIZE), joints)
            for topic, joints in topics
        ]

    def send(self, values: np.ndarray, joint: str = "") -> None:
        """Publish values (n,) for the controllers.

        Args:
            values: values of all joints: positions in rad or m, velocities in rad/s or m/s, or
                efforts in N m or N.
            joint: name of the only joint to command; '' for all. A group controller always gets all
                values.
        """
        for publisher, joints in self._publishers:
            numbers = [float(values[self._rows[name]]) for name in joints]
            if self._is_group:
                publish(publisher, Float64MultiArray(data=numbers))
            elif joint in ("", *joints):
                publish(publisher, Float64(*numbers))

    def list_topics(self) -> list[tuple[str, tuple[str, ...]]]:
        """Return the command topics, each with the names of the joints that it commands."""
        return [(publisher.resolved_name, joints) for publisher, joints in self._publishers]

    def list_unsubscribed(self) -> list[str]:
        """Return the command topics that have no subscribers apart from this node."""
        own = int(self.is_self_subscribed)
        return [publisher.resolved_name for publisher, _ in self._publishers
                if publisher.get_num_connections() <= own]

    def close(self) -> None:
        """Unregister all publishers."""
        for publisher, _ in self._publishers:
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
