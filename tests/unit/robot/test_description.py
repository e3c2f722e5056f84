"""The URDF agrees with the original's data and describes physically possible bodies."""

import math
import shutil
import subprocess
import xml.etree.ElementTree as ElementTree

import numpy as np
import pybullet
import pytest
from robot_figures import BOXES, INERTIALS, JOINTS, PACKAGE, PLATES, REDUCTIONS, URDF
from scipy.spatial.transform import Rotation

ROBOT = ElementTree.parse(URDF).getroot()
TARGET = ElementTree.parse(PACKAGE / "targets" / "aras.urdf").getroot()
LINKS = {link.get("name"): link for link in ROBOT.findall("link")}
URDF_JOINTS = {joint.get("name"): joint for joint in ROBOT.findall("joint")}
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
    return Rotation.from_euler("xyz", (roll, pitch, yaw)).as_matrix()


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


def test_joints_links_and_boxes_have_the_original_figures():
    """With only a frame besides."""
    assert set(URDF_JOINTS) == {*JOINTS, "camera_optical_joint"}
    assert set(LINKS) == {figures[2] for figures in JOINTS.values()} | {
        "base_link", "camera_optical_frame"}
    for name, (kind, parent, child, xyz, rpy, axis, limits, dynamics) in JOINTS.items():
        joint = URDF_JOINTS[name]
        ends = tuple(joint.find(tag).get("link") for tag in ("parent", "child"))
        assert (joint.get("type"), *ends, origin(joint)) == (kind, parent, child, (xyz, rpy)), name
        if axis is not None:
            assert numbers(joint.find("axis").get("xyz")) == axis, name
            values = [tuple(float(joint.find(tag).get(k)) for k in keys) for tag, keys in (
                ("limit", ("lower", "upper", "effort", "velocity")),
                ("dynamics", ("damping", "friction")))]  # fmt: skip
            assert values == [limits, dynamics], name
    for name, (mass, com, diagonal, products) in INERTIALS.items():
        inertial = LINKS[name].find("inertial")
        tensor = inertial.find("inertia")
        assert float(inertial.find("mass").get("value")) == mass, name
        assert origin(inertial) == (com, (0, 0, 0)), name
        found = [float(tensor.get(k)) for k in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")]
        assert found == [*diagonal, *products], name
    for name, (size, centre) in BOXES.items():
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
        "320", "240", "R8G8B8"]
    plugin = {child.tag: child.text for child in sensor.find("plugin")}
    assert plugin.items() >= {"cameraName": "labrob/camera", "imageTopicName": "image_raw",
                              "cameraInfoTopicName": "camera_info",
                              "frameName": "camera_link"}.items()  # fmt: skip
    assert float(plugin["hackBaseline"]) == 0.07
    assert all(float(plugin[f"distortion{k}"]) == 0 for k in ("K1", "K2", "K3", "T1", "T2"))
    near = float(camera.find("clip/near").text)
    assert 0.005 < near < 0.15, "behind the lens the housing, before it the table"


def test_camera_looks_straight_down_at_the_target_and_the_gantry_moves_along_x():
    """Its optical frame has REP 103's axes."""
    camera, optical = world_T_link("camera_link"), world_T_link("camera_optical_frame")
    np.testing.assert_allclose(camera[:3, 3], (0, 0, 0.782), atol=5e-4)
    np.testing.assert_allclose(camera[:3, 0], (0, 0, -1), atol=3e-3)  # Gazebo looks along +x
    np.testing.assert_allclose(camera[:3, 3] - PLATES[0][1], (0, 0, 0.192), atol=5e-4)
    axes = np.column_stack([-camera[:3, 1], -camera[:3, 2], camera[:3, 0], camera[:3, 3]])
    np.testing.assert_allclose(optical[:3], axes, atol=1e-12)
    axis = world_T_link("slider")[:3, :3] @ np.array(JOINTS["gantry"][5])
    np.testing.assert_allclose(axis, (1, 0, 0), atol=1e-4)


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
    flags = (pybullet.URDF_USE_INERTIA_FROM_FILE | pybullet.URDF_USE_SELF_COLLISION
             | pybullet.URDF_USE_SELF_COLLISION_EXCLUDE_PARENT)  # fmt: skip
    body = pybullet.loadURDF(str(path), useFixedBase=True, flags=flags, physicsClientId=client)
    count = pybullet.getNumJoints(body, physicsClientId=client)
    infos = [pybullet.getJointInfo(body, i, physicsClientId=client) for i in range(count)]
    yield client, body, {info[1].decode(): info[0] for info in infos}
    pybullet.disconnect(client)


@pytest.mark.parametrize("pose", POSES)
def test_nothing_collides_and_the_camera_sees_the_table_and_nothing_of_the_arm(bullet, pose):
    """Rendered with the sensor's lens and near plane, labelled by link."""
    client, body, joints = bullet
    for name, value in zip(("gantry", "J1", "J2", "J3", "J5", "J6"), POSES[pose], strict=True):
        pybullet.resetJointState(body, joints[name], value, physicsClientId=client)
    pybullet.performCollisionDetection(physicsClientId=client)
    contacts = pybullet.getContactPoints(physicsClientId=client)
    assert not [contact for contact in contacts if contact[8] <= 0]
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
        320, 240, view, pybullet.computeProjectionMatrix(*lens),
        flags=pybullet.ER_SEGMENTATION_MASK_OBJECT_AND_LINKINDEX,
        renderer=pybullet.ER_TINY_RENDERER, physicsClientId=client,
    )[4]  # fmt: skip
    assert {int(label >> 24) - 1 for label in np.unique(labels) if label >= 0} == {-1}
