"""Static transforms of camera frames that robot_state_publisher does not publish.

robot_state_publisher only publishes frames that are links of a URDF. This is not the case for a
camera that is fixed in the world, or if the settings of a camera name another optical frame. The
bridge publishes such frames on /tf_static. One message contains all of them, because a latched
topic only keeps the last message.
"""

from __future__ import annotations

import threading

import numpy as np
import rospy
from geometry_msgs.msg import TransformStamped
from tf2_msgs.msg import TFMessage

from aras_sim_bridge.camera.mounting import MountedCamera
from aras_sim_bridge.ros.camera.info import add_prefix
from aras_visual_servo_base.poses import quaternion_from_matrix

_lock = threading.Lock()
_transforms: dict[str, TransformStamped] = {}
_publisher: rospy.Publisher | None = None


def announce(
    mounted: MountedCamera, parent_T_optical: np.ndarray, frame_id: str, namespace: str
) -> bool:
    """Publish the optical frame of a camera unless the URDF contains it.

    Return whether the frame is published.

    `parent_T_optical` (4, 4) is the pose of the optical frame in the link of the camera.
    """
    name = mounted.sensor.config.optical_frame_name
    if not name or (mounted.model is not None and name in mounted.model.description.links):
        return False
    message = TransformStamped()
    message.header.frame_id = add_prefix(mounted.link, namespace)
    message.child_frame_id = frame_id
    p, q = message.transform.translation, message.transform.rotation
    p.x, p.y, p.z = map(float, parent_T_optical[:3, 3])
    q.x, q.y, q.z, q.w = quaternion_from_matrix(parent_T_optical[:3, :3])
    with _lock:
        _transforms[frame_id] = message
        _publish()
    return True


def withdraw(frame_id: str) -> None:
    """Stop publishing a frame; tf buffers that have received the frame still contain it."""
    with _lock:
        if _transforms.pop(frame_id, None) is not None:
            _publish()


def close() -> None:
    """Withdraw all frames and close /tf_static; a frame that is announced later opens it again."""
    global _publisher
    with _lock:
        _transforms.clear()
        if _publisher is not None:
            _publisher.unregister()
            _publisher = None


def _publish() -> None:
    global _publisher
    if _publisher is None:
        _publisher = rospy.Publisher("/tf_static", TFMessage, latch=True, queue_size=10)
    _publisher.publish(TFMessage(list(_transforms.values())))
