"""Calls of the Gazebo services, and models that several test files spawn."""

import math
from collections.abc import Iterator
from contextlib import contextmanager

import rospy
from aras_sim_bridge.srv import StepWorld
from gazebo_msgs.srv import DeleteModel, GetModelState, SpawnModel
from geometry_msgs.msg import Point, Pose, Quaternion
from std_srvs.srv import Empty

INERTIA = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
BRICK = """<sdf version="1.6"><model name="brick"><link name="brick">
  <inertial><mass>2</mass><inertia><ixx>1</ixx><iyy>1</iyy><izz>1</izz></inertia></inertial>
  <collision name="c"><geometry><box><size>.2 .2 .2</size></box></geometry></collision>
</link></model></sdf>"""
# Looks straight down from 3 m at a white plate on a box.
EYE = f"""<robot name="eye"><link name="world"/>
  <joint name="j" type="fixed"><parent link="world"/><child link="eye"/>
    <origin xyz="0 0 3" rpy="0 {math.pi / 2} 0"/></joint><link name="eye"/>
  <gazebo reference="eye"><sensor type="camera" name="eye"><update_rate>100</update_rate>
    <camera><horizontal_fov>0.5</horizontal_fov><image><width>32</width><height>24</height>
    <format>R8G8B8</format></image><clip><near>0.1</near><far>10</far></clip></camera>
    <plugin name="p" filename="libgazebo_ros_camera.so"><cameraName>eye</cameraName>
      <imageTopicName>image_raw</imageTopicName><cameraInfoTopicName>camera_info
      </cameraInfoTopicName><frameName>eye</frameName></plugin></sensor></gazebo></robot>"""
ARM = f"""<robot name="arm"><link name="world"/>
  <joint name="swing" type="revolute"><parent link="world"/><child link="rod"/>
    <axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="50" velocity="10"/></joint>
  <link name="rod"><inertial><mass value="1"/>{INERTIA}</inertial></link>
  <transmission name="t"><type>transmission_interface/SimpleTransmission</type>
    <joint name="swing"><hardwareInterface>hardware_interface/EffortJointInterface
    </hardwareInterface></joint>
    <actuator name="m"><mechanicalReduction>1</mechanicalReduction></actuator></transmission>
  <gazebo><plugin name="c" filename="libgazebo_ros_control.so">
    <robotNamespace>/arm</robotNamespace></plugin></gazebo></robot>"""


def call(name: str, service: type, *args: object, **fields: object) -> object:
    """Call a service, below /gazebo unless its name is absolute."""
    name = name if name.startswith("/") else f"/gazebo/{name}"
    rospy.wait_for_service(name, 20.0)
    return rospy.ServiceProxy(name, service)(*args, **fields)


@contextmanager
def time_goes_on() -> Iterator[None]:
    """Unpause a paused simulation for the duration of the `with` block."""
    call("unpause_physics", Empty)
    try:
        yield
    finally:
        call("pause_physics", Empty)


def step(count: int) -> None:
    assert call("step_world", StepWorld, count).success


def at(x: float, y: float, z: float, yaw: float = 0.0) -> Pose:
    return Pose(Point(x, y, z), Quaternion(0, 0, math.sin(yaw / 2), math.cos(yaw / 2)))


def spawn(name: str, xml: str, kind: str = "urdf", **fields: object) -> None:
    answer = call(f"spawn_{kind}_model", SpawnModel, model_name=name, model_xml=xml, **fields)
    assert answer.success, answer.status_message


def delete(*names: str) -> None:
    for name in names:
        assert call("delete_model", DeleteModel, name).success


def place(name: str) -> tuple:
    p = call("get_model_state", GetModelState, name, "").pose.position
    return (p.x, p.y, p.z)
