"""The kernel scheme: its mended Jacobian against a moved camera, and its closed loop."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from aras_visual_servo_camera.kernel import kernel_features
from aras_visual_servo_controller.before import laws, schemes, servo
from aras_visual_servo_controller.before.schemes import Measurement
from aras_visual_servo_controller.before.schemes.base import wrap
from aras_visual_servo_controller.desired import DesiredKernel
from aras_visual_servo_controller.errors import MeasurementError, UnreachableError
from aras_visual_servo_controller.kinematics import pose_difference, rotation_rpy
from aras_visual_servo_controller.target import outline
from aras_visual_servo_controller.virtual_robot import VirtualRobot

CAMERA = (320, 240, np.array([[102.74, 0, 159.5], [0, 102.74, 119.5], [0, 0, 1.0]]))


def finer(factor):
    """The camera with so many times the pixels."""
    width, height, K = CAMERA
    K = K.copy()
    K[:2] *= factor
    K[:2, 2] += 0.5 * (factor - 1)
    return width * factor, height * factor, K


# The same target without thickness: a Jacobian knows of no side walls.
FLAT = np.array(
    [
        (-0.025, -0.025, 0.5905),
        (-0.0175, -0.025, 0.5905),
        (-0.0175, -0.0375, 0.5905),
        (0.0075, -0.0375, 0.5905),
        (0.0075, -0.025, 0.5905),
        (0.025, -0.025, 0.5905),
        (0.025, 0.025, 0.5905),
        (-0.025, 0.025, 0.5905),
    ]
)


def flat_outline(pose):
    seen = (FLAT - pose[:3, 3]) @ pose[:3, :3]
    return seen[:, :2] / seen[:, 2:]


def features_at(pose, camera, view=outline):
    """Kernel features of the target's rasterised outline."""
    width, height, K = camera
    pixels = view(pose) @ K[:2, :2].T + K[:2, 2]
    mask = np.zeros((height, width), np.uint8)
    cv2.fillPoly(mask, [np.round(pixels * 256).astype(np.int32)], 255, shift=8)
    return kernel_features(mask)


def measured(pose, camera, stamp=0.0):
    width, height, K = camera
    data = np.array(features_at(pose, camera).layout())
    return Measurement(stamp, kernel=data, K=K, width=width, height=height)


def kernel_desired(loops, year, camera):
    width, height, K = camera
    joints = np.array(loops.desired_joints[year])
    values = features_at(loops.kinematics.pose(joints), camera).values
    return replace(loops.desired(year), kernel=DesiredKernel(width, height, K, values))


def moved(pose, twist, dt):
    """world_T_optical after a small motion of the camera in its own frame."""
    after = pose.copy()
    after[:3, 3] += pose[:3, :3] @ twist[:3] * dt
    after[:3, :3] = pose[:3, :3] @ rotation_rpy(*(twist[3:] * dt))
    return after


@pytest.mark.parametrize("start", ["2015", "2016"])
def test_mended_jacobian_is_the_derivative_of_the_features(loops, start):
    camera = finer(8)
    scheme = schemes.create("kernel", kernel_desired(loops, "2015", camera), laws.Proportional())
    pose = loops.kinematics.pose(np.array(loops.starts[start]))
    now = features_at(pose, camera, flat_outline)
    exact = scheme._metric_jacobian(now.jacobian, camera[2], now.values)
    # Columns of J: along the rows (optical y), along the columns (x), axis (z), rows to columns.
    motions = np.zeros((4, 6))
    motions[0, 1] = motions[1, 0] = motions[2, 2] = 1.0
    motions[3, 5] = -1.0
    for column, (motion, size) in enumerate(zip(motions, (1e-2, 1e-2, 5e-3, 5e-2), strict=True)):
        after = features_at(moved(pose, motion, size), camera, flat_outline).values
        before = features_at(moved(pose, motion, -size), camera, flat_outline).values
        change = after - before
        change[3] = wrap(change[3], np.pi)
        slope = change / (2 * size)
        scale = np.abs(exact).max(axis=1)
        np.testing.assert_allclose(slope[:3] / scale[:3], exact[:3, column] / scale[:3], atol=0.05)
        # A binary image leaves the angle of a near-square some 4 mrad of noise.
        assert slope[3] == pytest.approx(exact[3, column], abs=0.3)


def test_kernel_scheme_converges_from_the_2015_start(loops):
    desired = kernel_desired(loops, "2015", CAMERA)
    loop = loops.servo("2015", "kernel", desired=desired)
    robot = VirtualRobot(np.array(loops.starts["2015"]))

    def look(stamp):
        return measured(loops.kinematics.pose(robot.q), CAMERA, stamp)

    history = robot.run(loop, 7.0, look)
    assert history[-1].phase == servo.CONVERGED
    goal = loops.kinematics.pose(desired.joints)
    distance, angle = pose_difference(goal, loops.kinematics.pose(robot.q))
    assert distance < 2e-3
    assert angle < np.radians(2.0)


def original_law(data, desired, read_transposed):
    """The 2015 controller's velocity in its own frame: x along the world's y, y along x, z up."""
    inverse = data[:16].reshape(4, 4)
    if read_transposed:
        inverse = inverse.T
    u = -np.array([200.0, 200.0, 200.0, -0.01]) * (inverse @ (data[16:] - desired))
    u[0] = -u[0]
    return u


def test_original_law_runs_into_the_stretched_arm(loops):
    """Why the law is mended, part one: as shipped it overshoots the reach after some 14 s."""
    goal = features_at(loops.kinematics.pose(np.zeros(6)), CAMERA).values
    q = np.array(loops.starts["2015"])
    place, yaw = loops.kinematics.pose(q)[:3, 3], 0.0
    with pytest.raises(UnreachableError, match="outside the reach"):
        for _ in range(600):
            data = np.array(features_at(loops.kinematics.pose(q), CAMERA).layout())
            u = original_law(data, goal, read_transposed=True)
            c, s = np.cos(yaw), np.sin(yaw)
            x, y = c * u[0] - s * u[1], s * u[0] + c * u[1]
            place = place + 0.01 * np.array([y, x, -u[2]])
            yaw += 0.01 * u[3]
            q = loops.kinematics.inverse(place, yaw)
    assert np.abs(place[:2]).max() < 0.03  # it was on its way to the goal


def test_original_law_read_as_sent_asks_for_metres_a_second(loops):
    """Part two: without the transposition the rotation's coupling is 3180 times too strong."""
    goal = features_at(loops.kinematics.pose(np.zeros(6)), CAMERA).values
    pose = loops.kinematics.pose(np.array(loops.starts["2015"]))
    data = np.array(features_at(pose, CAMERA).layout())
    assert np.abs(original_law(data, goal, read_transposed=False)[:2]).min() > 10.0


def test_kernel_scheme_refuses_what_it_cannot_use(loops):
    scheme = schemes.create("kernel", kernel_desired(loops, "2015", CAMERA), laws.Proportional())
    pose = loops.kinematics.pose(np.array(loops.starts["2015"]))
    good = measured(pose, CAMERA)
    for changed, words in (
        ({"kernel": np.zeros(20)}, "not visible"),
        ({"kernel": np.zeros(4)}, "expected the 20 numbers of the kernel layout, got 4"),
        ({"kernel": None}, "got none"),
        ({"kernel": np.full(20, np.nan)}, "not visible"),
        ({"width": 640}, "another camera"),
        ({"K": 2.0 * good.K}, "another camera"),
        ({"pixel_count": 300}, "counts 8.. pixels as target, which has 300: .*original_threshold"),
    ):
        with pytest.raises(MeasurementError, match=words):
            scheme.compute(replace(good, **changed), 0.0)
