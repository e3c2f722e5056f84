"""Models of the tests of a stepped world."""

import math

from geometry_msgs.msg import Point, Quaternion

SLIDER = """<robot name="slider"><link name="world"/>
  <joint name="rail" type="prismatic">
    <parent link="world"/><child link="cart"/><origin xyz="0 0 1"/><axis xyz="1 0 0"/>
    <limit lower="-1" upper="2" effort="100" velocity="10"/><dynamics damping="0.5"/></joint>
  <joint name="bolt" type="fixed"><parent link="cart"/><child link="box"/></joint>
  <link name="cart"><inertial><origin xyz="0.1 0.2 0.3"/><mass value="2"/>
    <inertia ixx="1" iyy="1.1" izz="1.2" ixy="0.01" ixz="0.02" iyz="0.03"/></inertial></link>
  <link name="box"><collision><geometry><box size="1 1 1"/></geometry></collision></link>
</robot>"""
BALL = """<robot name="ball"><link name="ball"><inertial><mass value="2"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>"""
QUARTER = Quaternion(0.0, 0.0, math.sin(math.pi / 4), math.cos(math.pi / 4))  # about z


def xyz(message: Point) -> tuple[float, float, float]:
    return (message.x, message.y, message.z)
