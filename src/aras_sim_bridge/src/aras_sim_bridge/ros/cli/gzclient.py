"""gzclient: Gazebo's window. There is none here; says what to look at the world with instead."""

from __future__ import annotations

import rospy

from aras_visual_servo_ros.shutdown import init_node


def main() -> int:
    """Say so and stay, as launch files may require the node; returns the exit status."""
    init_node("gazebo_gui", __doc__, anonymous=True, disable_rostime=True)
    rospy.loginfo("there is no Gazebo window: look with rviz, or start with gui:=true for Bullet's")
    rospy.spin()
    return 0
