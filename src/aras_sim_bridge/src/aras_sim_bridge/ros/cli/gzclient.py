"""Replacement of gzclient, Gazebo's window; it names the programs that display the world."""

from __future__ import annotations

import rospy

from aras_visual_servo_ros.shutdown import init_node


def main() -> int:
    """Log the names of the programs that display the world, and wait for shutdown.

    The program must not end at once, because a launch file may require the node to run. Return
    the exit status.
    """
    init_node("gazebo_gui", __doc__, anonymous=True, disable_rostime=True)
    rospy.loginfo("Gazebo's window is not available; use rviz, or gui:=true for Bullet's window")
    rospy.spin()
    return 0
