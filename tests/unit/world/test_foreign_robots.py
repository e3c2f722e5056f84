"""Robots of PyBullet's data package together with the ARAS robot in one Simulation.

Their files carry no transmissions and no control plugin; the tests add them, as their users would.
"""

import math
import os
import re
from xml.etree import ElementTree

import numpy as np
import pybullet_data
import pytest
from aras_robot import CONTROLLERS, ArasRobot

from aras_sim_bridge.control.controllers.trajectory_types import Trajectory, TrajectoryPoint
from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.world import Pose

WHEEL_RADIUS = 0.17775  # of husky.urdf's collision cylinders
WHEELS = ("front_left_wheel", "front_right_wheel", "rear_left_wheel", "rear_right_wheel")
ARM = tuple(f"panda_joint{k}" for k in range(1, 8))
FINGERS = ("panda_finger_joint1", "panda_finger_joint2")


def with_control(path, interfaces, namespace, bolted_by=None):
    """A description of pybullet_data's file with a control plugin and transmissions added.

    bolted_by: root link to fix to the world, as ROS's robots do it.
    """
    full = os.path.join(pybullet_data.getDataPath(), path)
    with open(full, encoding="utf-8") as file:
        # husky.urdf holds a rest of xacro: $(optenv NAME default)
        root = ElementTree.fromstring(re.sub(r"\$\(optenv \w+ ([^)]*)\)", r"\1", file.read()))
    if bolted_by is not None:
        root.append(ElementTree.fromstring('<link name="world"/>'))
        root.append(ElementTree.fromstring(
            f'<joint name="bolts" type="fixed"><parent link="world"/><child link="{bolted_by}"/>'
            "</joint>"))
    for element in root.findall("transmission"):
        root.remove(element)
    for joint, interface in interfaces.items():
        root.append(ElementTree.fromstring(
            f'<transmission name="{joint}_transmission">'
            "<type>transmission_interface/SimpleTransmission</type>"
            f'<joint name="{joint}"><hardwareInterface>hardware_interface/{interface}'
            f'</hardwareInterface></joint><actuator name="{joint}_motor"/></transmission>'))
    root.append(ElementTree.fromstring(
        '<gazebo><plugin name="control" filename="libgazebo_ros_control.so">'
        f"<robotNamespace>{namespace}</robotNamespace></plugin></gazebo>"))
    folder = os.path.dirname(full)  # panda.urdf writes package://meshes/… for its own folder
    return parse_urdf(ElementTree.tostring(root, encoding="unicode"),
                      lambda package: os.path.join(folder, package), folder)


@pytest.fixture(scope="module")
def scene():
    """Three robots: gantry arm, wheeled platform on a free base, arm with a prismatic gripper."""
    aras = ArasRobot()
    simulation = aras.simulation
    husky = {f"{wheel}_controller": {"type": "velocity_controllers/JointVelocityController",
                                     "joint": wheel} for wheel in WHEELS}
    simulation.spawn(
        with_control("husky/husky.urdf", dict.fromkeys(WHEELS, "VelocityJointInterface"), "/husky"),
        "husky", Pose((3.0, 0.0, 0.15)), "/husky", husky)
    strong = {"p": 4000.0, "i": 3000.0, "d": 100.0, "i_clamp": 80.0, "antiwindup": True}
    wrist = {"p": 200.0, "i": 200.0, "d": 5.0, "i_clamp": 10.0, "antiwindup": True}
    gains = {joint: strong if k < 4 else wrist for k, joint in enumerate(ARM)}
    panda = {
        "arm_controller": {
            "type": "effort_controllers/JointTrajectoryController", "joints": list(ARM),
            "gains": gains},
        "gripper_controller": {
            "type": "position_controllers/JointGroupPositionController", "joints": list(FINGERS)},
    }
    interfaces = {**dict.fromkeys(ARM, "EffortJointInterface"),
                  **dict.fromkeys(FINGERS, "PositionJointInterface")}
    simulation.spawn(
        with_control("franka_panda/panda.urdf", interfaces, "/panda", "panda_link0"), "panda",
        Pose((-3.0, 0.0, 0.0)), "/panda", panda, {"panda_joint4": -1.5, "panda_joint6": 1.5})
    for name, controllers in (("husky", husky), ("panda", panda)):
        manager = simulation.robots[name].manager
        for controller in controllers:
            manager.load(controller)
        manager.switch(list(controllers), [], 2)
    aras.steps(200)
    yield aras
    aras.close()


def test_all_three_move_as_commanded_at_the_same_time(scene):
    simulation = scene.simulation
    husky, panda = simulation.world.models["husky"], simulation.world.models["panda"]
    assert not husky.fixed_base
    began, wheel_speed = husky.pose(), 3.0
    for wheel in WHEELS:
        simulation.robots["husky"].manager.get(f"{wheel}_controller").set_command(wheel_speed)
    simulation.robots["panda"].manager.get("gripper_controller").set_command([0.03, 0.03])
    goal = (0.4, 0.3, -0.5, -1.8, 0.2, 1.8, -0.3)
    simulation.robots["panda"].manager.get("arm_controller").set_command(
        Trajectory(ARM, [TrajectoryPoint(1_000_000_000, goal, (0.0,) * 7)]))
    pose = (0.1, 0.0, math.radians(10), math.radians(-5), math.radians(-5), 0.0)
    scene.command(pose)
    scene.steps(1300)
    position = dict(zip(panda.joint_names, panda.read_joints()[0], strict=True))
    assert position["panda_finger_joint1"] == pytest.approx(0.03, abs=1e-4)
    assert position["panda_finger_joint2"] == pytest.approx(0.03, abs=1e-4)  # mimics the other
    for joint, target in zip(ARM, goal, strict=True):
        assert position[joint] == pytest.approx(target, abs=5e-3), joint
    travelled = np.subtract(husky.pose().xyz, began.xyz)
    assert travelled[0] == pytest.approx(wheel_speed * WHEEL_RADIUS * 1.3, rel=0.05)
    assert abs(travelled[1]) < 0.05
    for joint, target in zip(CONTROLLERS, pose, strict=True):
        assert scene.positions()[joint] == pytest.approx(target, abs=4e-3)
