"""The report's reader: a bag of real message types back into the run it was made of."""

from __future__ import annotations

import numpy as np
import pytest
import rosbag
import rospy
from aras_visual_servo_camera.msg import ImageMoments
from geometry_msgs.msg import TransformStamped
from sensor_msgs.msg import CameraInfo, Image, JointState
from tf2_msgs.msg import TFMessage

from aras_visual_servo_bench.assembly import assemble
from aras_visual_servo_bench.experiment import Experiment
from aras_visual_servo_bench.report import analysis
from aras_visual_servo_bench.ros.bag import read_bag
from aras_visual_servo_bench.runner import Loop
from aras_visual_servo_camera.moments import Moments
from aras_visual_servo_controller.errors import ServoError
from aras_visual_servo_controller.ros.messages import report_message, state_message

NAMESPACE = "/aras_visual_servo"


def transform(parent, child, pose, stamp):
    """TransformStamped of a (4, 4) whose rotation is no half turn."""
    message = TransformStamped(child_frame_id=child)
    message.header.frame_id, message.header.stamp = parent, stamp
    translation, rotation = message.transform.translation, message.transform.rotation
    translation.x, translation.y, translation.z = pose[:3, 3]
    R = pose[:3, :3]
    w = 0.5 * np.sqrt(max(1.0 + np.trace(R), 1e-12))
    rotation.w = w
    rotation.x, rotation.y, rotation.z = (
        np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / (4.0 * w)
    )
    return message


def write_run(path, year="2016", optical=True, seconds=4.0):
    """Record a run of the runner as the recorder would; returns last joints, arm and goal."""
    experiment = Experiment(plant="chain", start=year, duration=seconds, linger=None)
    loop = Loop(experiment, assemble(experiment))
    arm = loop.plant.arm
    # The camera hangs upside down: split its turn, for a half turn has no unique small quaternion.
    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    link_T_optical = np.eye(4)
    link_T_optical[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
    seen = []
    while (state := loop.to_image()) is not None:
        seen.append((state, loop.plant.joints()[0], loop.reading.outline))

    with rosbag.Bag(str(path), "w") as bag:
        half = transform("base_link", "upside_down", np.eye(4), rospy.Time(1))
        half.transform.rotation.x, half.transform.rotation.w = 1.0, 0.0
        static = [half]
        if optical:
            static.append(
                transform("camera_link", "camera_optical_frame", link_T_optical, rospy.Time(1))
            )
        bag.write("/tf_static", TFMessage(static), rospy.Time(1))
        for seen_state, q, outline in seen:
            stamp = seen_state.stamp
            time = rospy.Time.from_sec(1.0 + stamp)
            later = rospy.Time.from_sec(1.004 + stamp)

            joints = JointState(name=[*arm.names[1:], "gantry"], position=[*q[1:], q[0]])
            joints.header.stamp = time
            bag.write(f"{NAMESPACE}/joint_states", joints, later)

            pose = flip @ arm.pose(q) @ np.linalg.inv(link_T_optical)
            bag.write(
                "/tf", TFMessage([transform("upside_down", "camera_link", pose, time)]), later
            )

            info = CameraInfo(width=4, height=2, K=[100.0, 0, 160, 0, 100, 120, 0, 0, 1],
                              D=[0.0] * 4, distortion_model="equidistant")
            bag.write("/labrob/camera/camera_info", info, later)
            image = Image(encoding="rgb8", width=4, height=2, step=12, data=bytes(range(24)))
            image.header.stamp = time
            bag.write("/labrob/camera/image_raw", image, later)

            moments = ImageMoments(valid=True, order=4)
            moments.header.stamp = time
            measured = Moments.from_polygon(outline, 4)
            moments.m = measured.m_array.tolist()
            moments.mu = measured.mu_array.tolist()
            bag.write(f"{NAMESPACE}/camera/moments", moments, later)

            state = state_message(seen_state, "moments", "camera_optical_frame", arm.names)
            report = report_message(seen_state, "camera_optical_frame", arm.names)
            state.header.stamp = report.header.stamp = time
            bag.write(f"{NAMESPACE}/controller/state", state, later)
            bag.write(f"{NAMESPACE}/controller/diagnosis", report, later)
    return seen[-1][1], arm, loop.servo.goal


@pytest.mark.parametrize("optical", [True, False])
def test_bag_gives_the_run_back(tmp_path, optical):
    path = tmp_path / "run.bag"
    last, arm, goal = write_run(path, optical=optical)
    run = read_bag(path)
    np.testing.assert_allclose(run.joints[-1], last)
    np.testing.assert_allclose(run.camera_pose[-1], arm.pose(last), atol=1e-6)
    assert run.outcome == "converged"
    assert run.images.first.shape == (2, 4, 3)
    assert run.images.first[0, 1, 2] == 5
    column, row = run.images.camera.project([1.0], [0.0])  # 45 degrees to the right
    np.testing.assert_allclose([column[0], row[0]], [160 + 100 * np.pi / 4, 120])

    summary = analysis.summarise(run, goal)
    assert summary["converged"] is True
    assert summary["final_camera_error"]["position_mm"] < 0.1
    assert summary["image_rate_hz"] == pytest.approx(30.0, abs=0.01)
    assert summary["images_late"] == 0


def test_bags_that_cannot_be_reported_on_are_named(tmp_path):
    with pytest.raises(ServoError, match="cannot read the bag"):
        read_bag(tmp_path / "none.bag")
    broken = tmp_path / "broken.bag"
    broken.write_bytes(b"#ROSBAG V2.0\n" + b"\0" * 50)
    with pytest.raises(ServoError, match="cannot read the bag"):
        read_bag(broken)
    empty = tmp_path / "empty.bag"
    with rosbag.Bag(str(empty), "w") as bag:
        bag.write("/clock", JointState(), rospy.Time(1))
    with pytest.raises(ServoError, match="holds no states of a servoing controller"):
        read_bag(empty)
