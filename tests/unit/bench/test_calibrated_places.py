"""Hand-eye files give the true poses of fixed cameras and the calibrated poses of cameras."""

import numpy as np
import pytest

from aras_sim_bridge.camera import mounting
from aras_sim_bridge.errors import CameraError
from aras_visual_servo_base.poses import matrix_from_xyz_rpy, optical_pose, xyz_rpy_from_matrix
from aras_visual_servo_base.urdf import parse_tree
from aras_visual_servo_bench import Experiment, assemble
from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.experiment.hand_eye_poses import (
    with_calibration_offsets,
    with_fixed_cameras,
)
from aras_visual_servo_bench.experiment.robots import Robot

OFF = matrix_from_xyz_rpy((0.004, -0.003, 0.006), (0.02, -0.03, 0.05))
PLACE = matrix_from_xyz_rpy((0.3, -0.2, 0.9), (3.0, 0.1, 0.4))


def written(path, matrix, factor=1.0):
    scaled = np.array(matrix)
    scaled[:3, 3] *= factor
    np.savetxt(path, scaled)
    return str(path)


def find_pose(**keys):
    parts = assemble(Experiment.from_mapping({"plant": "chain", "scheme": "points", **keys}))
    return parts.servo.arm.pose(np.linspace(0.1, 0.5, len(parts.servo.arm.names)))


def test_a_camera_is_believed_where_a_file_says(tmp_path):
    xyz, rpy = xyz_rpy_from_matrix(OFF)
    expected = find_pose(calibration_offset={"xyz": xyz, "rpy": rpy})
    robot = Robot(Experiment().robot)
    carriers = [joint.parent for joint in parse_tree(robot.urdf).find_path("", "camera_link")]
    for link in ("camera_link", carriers[-1]):
        file = written(tmp_path / f"{link}.txt", robot.compute_mounting(link) @ OFF, 1e3)
        offset = {"hand_eye": {"file": file, "link": link, "units": "mm"}}
        np.testing.assert_allclose(find_pose(calibration_offset=offset), expected, atol=1e-9)
    found = find_pose(cameras={"own": {"calibration_offset": offset}}, scheme="points@own")
    np.testing.assert_allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize("plant", ["free", "chain"])
def test_a_fixed_camera_is_where_a_file_says(tmp_path, plant):
    file = written(tmp_path / "wall.txt", PLACE)
    off = written(tmp_path / "off.txt", PLACE @ OFF)
    xyz, rpy = xyz_rpy_from_matrix(OFF)

    def places(**wall):
        experiment = Experiment.from_mapping({
            "plant": plant, "scheme": "points@own", "cameras": {"own": {}, "wall": wall}})
        assemble(experiment)
        robot = Robot(experiment.robot)
        fixed = with_fixed_cameras(experiment, robot.packages)
        spec = with_calibration_offsets(fixed, robot).cameras["wall"]
        return [*spec.pose, *spec.calibration_offset.xyz, *spec.calibration_offset.rpy]

    given = places(hand_eye={"file": file, "link": "world"},
                   calibration_offset={"hand_eye": {"file": off, "link": "world"}})
    expected = places(pose=[*np.concatenate(xyz_rpy_from_matrix(PLACE))],
                      calibration_offset={"xyz": xyz, "rpy": rpy})
    np.testing.assert_allclose(given, expected, atol=1e-9)


@pytest.mark.parametrize(("keys", "reason"), [
    ({"calibration_offset": {"hand_eye": {"file": "wall.txt", "link": "J1"}}}, "hand_eye: "),
    ({"calibration_offset": {"hand_eye": {"file": "wall.txt"}}}, "file does not name the link"),
    ({"calibration_offset": {"hand_eye": "wall.txt", "xyz": [0.1, 0, 0]}},
     "calibration_offset.hand_eye already gives the camera's pose"),
    ({"calibration_offset": {"hand_eye": "wall.txt"}, "plant": "free"},
     "plant 'free' has no arm: set calibration_offset"),
    ({"cameras": {"a": {"hand_eye": "wall.txt"}}, "plant": "free"},
     "plant 'free' has no arm: use plant chain or bullet; if the camera is fixed, set"),
    ({"cameras": {"a": {}, "b": {"hand_eye": {"file": "none.txt", "link": "world"}}}}, "none.txt"),
])  # fmt: skip
def test_a_place_that_cannot_be_is_named(tmp_path, monkeypatch, keys, reason):
    monkeypatch.chdir(tmp_path)
    written(tmp_path / "wall.txt", PLACE)
    with pytest.raises(ExperimentError, match=reason) as refused:
        find_pose(**keys)
    assert "\n" not in str(refused.value)


def test_optical_axes_are_those_of_the_file(tmp_path):
    """The bridge's world cameras look along their x; files have the optical frame."""
    base = {"parent": "world", "width": 32, "height": 24}
    file = written(tmp_path / "wall.txt", PLACE, 1e3)
    place = {"file": file, "units": "mm"}
    _, found = mounting.configure_world_camera("cam", {**base, "hand_eye": place}, {}, 0)
    np.testing.assert_allclose(optical_pose(found.matrix()), PLACE, atol=1e-9)
    for wrong, reason in (
        ({"hand_eye": file}, "if it is in mm or cm, set units"),
        ({"hand_eye": place, "pose": [0] * 6}, "pose and hand_eye both define the camera's pose"),
        ({"hand_eye": {"path": file}}, "hand_eye"),
    ):
        with pytest.raises(CameraError, match=reason):
            mounting.configure_world_camera("cam", {**base, **wrong}, {}, 0)
