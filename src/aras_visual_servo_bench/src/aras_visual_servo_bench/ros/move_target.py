"""Command that moves a target of the simulation along a line, sine, circle, step or path.

    rosrun aras_visual_servo_bench move_target circle=0.02 frequency=0.2
    rosrun aras_visual_servo_bench move_target velocity='[0.01, 0, 0, 0, 0, 0.1]' begin=2
    rosrun aras_visual_servo_bench move_target path='[[2, 0.05, 0, 0], [4, 0.05, 0.03, 0]]'

The keys are those of an experiment's `target.motion`. The motion starts when this program starts,
at the pose that the target has at this time. The target is moved by Gazebo's service
`set_model_state`.
"""

from __future__ import annotations

import argparse
import sys

from aras_visual_servo_base.poses import Pose
from aras_visual_servo_base.settings import build

from ..errors import ExperimentError, StudyError, catch_setting_errors, require
from ..experiment.overrides import parse_overrides
from ..targets.geometry import TargetMotion

# Rate at which the target's pose is set, Hz in simulated time; twice the camera's image rate.
RATE = 60.0
SERVICE_TIMEOUT = 10.0  # longest time to wait for the services of the simulation, s


def parse_motion(arguments: list[str]) -> TargetMotion:
    """Return the motion that arguments of the form key=value describe.

    Raises:
        ExperimentError: an argument is invalid, or the target would not move.
    """
    with catch_setting_errors(StudyError):
        motion = build(TargetMotion, parse_overrides(arguments), "motion", ExperimentError)
    require(not motion.is_static,
            "the target does not move: give velocity, step or path, or give amplitude or circle "
            "together with frequency")
    return motion


def main(argv: list[str] | None = None) -> int:
    """Move the target until the program is stopped, and return the exit status."""
    parser = argparse.ArgumentParser(
        prog="move_target", description=__doc__.splitlines()[0],
        epilog="example: rosrun aras_visual_servo_bench move_target circle=0.02 frequency=0.2",
    )  # fmt: skip
    parser.add_argument("motion", nargs="*", metavar="key=value", help="velocity, circle, ...")
    parser.add_argument("--model", default="target", help="name of the model (default target)")
    arguments = [word for word in argv or sys.argv[1:] if ":=" not in word]
    options = parser.parse_args(arguments)
    try:
        motion = parse_motion(options.motion)
        return _move_target(motion, options.model)
    except ExperimentError as error:
        print(f"move_target: {error}", file=sys.stderr)
        return 1


def _move_target(motion: TargetMotion, model: str) -> int:
    import rospy
    from gazebo_msgs.msg import ModelState
    from gazebo_msgs.srv import GetModelState, SetModelState

    from aras_sim_bridge.ros.conversions import from_pose, to_pose
    from aras_visual_servo_ros.shutdown import init_node

    init_node("move_target", anonymous=True)
    try:
        rospy.wait_for_service("/gazebo/set_model_state", SERVICE_TIMEOUT)
    except rospy.ROSInterruptException:
        return 0
    except rospy.ROSException:
        raise ExperimentError(
            f"no simulation answers within {SERVICE_TIMEOUT:g} s: start it with roslaunch "
            "aras_visual_servo_gazebo aras_visual_servo.launch"
        ) from None
    found = rospy.ServiceProxy("/gazebo/get_model_state", GetModelState)(model, "")
    if not found.success:
        raise ExperimentError(
            f"the simulation has no model '{model}' ({found.status_message}): launch it with "
            "target:=four_dots, or use --model"
        )
    start_pose = from_pose(found.pose, model).matrix()
    set_state = rospy.ServiceProxy("/gazebo/set_model_state", SetModelState, persistent=True)
    start, rate = rospy.get_time(), rospy.Rate(RATE)
    while not rospy.is_shutdown():
        pose = Pose.from_matrix(motion.apply(start_pose, rospy.get_time() - start))
        state = ModelState(model_name=model, reference_frame="world")
        state.pose = to_pose(pose)
        try:
            set_state(state)
            rate.sleep()
        except (rospy.ServiceException, rospy.ROSInterruptException):
            break  # the simulation or this node has ended
    return 0
