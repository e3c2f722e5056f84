"""Publication of the goal, as a camera pose and as the target's desired outline."""

from __future__ import annotations

import numpy as np
import rospy
from geometry_msgs.msg import Point, Point32, PolygonStamped, PoseStamped, Quaternion

from aras_visual_servo_base.poses import Pose

from ..loop.servo import Servo


class GoalPublishers:
    """Latched publishers of the camera pose at the goal and of the target's desired outline.

    The outline is the one that the camera sees from the goal.
    """

    def __init__(self, namespace: str) -> None:
        """Advertise the topics in `namespace`."""
        self._pose_publisher = rospy.Publisher(
            f"{namespace}/controller/goal", PoseStamped, latch=True, queue_size=1
        )
        self._outline_publisher = rospy.Publisher(
            f"{namespace}/controller/desired_outline", PolygonStamped, latch=True, queue_size=1
        )

    def publish(self, servo: Servo) -> None:
        """Publish the camera pose at the loop's goal, if it is known, and the desired outline."""
        if servo.unreachable_reason:
            rospy.logwarn("%s; the arm goes as near as it can", servo.unreachable_reason)
        arm, pose = servo.arm, servo.differential_ik.goal
        if pose is not None:
            self._pose_publisher.publish(
                make_pose_message(pose, arm.target_frame or arm.base_frame)
            )
        self._outline_publisher.publish(
            make_outline_message(servo.goal.compute_outline(), arm.camera_frame)
        )


def make_pose_message(a_T_b: np.ndarray, frame: str) -> PoseStamped:
    """Convert a pose a_T_b (4, 4) to geometry_msgs/PoseStamped in the frame a."""
    message = PoseStamped()
    message.header.frame_id = frame
    pose = Pose.from_matrix(a_T_b)
    message.pose.position, message.pose.orientation = Point(*pose.xyz), Quaternion(*pose.quat)
    return message


def make_outline_message(outline: np.ndarray, frame: str) -> PolygonStamped:
    """Convert a normalised outline (n, 2) to geometry_msgs/PolygonStamped.

    The polygon is in the plane z = 1 of the camera frame.
    """
    message = PolygonStamped()
    message.header.frame_id = frame
    message.polygon.points = [Point32(float(x), float(y), 1.0) for x, y in outline]
    return message
