"""The URDF agrees with the original's data and describes physically possible bodies."""

import math
import shutil
import subprocess
import xml.etree.ElementTree as ElementTree

import numpy as np
import pybullet
import pytest
from robot_figures import (
    BOXES,
    INERTIALS,
    JOINTS,
    PACKAGE,
    PLATES,
    REDUCTIONS,
    URDF,
)

ROBOT = ElementTree.parse(URDF).getroot()
TARGET = ElementTree.parse(PACKAGE / "targets" / "aras.urdf").getroot()
LINKS = {link.get("name"): link for link in ROBOT.findall("link")}
URDF_JOINTS = {joint.get("name"): joint for joint in ROBOT.findall("joint")}
OURS = {"camera_optical_joint"}  # beyond the original
# gantry (m), J1, J2, J3, J5, J6 (rad): straight down, both start poses, a desired pose
POSES = {
    "zero": (0, 0, 0, 0, 0, 0),
    "start 2015": (0.1, 0, *np.radians([10, -5, -5, 0])),
    "start 2016": (-0.1, 0, *np.radians([20, -15, -5, 10])),
    "desired 2016": (0.05, 0, -0.09, 0.045, 0.045, 0),
}


def numbers(text: str) -> tuple[float, ...]:
    return tuple(float(word) for word in text.split())


def origin(element) -> tuple[tuple[float, ...], tuple[float, ...]]:
    tag = element.find("origin")
    return numbers(tag.get("xyz")), numbers(tag.get("rpy"))


def rotation(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """Rz(yaw) Ry(pitch) Rx(roll), shape (3, 3)."""
    cr, sr, cp, sp = math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch)
    cy, sy = math.cos(yaw), math.sin(yaw)
    return (
        np.array([(cy, -sy, 0), (sy, cy, 0), (0, 0, 1)])
        @ np.array([(cp, 0, sp), (0, 1, 0), (-sp, 0, cp)])
        @ np.array([(1, 0, 0), (0, cr, -sr), (0, sr, cr)])
    )


def world_T_link(link: str) -> np.ndarray:
    """Pose of a link in base_link at all-zero joints, shape (4, 4)."""
    pose = np.eye(4)
    parents = {j.find("child").get("link"): j for j in URDF_JOINTS.values()}
    while link in parents:
        xyz, rpy = origin(parents[link])
        step = np.eye(4)
        step[:3, :3], step[:3, 3] = rotation(*rpy), xyz
        pose = step @ pose
        link = parents[link].find("parent").get("link")
    assert link == "base_link"
    return pose


def test_it_has_the_original_joints_and_only_a_frame_beside_them():
    assert set(URDF_JOINTS) == set(JOINTS) | OURS
    assert set(LINKS) == {figures[2] for figures in JOINTS.values()} | {
        "base_link",
        "camera_optical_frame",
    }


@pytest.mark.parametrize("name", JOINTS)
def test_joint_figures(name):
    kind, parent, child, xyz, rpy, axis, limits, dynamics = JOINTS[name]
    joint = URDF_JOINTS[name]
    assert joint.get("type") == kind
    assert joint.find("parent").get("link") == parent
    assert joint.find("child").get("link") == child
    assert origin(joint) == (xyz, rpy)
    if axis is None:
        return
    assert numbers(joint.find("axis").get("xyz")) == axis
    tag = joint.find("limit")
    assert tuple(float(tag.get(k)) for k in ("lower", "upper", "effort", "velocity")) == limits
    tag = joint.find("dynamics")
    assert tuple(float(tag.get(k)) for k in ("damping", "friction")) == dynamics


@pytest.mark.parametrize("name", INERTIALS)
def test_inertial_figures(name):
    mass, com, diagonal, products = INERTIALS[name]
    inertial = LINKS[name].find("inertial")
    tensor = inertial.find("inertia")
    assert float(inertial.find("mass").get("value")) == mass
    assert origin(inertial) == (com, (0, 0, 0))
    assert tuple(float(tensor.get(k)) for k in ("ixx", "iyy", "izz")) == diagonal
    assert tuple(float(tensor.get(k)) for k in ("ixy", "ixz", "iyz")) == products


@pytest.mark.parametrize("name", BOXES)
def test_boxes_are_drawn_in_their_place(name):
    size, centre = BOXES[name]
    visual = LINKS[name].find("visual")
    assert numbers(visual.find("geometry/box").get("size")) == size
    assert origin(visual) == (centre, (0, 0, 0))


def test_transmissions_are_accepted_and_reduce_nothing():
    seen = {}
    for transmission in ROBOT.findall("transmission"):
        assert transmission.find("type").text == "transmission_interface/SimpleTransmission"
        (joint,) = transmission.findall("joint")
        interface = joint.find("hardwareInterface").text
        assert interface.removeprefix("hardware_interface/") == "EffortJointInterface"
        (actuator,) = transmission.findall("actuator")
        assert actuator.get("name")
        assert actuator.find("mechanicalReduction") is None, "would take effect"
        seen[joint.get("name")] = float(transmission.find("mechanicalReduction").text)
    assert seen == REDUCTIONS


def test_gazebo_tags():
    control = ROBOT.find("gazebo/plugin[@filename='libgazebo_ros_control.so']")
    assert control.find("robotNamespace").text == "/aras_visual_servo"
    assert not ROBOT.findall("gazebo/material"), "drawn white: the table has to be bright"
    sensor = ROBOT.find("gazebo[@reference='camera_link']/sensor[@type='camera']")
    assert float(sensor.find("update_rate").text) == 30
    camera = sensor.find("camera")
    assert float(camera.find("horizontal_fov").text) == 2
    assert [camera.find(f"image/{k}").text for k in ("width", "height", "format")] == [
        "320",
        "240",
        "R8G8B8",
    ]
    plugin = {child.tag: child.text for child in sensor.find("plugin")}
    assert plugin["cameraName"] == "labrob/camera"
    assert plugin["imageTopicName"] == "image_raw"
    assert plugin["cameraInfoTopicName"] == "camera_info"
    assert plugin["frameName"] == "camera_link"
    assert float(plugin["hackBaseline"]) == 0.07
    assert all(float(plugin[f"distortion{k}"]) == 0 for k in ("K1", "K2", "K3", "T1", "T2"))
    near = float(camera.find("clip/near").text)
    assert 0.005 < near < 0.15, "behind the lens the housing, before it the table"


def test_camera_looks_straight_down_at_the_target():
    pose = world_T_link("camera_link")
    np.testing.assert_allclose(pose[:3, 3], (0, 0, 0.782), atol=5e-4)
    np.testing.assert_allclose(pose[:3, 0], (0, 0, -1), atol=3e-3)  # Gazebo looks along +x
    plate = np.array(PLATES[0][1])
    np.testing.assert_allclose(pose[:3, 3] - plate, (0, 0, 0.192), atol=5e-4)


def test_optical_frame_is_the_camera_in_rep_103_axes():
    camera, optical = world_T_link("camera_link"), world_T_link("camera_optical_frame")
    np.testing.assert_allclose(optical[:3, 3], camera[:3, 3], atol=1e-12)
    np.testing.assert_allclose(optical[:3, 2], camera[:3, 0], atol=1e-12)  # forward
    np.testing.assert_allclose(optical[:3, 0], -camera[:3, 1], atol=1e-12)  # right
    np.testing.assert_allclose(optical[:3, 1], -camera[:3, 2], atol=1e-12)  # down


def test_the_target_is_a_model_of_its_own_and_lies_where_the_original_has_its_plates():
    """The square sinks by half its thickness, so that its face shows and no faces coincide."""
    assert not any("planar" in name for name in LINKS)
    (link,) = TARGET.findall("link")
    drawn = []
    for visual in link.findall("visual"):
        xyz, rpy = origin(visual)
        assert rpy == (0, 0, 0)
        centre = np.add(xyz, target_place())
        drawn.append((numbers(visual.find("geometry/box").get("size")), tuple(centre.round(9))))
    assert drawn == list(PLATES)
    (high, (_, _, z)) = drawn[0]
    assert z + 0.5 * high[2] > 0.59 > z - 0.5 * high[2]
    assert link.find("collision") is None and TARGET.find("gazebo/static").text == "true"
    assert TARGET.find("gazebo[@reference='planar_object']/material").text == "Gazebo/Black"
    assert numbers(TARGET.find("material/color").get("rgba")) == (0, 0, 0, 1)


def target_place() -> tuple[float, float, float]:
    """Return the position x, y, z (m) at which the launch file spawns the target."""
    launch = ElementTree.parse(PACKAGE / "launch" / "aras_visual_servo_gazebo.launch").getroot()
    words = launch.find("arg[@name='target_place']").get("default").split()
    return tuple(float(words[words.index(f"-{axis}") + 1]) for axis in "xyz")


def test_positive_gantry_moves_the_carriage_along_world_x():
    axis = world_T_link("slider")[:3, :3] @ np.array(JOINTS["gantry"][5])
    np.testing.assert_allclose(axis, (1, 0, 0), atol=1e-4)


@pytest.mark.skipif(shutil.which("check_urdf") is None, reason="liburdfdom-tools not installed")
def test_check_urdf_is_clean():
    run = subprocess.run(["check_urdf", URDF], capture_output=True, text=True, check=False)
    assert run.returncode == 0
    assert "Successfully Parsed XML" in run.stdout
    assert run.stderr == ""
    assert "warn" not in run.stdout.lower()


@pytest.fixture(scope="module")
def bullet(tmp_path_factory):
    """The robot in Bullet with self collision; yields (client, body, joint index by name)."""
    path = tmp_path_factory.mktemp("robot") / "robot.urdf"
    path.write_text(URDF.read_text().replace("package://aras_visual_servo_gazebo", str(PACKAGE)))
    client = pybullet.connect(pybullet.DIRECT)
    flags = (
        pybullet.URDF_USE_INERTIA_FROM_FILE
        | pybullet.URDF_USE_SELF_COLLISION
        | pybullet.URDF_USE_SELF_COLLISION_EXCLUDE_PARENT
    )
    body = pybullet.loadURDF(str(path), useFixedBase=True, flags=flags, physicsClientId=client)
    count = pybullet.getNumJoints(body, physicsClientId=client)
    infos = [pybullet.getJointInfo(body, i, physicsClientId=client) for i in range(count)]
    yield client, body, {info[1].decode(): info[0] for info in infos}
    pybullet.disconnect(client)


@pytest.mark.parametrize("pose", POSES)
def test_nothing_collides_where_the_robot_works(bullet, pose):
    client, body, joints = bullet
    for name, value in zip(("gantry", "J1", "J2", "J3", "J5", "J6"), POSES[pose], strict=True):
        pybullet.resetJointState(body, joints[name], value, physicsClientId=client)
    pybullet.performCollisionDetection(physicsClientId=client)
    contacts = pybullet.getContactPoints(physicsClientId=client)
    names = {index: name for name, index in joints.items()} | {-1: "base"}
    touching = {(names[c[3]], names[c[4]]) for c in contacts if c[8] <= 0}
    assert touching == set()


@pytest.mark.parametrize("pose", POSES)
def test_camera_sees_the_table_and_nothing_of_the_arm(bullet, pose):
    """Rendered with the sensor's lens and near plane, labelled by link."""
    client, body, joints = bullet
    for name, value in zip(("gantry", "J1", "J2", "J3", "J5", "J6"), POSES[pose], strict=True):
        pybullet.resetJointState(body, joints[name], value, physicsClientId=client)
    state = pybullet.getLinkState(
        body, joints["camera_joint"], computeForwardKinematics=True, physicsClientId=client
    )
    eye = np.array(state[4])
    axes = np.array(pybullet.getMatrixFromQuaternion(state[5])).reshape(3, 3)
    view = pybullet.computeViewMatrix(eye.tolist(), (eye + axes[:, 0]).tolist(), axes[:, 2])
    camera = ROBOT.find("gazebo[@reference='camera_link']/sensor/camera")
    near = float(camera.find("clip/near").text)
    half_width = near * math.tan(float(camera.find("horizontal_fov").text) / 2)
    half_height = half_width * 240 / 320
    lens = (-half_width, half_width, -half_height, half_height, near, 10.0)
    labels = pybullet.getCameraImage(
        320,
        240,
        view,
        pybullet.computeProjectionMatrix(*lens),
        flags=pybullet.ER_SEGMENTATION_MASK_OBJECT_AND_LINKINDEX,
        renderer=pybullet.ER_TINY_RENDERER,
        physicsClientId=client,
    )[4]
    labels = np.reshape(labels, (240, 320))
    seen = {int(label >> 24) - 1 for label in np.unique(labels) if label >= 0}
    assert seen == {-1}
