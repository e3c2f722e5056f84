"""Launch files written for Gazebo run unchanged; their package names are found here, too.

This one is shaped as the original's first generation, its parts launched one by one and its
description made by xacro; test_second_generation.py has the other.
"""

from pathlib import Path

import pytest
import rospy
from ros_graph import wait_for
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_msgs.msg import Float64

TREES = Path(__file__).parents[1] / "conformance"


@pytest.fixture(scope="module")
def first_generation(launch, ros_node):
    """World and robot by one launch file, controllers by another."""
    launch(str(TREES / "first_generation/arm_gazebo.launch"), nodes=["/gazebo"], gui=False)
    launch(str(TREES / "first_generation/arm_control.launch"), nodes=["/robot_state_publisher"])


def test_the_description_came_through_xacro(first_generation):
    text = rospy.get_param("robot_description")
    assert 'xyz="0 0 0.3"' in text  # reach:=0.3 of the command line
    assert "xacro:" not in text


def test_controllers_follow_commands(first_generation, collect):
    states = collect("/arm/joint_states", JointState)
    states.wait(2, 60.0)
    command = rospy.Publisher("/arm/elbow_position_controller/command", Float64, queue_size=1)
    wait_for(lambda: command.get_num_connections() == 1, 10.0, "the controller listens")
    command.publish(0.4)

    def elbow() -> float:
        last = states.messages[-1]
        return last.position[last.name.index("elbow")]

    wait_for(lambda: abs(elbow() - 0.4) < 0.02, 20.0, "the elbow arrives")


def test_its_camera_is_there(first_generation, collect):
    image = collect("/arm/eye/image_raw", Image).wait(1, 30.0)
    info = collect("/arm/eye/camera_info", CameraInfo).wait(1, 30.0)
    assert (image.width, image.height, info.header.frame_id) == (64, 48, "eye")
