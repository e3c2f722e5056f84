"""Robot of an experiment: packages, frames, cameras and controllers."""

import re
from pathlib import Path

import numpy as np
import pytest

from aras_sim_bridge.description import parse_cameras, parse_urdf
from aras_visual_servo_base.poses import matrix_from_xyz_rpy, relative_pose
from aras_visual_servo_bench import Experiment, run
from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.experiment.added_links import MountedTarget
from aras_visual_servo_bench.experiment.camera_specs import (
    CalibrationOffset,
    CameraSpec,
    HandEyeSpec,
)
from aras_visual_servo_bench.experiment.packages import PackagePath
from aras_visual_servo_bench.experiment.robot_spec import RobotSpec
from aras_visual_servo_bench.experiment.robots import Robot, find_camera_name
from aras_visual_servo_controller.kinematics import Arm
from aras_visual_servo_controller.observation.camera_rig import FixedCameraKinematics

JOINT = ('<link name="{0}"/><joint name="{0}_j" type="{1}"><parent link="{2}"/><child link="{0}"/>'
         '<origin xyz="{3}"/><axis xyz="{4}"/><limit lower="-2" upper="2" velocity="1" effort="9"/>'
         '</joint>')
EYE = ('<link name="camera_link"/><joint name="mount" type="fixed"><parent link="b"/>'
       '<child link="camera_link"/><origin xyz="0.05 0 0.1" rpy="0 0.3 0"/></joint>')
FRAME = ('<link name="camera_optical_frame"/><joint name="opt" type="fixed"><parent '
         'link="camera_link"/><child link="camera_optical_frame"/><origin '
         'rpy="-1.570796326794897 0 -1.570796326794897"/></joint>')
SENSOR = ('<gazebo reference="camera_link"><sensor type="camera" name="c"><camera/></sensor>'
          '</gazebo>')
PLUGIN = ('<plugin name="p" filename="libgazebo_ros_camera.so"><cameraName>{}</cameraName>'
          '</plugin>')
URDF = ('<robot name="r"><link name="world"/>' + JOINT.format("a", "revolute", "world", "0 0 0.2",
        "0 0 1") + JOINT.format("b", "prismatic", "a", "0.3 0 0", "1 0 0") + EYE + FRAME
        + '<link name="wall"/><joint name="w" type="fixed"><parent link="world"/><child '
        'link="wall"/><origin xyz="1 2 3" rpy="0 0 0.5"/></joint>' + SENSOR + '</robot>')
KIND = "{}_controllers/Joint{}Controller"
POSITION, VELOCITY = KIND.format("position", "Position"), KIND.format("velocity", "Velocity")
CONFIG = f"""r:
  joint_state_controller: {{type: joint_state_controller/JointStateController}}
  first: {{type: {POSITION}, joint: a_j}}
  again: {{type: {POSITION}, joint: a_j}}
  both: {{type: position_controllers/JointGroupPositionController, joints: [a_j, b_j]}}
  second: {{type: {POSITION}, joint: b_j}}
  fast: {{type: {VELOCITY}, joint: b_j}}
"""


@pytest.fixture
def made(tmp_path):
    (tmp_path / "r.urdf").write_text(URDF)
    (tmp_path / "r.yaml").write_text(CONFIG)

    def robot(keys=None, **more):
        spec = {"urdf": str(tmp_path / "r.urdf"), "config": str(tmp_path / "r.yaml"),
                "namespace": "/r", **(keys or {})}
        return Robot(RobotSpec(**spec), **more)
    robot.folder = tmp_path
    return robot


def test_cameras_alone_are_those_of_the_whole_description():
    sensor = "<sensor type='{}' name='{}'><update_rate>{}</update_rate><camera/></sensor>"
    tags = "".join(
        f"<gazebo{where}>{sensor.format(*words)}</gazebo>" for where, *words in (
            (" reference='a'", "camera", "first", 10), (" reference='a'", "camera", "first", 20),
            (" reference='none'", "camera", "lost", 30), (" reference='a'", "imu", "turns", 40),
            (" reference='a'", "depth", "deep", 50), ("", "camera", "nowhere", 60)))
    urdf = f"<robot name='r'><link name='a'/>{tags}</robot>"
    found = parse_cameras(urdf)
    assert [(one.name, one.update_rate) for one in found] == [("first", 10.0), ("deep", 50.0)]
    assert found == parse_urdf(urdf).cameras


Q = np.array([0.4, -0.1])
HAND = matrix_from_xyz_rpy((0, 0, 0.2), (0, 0, Q[0])) @ matrix_from_xyz_rpy(
    (0.3 + Q[1], 0, 0), (0, 0, 0))  # world_T_b
HAND_T_LINK = matrix_from_xyz_rpy((0.05, 0.0, 0.1), (0.0, 0.3, 0.0))
LINK_T_EYE = np.array([[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]])


CAMERAS = {
    "own": CameraSpec(), "framed": CameraSpec(frame="wall"),
    "held": CameraSpec(
        xyz=(0.1, 0.0, 0.02), rpy=(0.0, 0.1, 0.0),
        calibration_offset=CalibrationOffset(xyz=(0.0, 0.01, 0.0), rpy=(0.1, 0.0, 0.0))),
    "stands": CameraSpec(
        pose=(0.5, 0.6, 0.7, 0.1, 0.2, 0.3),
        calibration_offset=CalibrationOffset(xyz=(0.02, 0.0, 0.0), rpy=(0.0, 0.0, 0.1))),
    "carried": CameraSpec(pose=(0.5, 0.6, 0.7, 0.1, 0.2, 0.3), target_frame="b")}  # fmt: skip


@pytest.mark.parametrize("described", [True, False])
def test_more_cameras_get_frames_of_their_own(made, described):
    if not described:
        (made.folder / "r.urdf").write_text(URDF.replace(FRAME, ""))
    robot = made(cameras=CAMERAS)
    assert [robot.find_optical_frame(name) for name in (*CAMERAS, "none")] == [
        "camera_optical_frame", "wall", "camera_frame_of_held", "camera_frame_of_stands",
        "camera_frame_of_carried", "camera_optical_frame"]
    assert [robot.find_target_frame(name) for name in ("own", "carried")] == ["", "b"]
    control = robot.make_arm("held")
    assert control.names == ("a_j", "b_j")
    seat = matrix_from_xyz_rpy((0.1, 0.0, 0.02), (0.0, 0.1, 0.0))
    place = matrix_from_xyz_rpy((0.5, 0.6, 0.7), (0.1, 0.2, 0.3))
    for name, at, off in (
        ("held", HAND @ HAND_T_LINK @ seat @ LINK_T_EYE,
         matrix_from_xyz_rpy((0.0, 0.01, 0.0), (0.1, 0.0, 0.0))),
        ("stands", place, matrix_from_xyz_rpy((0.02, 0, 0), (0, 0, 0.1))),
    ):  # fmt: skip
        found = robot.make_camera_kinematics(name, control)
        assert isinstance(found, FixedCameraKinematics) is (name == "stands")
        np.testing.assert_allclose(found.pose(Q), at, atol=1e-9)
        wrong = robot.make_camera_kinematics(name, control, True)
        np.testing.assert_allclose(wrong.pose(Q), at @ off, atol=1e-9)
    np.testing.assert_allclose(control.pose(Q), HAND @ HAND_T_LINK @ seat @ LINK_T_EYE, atol=1e-9)
    np.testing.assert_allclose(robot.find_fixed_pose("stands"), place, atol=1e-9)
    assert robot.find_fixed_pose("held") is None and robot.find_fixed_pose("carried") is None
    at = relative_pose(HAND, place)
    np.testing.assert_allclose(robot.make_arm("carried").pose(Q), at, atol=1e-9)
    off = matrix_from_xyz_rpy(OFF["xyz"], OFF["rpy"])
    carried = robot.make_calibrated_arm(**OFF, camera="carried").pose(Q)
    np.testing.assert_allclose(carried, at @ off, atol=1e-9)


@pytest.mark.parametrize(("plugin", "name"), [
    (PLUGIN.format("/eye/left/"), "eye/left"), (PLUGIN.format(""), "c"), ("", "c")])
def test_a_camera_s_name_is_its_plugin_s_or_its_own(plugin, name):
    (sensor,) = parse_cameras(URDF.replace("<camera/>", f"<camera/>{plugin}"))
    assert find_camera_name(sensor) == name


OFF = {"xyz": (0.01, 0.02, 0.03), "rpy": (0.1, -0.2, 0.3)}


@pytest.mark.parametrize("camera_frame", ["camera_optical_frame", "camera_link", "b"])
def test_a_camera_is_moved_and_believed_in_the_same_axes_at_any_frame(made, camera_frame):
    """Moved in the axes of a camera's link (x forward, y left, z up), believed in its own (z
    forward, x right, y down); also at a frame of a description that has no camera."""
    own = {"camera_frame": camera_frame}
    if camera_frame == "b":
        (made.folder / "r.urdf").write_text(URDF.replace(EYE + FRAME, "").replace(SENSOR, ""))
    place = made(own).make_arm().pose(Q)
    off, link = matrix_from_xyz_rpy(OFF["xyz"], OFF["rpy"]), np.linalg.inv(LINK_T_EYE)
    moved = made(own, **OFF).make_arm().pose(Q)
    np.testing.assert_allclose(moved, place @ link @ off @ LINK_T_EYE, atol=1e-9)
    if camera_frame == "camera_optical_frame":
        np.testing.assert_allclose(place, HAND @ HAND_T_LINK @ LINK_T_EYE, atol=1e-9)
        turned = made().make_calibrated_arm((0.0,) * 3, (0.0, 0.0, 0.2))  # by one number of six
        angle = matrix_from_xyz_rpy((0.0, 0.0, 0.0), (0.0, 0.0, 0.2))
        np.testing.assert_allclose(turned.pose(Q), place @ angle, atol=1e-9)
    for robot, true in ((made(own), place), (made(own, **OFF), moved)):
        np.testing.assert_allclose(robot.make_calibrated_arm(**OFF).pose(Q), true @ off, atol=1e-9)


def test_a_robot_without_a_camera_delivers_images_of_the_added_one(tmp_path):
    docs = Path(__file__).parents[3] / "docs" / "examples"
    urdf = re.sub(r'<gazebo reference="camera_link">.*?</gazebo>', "",
                  (docs / "my_arm.urdf").read_text(), flags=re.DOTALL)  # fmt: skip
    (tmp_path / "r.urdf").write_text(urdf)
    done = run(Experiment(
        robot={"urdf": str(tmp_path / "r.urdf"), "config": str(docs / "my_arm_controllers.yaml"),
               "camera_frame": "flange"},
        target={"shape": "l_shape", "size": [0.1, 0.1], "pose": [0.45, 0.05, 0.051, 0, 0, 0]},
        goal={"pose": [0.45, 0.05, 0.3, 3.14159, 0, 1.8]},
        start={"pose": [0.44, 0.04, 0.31, 3.1, 0.05, 1.9]}, scheme="points", duration=0.2))
    assert len(done.stamp) > 2 and done.states[2].scheme_output is not None


def test_a_target_is_put_onto_a_link(made, tmp_path):
    (tmp_path / "t.urdf").write_text(
        '<robot name="t"><link name="t"><visual><geometry><box size="1 2 3"/></geometry></visual>'
        '</link><gazebo reference="t"><material>Gazebo/Grey</material></gazebo></robot>')
    pose = matrix_from_xyz_rpy((0.1, 0.2, 0.3), (0.1, 0.2, 0.3))
    carried = {"plate": MountedTarget("b", pose, tmp_path / "t.urdf")}
    robot = made(mounted_targets=carried)
    found = parse_urdf(robot.urdf)
    assert [v.geometry.size for v in found.links["plate"].visuals] == [(1.0, 2.0, 3.0)]
    assert 'reference="plate"' in robot.urdf and 'reference="t"' not in robot.urdf
    arm = Arm.from_urdf(robot.urdf, "plate")
    np.testing.assert_allclose(arm.pose(Q), HAND @ pose, atol=1e-9)
    carried = {"plate": MountedTarget("bb", pose, tmp_path / "t.urdf")}
    with pytest.raises(ExperimentError, match="no link 'bb' that could carry a target: did you me"):
        made(mounted_targets=carried)


def test_each_joint_has_one_controller_of_one_kind(made):
    assert made({"controllers": ("again", "second")}).find_controllers(("b_j", "a_j")) == (
        {"b_j": "second", "a_j": "again"}, "position")
    assert made().find_controllers(("a_j",)) == ({"a_j": "first"}, "position")
    assert made({"controllers": ("fast",)}).find_controllers(("b_j",))[1] == "velocity"
    for controllers, joints, why in (
        (("frst",), ("a_j",), "names 'frst', which is not in .*did you mean 'first'"),
        (("first", "both"), ("a_j", "b_j", "c_j"), "no single-joint controller for b_j, c_j"),
        (("first", "fast"), ("a_j", "b_j"), r"several kinds \(position, velocity\): list con"),
        ((), ("a_j", "b_j"), "of several kinds"),
    ):
        with pytest.raises(ExperimentError, match=why):
            made({"controllers": controllers}).find_controllers(joints)
    assert set(made({"namespace": "/other/r"}).parameters) == set(made().parameters)
    assert list(made({"namespace": "/other"}).parameters) == ["r"]


def test_files_that_cannot_be_used_are_named(made):
    (made.folder / "bad.yaml").write_text("[1]")
    (made.folder / "bad.urdf").write_text(URDF.replace('<child link="wall"/>', ""))
    for keys, why in (({"config": str(made.folder / "bad.yaml")}, "bad.yaml has no controllers"),
                      ({"urdf": str(made.folder / "none.urdf")}, "there is no file .*none.urdf")):
        with pytest.raises(ExperimentError, match=why):
            made(keys)
    broken = made({"urdf": str(made.folder / "bad.urdf")})
    for ask in (broken.parse_description, broken.make_arm):
        with pytest.raises(ExperimentError, match=r"^/.*bad.urdf: "):
            ask()
    (made.folder / "bare.urdf").write_text('<robot name="x"><link name="world"/></robot>')
    with pytest.raises(ExperimentError, match="bare.urdf: robot description: robot .x. has no li"):
        made({"urdf": str(made.folder / "bare.urdf")}, xyz=(0.1, 0.0, 0.0))


def package(folder, name):
    (folder / name).mkdir(parents=True)
    (folder / name / "package.xml").write_text("<package/>")
    return folder / name


def test_packages_are_looked_for_where_it_is_said_then_here_then_as_ros_does(tmp_path, monkeypatch):
    own, other = package(tmp_path / "a", "mine"), package(tmp_path / "b", "mine")
    ours = package(tmp_path / "c", "aras_visual_servo_bench")
    for folders, name, found in (
        ([tmp_path / "a"], "mine", own), ([str(other)], "mine", other),  # the package itself
        ([tmp_path, tmp_path / "b", tmp_path / "a"], "mine", other),
        ([tmp_path / "c"], "aras_visual_servo_bench", ours),
    ):  # fmt: skip
        assert PackagePath(folders).find(name) == str(found)
    shipped = PackagePath().find("aras_visual_servo_bench")
    assert shipped.endswith("src/aras_visual_servo_bench")
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "a"))
    monkeypatch.setenv("HOME", str(tmp_path))
    assert PackagePath().find("mine") == str(own)
    assert PackagePath(["~/b"]).find("mine") == str(other)
    monkeypatch.setenv("ROS_PACKAGE_PATH", "")
    with pytest.raises(ExperimentError, match=f"package 'none' is neither in {tmp_path}/a, /.* nor "
                       "in ROS_PACKAGE_PATH: add its folder to robot.search"):  # fmt: skip
        PackagePath([tmp_path / "a"]).find("none")


def test_files_are_found_in_packages_and_the_nearest_is_named(tmp_path, monkeypatch):
    own = package(tmp_path, "mine")
    for name in ("arm.urdf", "leg.urdf"):
        (own / name).write_text("x")
    monkeypatch.setenv("HOME", str(own))
    found = PackagePath([tmp_path])
    for given in ("package://mine/arm.urdf", str(own / "arm.urdf"), "~/arm.urdf"):
        assert found.resolve(given) == own / "arm.urdf"
    for given, why in (
            ("package://mine/arn.urdf", f"there is no file {own}/arn.urdf (given as "
             "package://mine/arn.urdf): did you mean 'arm.urdf'?"),
            (f"{own}/other.yaml", f"there is no file {own}/other.yaml"),
            (f"{own}", f"there is no file {own}")):
        with pytest.raises(ExperimentError) as told:
            found.resolve(given)
        assert str(told.value) == why


def test_a_hand_eye_calibration_puts_the_camera(made):
    """The robot's own one, one of several, and that of a robot without a camera; in any unit."""
    found = matrix_from_xyz_rpy((0.02, -0.05, 0.12), (0.1, 0.2, 1.5))
    (made.folder / "bare.urdf").write_text(URDF.replace(EYE + FRAME, ""))
    for units, factor in (("m", 1.0), ("mm", 1e3)):
        file, scaled = str(made.folder / f"{units}.txt"), found.copy()
        scaled[:3, 3] *= factor
        np.savetxt(file, scaled)
        spec = HandEyeSpec(file, units, "b")
        for keys in ({}, {"urdf": str(made.folder / "bare.urdf")}):
            pose = made(keys, hand_eye=spec).make_arm().pose(Q)
            np.testing.assert_allclose(pose, HAND @ found, atol=1e-9)
        robot = made(cameras={"own": CameraSpec(), "other": CameraSpec(hand_eye=spec)})
        for name, hand_T_eye in (("other", found), ("own", HAND_T_LINK @ LINK_T_EYE)):
            np.testing.assert_allclose(robot.make_arm(name).pose(Q), HAND @ hand_T_eye, atol=1e-9)
    # on top, in camera_link
    moved = made(hand_eye=HandEyeSpec(str(made.folder / "m.txt"), link="b"), xyz=(0.0, 0.01, 0.0))
    off = moved.make_arm().pose(Q) - HAND @ found
    assert np.linalg.norm(off[:3, 3]) == pytest.approx(0.01)
    with pytest.raises(ExperimentError, match="hand_eye: .*mm.txt: the translation .* if it is in "
                                              "mm or cm, set units"):  # fmt: skip
        made(hand_eye=HandEyeSpec(file, link="b"))
    with pytest.raises(ExperimentError, match="cameras.other.hand_eye: .* no link 'c'"):
        made(cameras={"other": CameraSpec(hand_eye=HandEyeSpec(file, "mm", "c"))})
