"""A target of one's own on the graph: in the place of the plates, and drawn."""

import cv2
import numpy as np
import rospy
from gazebo_msgs.srv import GetModelProperties, GetWorldProperties
from ros_graph import wait_for, wait_for_message
from sensor_msgs.msg import Image

from aras_visual_servo_camera.trackers import MarkerTracker


def asked(service, kind, *arguments):
    rospy.wait_for_service(service, 20.0)
    return rospy.ServiceProxy(service, kind)(*arguments)


def picture():
    message = wait_for_message("/labrob/camera/image_raw", Image, 20.0)
    rows = np.frombuffer(message.data, np.uint8).reshape(message.height, message.width, -1)
    return cv2.cvtColor(rows, cv2.COLOR_RGB2GRAY)


def test_it_takes_the_place_of_the_plates(launch, ros_node):
    launch(
        "aras_visual_servo_gazebo", "aras_visual_servo.launch", nodes=["/gazebo"],
        target="marker", target_place="-x 0 -y 0 -z 0.591 -Y 0.5",
    )  # fmt: skip

    def spawned():
        return asked("/gazebo/get_world_properties", GetWorldProperties).model_names

    wait_for(lambda: {"target", "aras_visual_servo"} <= set(spawned()), 30.0, "target and robot")
    robot = asked("/gazebo/get_model_properties", GetModelProperties, "aras_visual_servo")
    assert not any("planar_object" in name for name in robot.body_names)

    assert len(MarkerTracker().find(picture())) == 4
