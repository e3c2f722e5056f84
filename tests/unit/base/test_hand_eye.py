"""Hand-eye calibration files: every format gives the same pose; an error is a one-line message."""

import json

import cv2
import numpy as np
import pytest
import yaml

from aras_visual_servo_base.errors import HandEyeFileError
from aras_visual_servo_base.hand_eye_files import read_hand_eye
from aras_visual_servo_base.poses import (
    inverse,
    matrix_from_xyz_rpy,
    optical_pose,
    quaternion_from_matrix,
    xyz_rpy_from_matrix,
)
from aras_visual_servo_base.urdf_changes import mount_camera
from aras_visual_servo_controller.kinematics import Arm

POSE = matrix_from_xyz_rpy((0.021, -0.034, 0.085), (0.3, -2.8, 1.2))
R, T = POSE[:3, :3], POSE[:3, 3]
TURN = cv2.Rodrigues(R)[0].ravel()
Q = [float(v) for v in quaternion_from_matrix(R)]
RPY = xyz_rpy_from_matrix(POSE)[1]
VECTOR = [float(v) for v in (*T, *TURN)]


def words(numbers):
    return " ".join(repr(float(v)) for v in numbers)


def rows(matrix):
    return "\n".join(words(row) for row in matrix) + "\n"


def storage(suffix, **entries):
    store = cv2.FileStorage(f"made{suffix}", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    for name, value in entries.items():
        store.write(name, value)
    return store.releaseAndGetString()


def launch(numbers, tail=""):
    return (f'<launch>\n  <!-- EYE-IN-HAND: tool0 -> head_optical_frame -->\n  <node pkg="tf2_ros" '
            f'type="static_transform_publisher" name="b"\n      args="{words(numbers)}   tool0 '
            f'head_optical_frame{tail}" />\n</launch>\n')  # fmt: skip


def launch_py(flags):
    lines = "".join(f'                "{flag}",\n                "{value}",\n'
                    for flag, value in flags.items())  # fmt: skip
    return f"""from launch_ros.actions import Node
def generate_launch_description():
    nodes = [Node(package="tf2_ros", executable="static_transform_publisher", output="log",
            arguments=[
{lines}                # "--roll", "0.5",
            ])]
"""


FRAMES = {"--frame-id": "tool0", "--child-frame-id": "head_optical_frame"}
XYZ = dict(zip(("--x", "--y", "--z"), T.tolist(), strict=True))
VISP_XML = ("<root><homogeneous_transformation><name>eMc</name><values>" + "".join(
    f"<{tag}>{v!r}</{tag}>" for tag, v in zip(
        ("tx", "ty", "tz", "theta_ux", "theta_uy", "theta_uz"), VECTOR, strict=True)
) + "</values></homogeneous_transformation></root>")  # fmt: skip
FORMATS = {
    "matrix.txt": rows(POSE), "commas.csv": rows(POSE).replace(" ", ", "),
    "matrix.yaml": yaml.safe_dump({"T_cam2gripper": POSE.tolist()}),
    "list.yaml": yaml.safe_dump(POSE.tolist()),
    "inverse.yaml": yaml.safe_dump({"T_gripper2cam": inverse(POSE).tolist()}),
    "cv.yaml": storage(".yaml", R_cam2gripper=R, t_cam2gripper=T[:, None]),
    "cv.xml": storage(".xml", R=R, t=T[:, None]), "cv4.xml": storage(".xml", eMc=POSE),
    "cv.json": storage(".json", rvec=TURN, tvec=T),
    "rt.yaml": yaml.safe_dump({"R_cam2gripper": R.tolist(), "t_cam2gripper": T.tolist()}),
    "rt_mm.yaml": yaml.safe_dump({"R": R.tolist(), "t": (1e3 * T).tolist(), "units": "mm"}),
    "rt_mm.json": json.dumps({"units": "mm", "R": R.tolist(), "t": (1e3 * T).tolist()}),
    "eMc.txt": "\n".join(map(repr, VECTOR)),
    "eMc.yaml": "# eMc\n" + yaml.safe_dump({"rows": 6, "cols": 1, "data": [[v] for v in VECTOR]}),
    "eMc4.yaml": yaml.safe_dump({"rows": 4, "cols": 4, "data": POSE.tolist()}), "eMc.xml": VISP_XML,
    "moveit.launch": launch((*T, *Q)), "tf.launch": launch((*T, *RPY[::-1]), " 100"),
    "moveit.launch.py": launch_py({**FRAMES, **XYZ, **dict(
        zip(("--qx", "--qy", "--qz", "--qw"), Q, strict=True))}),
    "rpy.launch.py": launch_py({**FRAMES, **XYZ, **dict(
        zip(("--roll", "--pitch", "--yaw"), RPY, strict=True))}),
    "easy.yaml": yaml.safe_dump({
        "parameters": {"eye_on_hand": True, "robot_effector_frame": "tool0",
                       "robot_base_frame": "base", "tracking_base_frame": "head_optical_frame"},
        "transformation": dict(zip(("x", "y", "z", "qx", "qy", "qz", "qw"), (*T.tolist(), *Q),
                                   strict=True))}),
    "tf.yaml": yaml.safe_dump({
        "header": {"frame_id": "tool0"}, "child_frame_id": "head_optical_frame", "transform": {
            "translation": dict(zip("xyz", T.tolist(), strict=True)),
            "rotation": dict(zip("xyzw", Q, strict=True))}}),
}  # fmt: skip


@pytest.mark.parametrize("name", FORMATS)
def test_each_format_gives_its_pose_and_a_file_that_is_cut_off_none_or_the_same(tmp_path, name):
    text, path = FORMATS[name], tmp_path / name
    path.write_text(text)
    found = read_hand_eye(path)
    np.testing.assert_allclose(found.link_T_camera, POSE, atol=1e-9)
    if "launch" in name or name in ("easy.yaml", "tf.yaml"):
        assert (found.link, found.frame) == ("tool0", "head_optical_frame")
    last = len(text.rstrip().rstrip("0123456789"))  # a number's own end cannot be told
    for end in range(0, min(len(text), last), 7):
        path.write_text(text[:end])
        try:
            found = read_hand_eye(path)
        except HandEyeFileError as error:
            assert str(path) in str(error) and "\n" not in str(error)
        else:
            np.testing.assert_allclose(found.link_T_camera, POSE, atol=1e-9, err_msg=text[:end])


@pytest.mark.parametrize(("text", "units", "says"), [
    (rows(POSE @ np.diag([1, 1, 1, 1]) + 1e3 * np.pad(T[:, None], ((0, 1), (3, 0)))), "",
     "m long; if it is in mm"),
    (rows(POSE), "mm", "long in mm; correct units"), (rows(POSE), "inch", "'inch', must be m, cm"),
    (rows(POSE.T), "", "last row .* transpose it"), (rows(POSE[:3]), "", "has 12 numbers"),
    (rows(POSE @ np.diag([1, 1, -1, 1])), "", "is not a rotation"),
    (words((*T, *np.degrees(TURN))), "", "theta u .* looks like degrees; give it in rad"),
    (launch((*T, *np.degrees(RPY))), "", "look like degrees; give rad"),
    (launch((*T, 0.5, 0.5, 0.5, 0.1)), "", "quaternion .* must be 1"),
    (launch((*T, *Q)).replace("tool0", ""), "", "then two frames"),
    (VISP_XML.replace("theta_uy", "other"), "", "<theta_uy> is None"),
    (yaml.safe_dump({"R": R.tolist()}), "", "the rotation R, but not the translation t"),
    ("a: 1\n", "", "contains only a; add"),
    (yaml.safe_dump({"rows": 6, "cols": 1, "data": VECTOR[:5]}), "", "data has 5 numbers"),
])  # fmt: skip
def test_what_is_wrong_is_named(tmp_path, text, units, says):
    path = tmp_path / "file"
    path.write_text(text)
    with pytest.raises(HandEyeFileError, match=says) as refused:
        read_hand_eye(path, units)
    assert str(path) in str(refused.value) and "\n" not in str(refused.value)


LINKS = "".join(f"<link name='{n}'/>" for n in ("base", "tool0"))
JOINT = ("<joint name='j' type='revolute'><parent link='base'/><child link='tool0'/>"
         "<axis xyz='0 0 1'/><origin xyz='0.3 0 0.2' rpy='0.1 0 0'/>"
         "<limit lower='-3' upper='3' effort='1' velocity='1'/></joint>")
CAMERA = ("<link name='camera_link'/><joint name='c' type='fixed'><parent link='tool0'/><child "
          "link='camera_link'/><origin xyz='1 2 3'/></joint>")
SENSOR = ("<gazebo reference='camera_link'><sensor type='camera' name='s'><camera/>"
          "<pose>0.1 0 0.02 0 0.3 0</pose></sensor></gazebo>")
TILTED = ("<link name='camera_optical_frame'/><joint name='o' type='fixed'><parent link="
          "'camera_link'/><child link='camera_optical_frame'/><origin xyz='0.01 0 0' "
          "rpy='-1.6 0 -1.5'/></joint>")


@pytest.mark.parametrize(("more", "link"), [("", "camera_link"), *(
    (more, link) for more in ("", CAMERA, CAMERA + SENSOR, CAMERA + TILTED)
    for link in ("tool0", ""))])  # fmt: skip
def test_the_optical_frame_is_put_where_it_was_found(tmp_path, more, link):
    """On a robot without a camera, with a camera's link, a sensor in it that is turned, and an
    optical frame of its own; where the file places the camera's link, x forward, that is there, on
    a robot that has neither."""
    path, places_link = tmp_path / "hand_eye", link == "camera_link"
    frame = link if places_link else "head_optical_frame"
    text = launch((*T, *Q)).replace("head_optical_frame", frame)
    path.write_text(rows(POSE) if link == "tool0" else text)
    urdf = f"<robot name='r'>{LINKS}{JOINT}{more}</robot>"
    made = mount_camera(urdf, read_hand_eye(path), link * (not places_link), "camera_optical_frame")
    base_T_tool0 = matrix_from_xyz_rpy((0.3, 0, 0.2), (0.1, 0, 0)) @ matrix_from_xyz_rpy(
        (0, 0, 0), (0, 0, 0.4)
    )
    pose = Arm.from_urdf(made, "camera_optical_frame").pose(np.array([0.4]))
    wanted = optical_pose(POSE) if places_link else POSE
    np.testing.assert_allclose(pose, base_T_tool0 @ wanted, atol=1e-9)


@pytest.mark.parametrize(("text", "link", "says"), [
    (rows(POSE), "", "does not name the link"), (rows(POSE), "tool", "no link 'tool'.*'tool0'"),
    (rows(POSE), "camera_link", "is the camera itself"),
    (launch((*T, *Q)).replace("head_optical_frame", "head"), "", "the pose of the frame 'head'"),
])  # fmt: skip
def test_a_link_that_cannot_carry_the_camera_is_named(tmp_path, text, link, says):
    path = tmp_path / "hand_eye"
    path.write_text(text)
    with pytest.raises(HandEyeFileError, match=says):
        mount_camera(f"<robot name='r'>{LINKS}{JOINT}{CAMERA}</robot>", read_hand_eye(path), link,
                    "camera_optical_frame")  # fmt: skip
