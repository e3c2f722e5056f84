"""A user's target model on the graph: named on the command line, detected, and moved."""

import cv2
import numpy as np
import rospy
from gazebo_msgs.msg import ModelState
from gazebo_msgs.srv import GetModelProperties, GetModelState, GetWorldProperties, SetModelState
from ros_graph import wait_for, wait_for_message
from sensor_msgs.msg import Image

OUTLINE = '<svg><polygon points="0,0 60,0 60,20 20,20 20,60 0,60"/></svg>'
SIZE = 0.06  # m


def asked(service, kind, *arguments):
    rospy.wait_for_service(service, 20.0)
    return rospy.ServiceProxy(service, kind)(*arguments)


def dark():
    """Pixels (n, 2), row and column, of what is dark on the table."""
    message = wait_for_message("/labrob/camera/image_raw", Image, 20.0)
    rows = np.frombuffer(message.data, np.uint8).reshape(message.height, message.width, -1)
    return np.argwhere(cv2.cvtColor(rows, cv2.COLOR_RGB2GRAY) < 100)


def test_an_outline_on_the_launch_line_lies_on_the_table_and_can_be_moved(
    launch, ros_node, tmp_path
):
    outline = tmp_path / "mine.svg"
    outline.write_text(OUTLINE)
    launch(
        "aras_visual_servo_gazebo", "aras_visual_servo.launch", nodes=["/gazebo"],
        target=str(outline), target_size=f"{SIZE} {SIZE}", target_place="-x 0 -y 0 -z 0.591 -Y 0.5",
    )  # fmt: skip

    def spawned():
        return asked("/gazebo/get_world_properties", GetWorldProperties).model_names

    wait_for(lambda: {"target", "aras_visual_servo"} <= set(spawned()), 40.0, "target and robot")
    robot = asked("/gazebo/get_model_properties", GetModelProperties, "aras_visual_servo")
    assert not any("planar_object" in name for name in robot.body_names)

    # f = 102.73 px, 0.191 m above it; the L covers 5/9 of its square
    wait_for(lambda: len(dark()) > 100, 20.0, "the target")
    there = dark()
    assert abs(len(there) / (5 / 9 * (SIZE * 102.73 / 0.191) ** 2) - 1.0) < 0.05

    moved = ModelState(model_name="target", reference_frame="world")
    moved.pose = asked("/gazebo/get_model_state", GetModelState, "target", "").pose
    assert abs(moved.pose.position.z - 0.591) < 1e-9
    moved.pose.position.x += 0.02
    assert asked("/gazebo/set_model_state", SetModelState, moved).success
    shift = 0.02 * 102.73 / 0.191

    def way():
        return float(np.linalg.norm(dark().mean(axis=0) - there.mean(axis=0)))

    wait_for(lambda: way() > 5.0, 20.0, "the moved target")
    assert abs(way() - shift) < 0.3
