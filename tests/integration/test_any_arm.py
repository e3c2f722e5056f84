"""A Panda from a public registry servoes on the graph with launch arguments and one YAML file."""

import os
import sysconfig
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
import yaml
from aras_visual_servo_controller.msg import ServoReport, ServoState
from gazebo_calls import time_goes_on
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from aras_visual_servo_base.poses import matrix_from_xyz_rpy, pose_difference
from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.kinematics import Arm
from aras_visual_servo_controller.observation.feature_observer import FeatureObserver
from aras_visual_servo_controller.observation.observation import Need
from aras_visual_servo_controller.observation.target_geometry import TargetGeometry
from aras_visual_servo_controller.schemes import create_scheme

REGISTRY = Path(sysconfig.get_paths()["purelib"], "cmeel.prefix/share/example-robot-data/robots")
FILE, HAND = REGISTRY / "panda_description/urdf/panda.urdf", "panda_hand_tcp"
NEAR = [0.2, 0.0, 0.0, -2.0, 0.0, 2.0, 0.8]
# Joint 4 cannot be at 0, where joints that nobody puts elsewhere begin.
PLACES = {"panda_joint4": -1.5, "panda_joint6": 1.6}
SPACE = "/aras_visual_servo"
SURFACE = 0.05  # m, height of the table's top
PLATE = (0.2, 0.12, 0.0004)  # m
CENTRE = (0.45, 0.1)  # m, of the plate
DEPTH = 0.3  # m
SENSOR = """<robot>
<gazebo reference="camera_link"><sensor type="camera" name="camera"><update_rate>15</update_rate>
  <camera name="labrob"><horizontal_fov>2.0</horizontal_fov><image><width>320</width>
  <height>240</height><format>R8G8B8</format></image><clip><near>0.02</near><far>100</far></clip>
  </camera><plugin name="camera_controller" filename="libgazebo_ros_camera.so">
  <alwaysOn>true</alwaysOn><updateRate>0.0</updateRate><cameraName>labrob/camera</cameraName>
  <imageTopicName>image_raw</imageTopicName><cameraInfoTopicName>camera_info</cameraInfoTopicName>
  <frameName>camera_link</frameName></plugin></sensor></gazebo>
<gazebo reference="plate"><material>Gazebo/Black</material></gazebo>
<gazebo><plugin name="control" filename="libgazebo_ros_control.so">
  <robotNamespace>{space}</robotNamespace></plugin></gazebo>
</robot>""".replace("{space}", SPACE)


def description() -> str:
    """The registry's arm without its meshes, a camera in its hand, a plate on a table below."""
    if not FILE.is_file():
        missing = f"{FILE} is missing: install the packages of requirements/developing.txt"
        (pytest.fail if os.environ.get("ARAS_REQUIRE_GRAPH") else pytest.skip)(missing)
    robot = ElementTree.fromstring(FILE.read_text())
    for link in robot.findall("link"):
        for part in (*link.findall("visual"), *link.findall("collision")):
            link.remove(part)
    for part in (*robot.findall("transmission"), *robot.findall("gazebo")):
        robot.remove(part)
    if robot.find("link[@name='world']") is None:
        root = robot.find("link").get("name")
        ElementTree.SubElement(robot, "link", name="world")
        _fixed(robot, "world", root, "0 0 0")
    for joint in robot.findall("joint"):
        if "finger" in joint.get("name"):
            joint.set("type", "fixed")
            for mimic in joint.findall("mimic"):
                joint.remove(mimic)
        elif joint.get("type") != "fixed":
            robot.append(_transmission(joint.get("name")))
    ElementTree.SubElement(robot, "link", name="camera_link")
    _fixed(robot, HAND, "camera_link", "0 0 0.02", f"0 {-np.pi / 2!r} 0")
    _box(robot, "table", (2.0, 2.0, 0.02), (0.6, 0.0, SURFACE - 0.01))
    _box(robot, "plate", PLATE, (*CENTRE, SURFACE + 0.5 * PLATE[2]))
    robot.extend(ElementTree.fromstring(SENSOR))
    return ElementTree.tostring(robot, encoding="unicode")


def _fixed(robot, parent: str, child: str, xyz: str, rpy: str = "0 0 0") -> None:
    joint = ElementTree.SubElement(robot, "joint", name=f"{child}_fixed", type="fixed")
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    ElementTree.SubElement(joint, "origin", xyz=xyz, rpy=rpy)


def _box(robot, name: str, size, place) -> None:
    link = ElementTree.SubElement(robot, "link", name=name)
    shape = ElementTree.SubElement(ElementTree.SubElement(link, "visual"), "geometry")
    ElementTree.SubElement(shape, "box", size=" ".join(map(str, size)))
    _fixed(robot, "world", name, " ".join(map(str, place)))


def _transmission(joint: str) -> ElementTree.Element:
    return ElementTree.fromstring(
        f'<transmission name="{joint}_t"><type>transmission_interface/SimpleTransmission</type>'
        f'<joint name="{joint}"><hardwareInterface>hardware_interface/VelocityJointInterface'
        f'</hardwareInterface></joint><actuator name="{joint}_motor"/></transmission>')


def goal_of(arm: Arm) -> Goal:
    """Return the goal of an exact camera that looks at the plate vertically, with an offset."""
    focal = 160.0 / np.tan(1.0)
    camera = CameraModel(320, 240, (focal, 0, 159.5, 0, focal, 119.5, 0, 0, 1))
    x, y = CENTRE
    above = matrix_from_xyz_rpy((x + 0.02, y + 0.01, SURFACE + DEPTH), (np.pi, 0.0, 0.2))
    joints = arm.inverse_kinematics(above, np.array(NEAR))
    half = 0.5 * np.array(PLATE[:2])
    low = (*(np.array(CENTRE) - half), SURFACE)
    high = (*(np.array(CENTRE) + half), SURFACE + PLATE[2])
    target = TargetGeometry.from_mapping({"boxes": [[low, high]], "ground": SURFACE})
    pose = arm.pose(joints)
    observation = FeatureObserver(arm, frozenset(Need)).observe_exact_features(
        0.0, camera, arm.read_joints(arm.names, joints), contour=target.compute_outline(pose))
    return Goal.teach(create_scheme("points"), observation, "above", target=target)


def controllers_of(joints: tuple[str, ...]) -> dict[str, dict[str, object]]:
    """Return velocity controllers with unusual names for each joint, among others."""
    each = {f"speed_{i}": {"type": "velocity_controllers/JointVelocityController", "joint": joint}
            for i, joint in enumerate(joints)}
    unused = {"type": "position_controllers/JointPositionController", "joint": joints[1]}
    states = {"type": "joint_state_controller/JointStateController", "publish_rate": 100}
    return {f"{joints[1]}_position_controller": unused, **each, "joint_state_controller": states}


def test_another_arm_is_servoed(launch, ros_node, collect, tmp_path):
    urdf = tmp_path / "panda.urdf"
    urdf.write_text(description())
    arm = Arm.from_urdf(urdf.read_text())
    goal = goal_of(arm)
    (tmp_path / "goal.yaml").write_text(goal.to_yaml("for a test"))
    reached = goal.get_joints(arm.names)
    away = arm.pose(reached).copy()
    away[:3, 3] += (0.04, -0.03, 0.05)
    turn = matrix_from_xyz_rpy((0, 0, 0), (0.0, 0.0, 0.3))
    away[:3, :3] = turn[:3, :3] @ away[:3, :3]
    start = arm.inverse_kinematics(away, reached)
    entries = controllers_of(arm.names)
    gains = tmp_path / "controllers.yaml"
    gains.write_text(yaml.safe_dump({SPACE[1:]: entries}))
    states = collect(f"{SPACE}/controller/state", ServoState)
    reports = collect(f"{SPACE}/controller/diagnosis", ServoReport)
    joints = collect(f"{SPACE}/joint_states", JointState)
    robot = launch(
        "aras_visual_servo_gazebo", "aras_visual_servo.launch", nodes=["/gazebo"],
        paused=True, clock_rate=100, urdf=str(urdf), gains=str(gains), robot="panda",
        controllers=" ".join(one for one in entries if one.startswith("speed_")),
        robot_place=" ".join(f"-J {joint} {q}" for joint, q in PLACES.items()),
        target="none",  # its own plate is part of the description
    )  # fmt: skip
    with time_goes_on():
        first = joints.wait(timeout=40.0)
    put = dict(zip(first.name, first.position, strict=True))
    assert {joint: put[joint] for joint in PLACES} == pytest.approx(PLACES, abs=1e-3)
    speeds = [collect(f"{SPACE}/{one}/command", Float64) for one in entries
              if one.startswith("speed_")]
    nodes = launch("aras_visual_servo_gazebo", "aras_visual_servo_nodes.launch",
                   nodes=["/aras_visual_servo_controller"], scheme="moments",
                   goal=str(tmp_path / "goal.yaml"), start=str([round(float(q), 6) for q in start]),
                   gain=3.0, output="velocity")
    try:
        with time_goes_on():
            states.wait(timeout=40.0, where=lambda state: state.phase == "converged")
        q = arm.read_joints(joints.messages[-1].name, joints.messages[-1].position).positions
        distance, angle = pose_difference(arm.pose(reached), arm.pose(q))
        assert distance < 1e-3 and angle < np.radians(0.4)
        assert "unstable" not in robot.log.read_text()  # nothing is said of gains that do
        assert reports.messages[-1].rank_lj == 4
    finally:
        print([(m.phase, m.reason, m.error) for m in states.messages[-1:]])
        nodes.stop()
        robot.stop()
    assert [speed.messages[-1].data for speed in speeds] == [0.0] * 7  # is left behind
