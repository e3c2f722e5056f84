"""Program that keeps controllers stopped while it runs, and starts them again on exit."""

from __future__ import annotations

import argparse
import sys

import rospy
from controller_manager_msgs.srv import (
    ListControllers,
    SwitchController,
    SwitchControllerRequest,
)

from aras_visual_servo_ros.shutdown import init_node

BEST_EFFORT = 1
PERIOD = 3.0  # interval between two checks of the running controllers, s of wall time


def main() -> int:
    """Run the unspawner and return its exit status."""
    parser = argparse.ArgumentParser(
        prog="unspawner", description=__doc__,
        epilog="example: rosrun aras_sim_bridge unspawner "
        "joint1_position_controller __ns:=/my_robot",
    )  # fmt: skip
    parser.add_argument("controllers", nargs="+", help="controller names")
    names = parser.parse_args(rospy.myargv(sys.argv)[1:]).controllers
    init_node("unspawner", anonymous=True)
    try:
        for service in ("switch_controller", "list_controllers"):
            rospy.wait_for_service(f"controller_manager/{service}")
    except rospy.ROSException:
        return 1
    switch = rospy.ServiceProxy("controller_manager/switch_controller", SwitchController)
    list_all = rospy.ServiceProxy("controller_manager/list_controllers", ListControllers)
    stopped: list[str] = []

    def restart() -> None:
        if not stopped:
            return
        try:
            switch(SwitchControllerRequest(start_controllers=stopped, strictness=BEST_EFFORT))
        except (rospy.ServiceException, rospy.ROSException, OSError):
            rospy.logwarn("controllers %s are not started again: the simulator has "
                          "ended", ", ".join(stopped))

    rospy.on_shutdown(restart)
    while not rospy.is_shutdown():
        try:
            running = [c.name for c in list_all().controller if c.state == "running"]
            to_stop = [name for name in names if name in running]
            if to_stop:
                switch(SwitchControllerRequest(stop_controllers=to_stop, strictness=BEST_EFFORT))
                stopped.extend(name for name in to_stop if name not in stopped)
        except rospy.ServiceException as error:
            rospy.logwarn_once("the controller manager does not answer: %s; spawn the robot, and "
                               "set __ns to its namespace", error)
        waited = 0.0
        while waited < PERIOD and not rospy.is_shutdown():
            rospy.rostime.wallsleep(0.1)
            waited += 0.1
    return 0
