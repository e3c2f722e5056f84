"""Inputs of the loop: joint states, and the images or measurements that the scheme needs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import rospy
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool

from ..runner.loop_runner import LoopRunner
from ..settings import ControllerSettings
from .camera_subscribers import IMAGE_NEEDS, CameraSubscribers
from .detection_subscribers import DetectionSubscribers

if TYPE_CHECKING:
    from aras_visual_servo_camera.camera_node import CameraNode


class LoopSubscribers:
    """Subscribers to the inputs of one loop."""

    def __init__(
        self, settings: ControllerSettings, runner: LoopRunner, e_stop: str = "",
        camera_node: CameraNode | None = None,
    ) -> None:
        """Subscribe to the topics.

        Args:
            settings: settings of the loop.
            runner: loop that receives the inputs.
            e_stop: topic of the arm's emergency stop; '' if there is none.
            camera_node: camera node of this process, which passes on its moments; None for topics.
        """
        self._runner, self._camera_node = runner, camera_node
        topic = f"{settings.namespace.rstrip('/')}/joint_states"
        joints = rospy.Subscriber(
            topic, JointState, self._on_joints, tcp_nodelay=True,
            queue_size=10 if settings.lockstep else 1,
        )  # fmt: skip
        self._subscribers = [joints]
        for name, observer in runner.camera_rig.observers.items():
            camera = settings.get_camera(name)
            if observer.needs & IMAGE_NEEDS:
                self._subscribers += CameraSubscribers(camera, runner, observer).subscribers
            else:
                measurements = DetectionSubscribers(camera, runner, observer, camera_node)
                self._subscribers += measurements.subscribers
        if e_stop:
            self._subscribers.append(rospy.Subscriber(
                e_stop, Bool, lambda message: runner.emergency_stop(message.data)
            ))  # fmt: skip

    def close(self) -> None:
        """Unregister all subscribers."""
        if self._camera_node is not None:
            self._camera_node.on_moments = None
        for subscriber in self._subscribers:
            subscriber.unregister()

    def _on_joints(self, message: JointState) -> None:
        stamp = message.header.stamp.to_sec()
        self._runner.add_joint_state(message.name, message.position, message.velocity, stamp)
