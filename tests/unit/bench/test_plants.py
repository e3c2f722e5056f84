"""Plants: one interface, exact motion, true poses, measurements at their instants."""

import contextlib
import dataclasses

import numpy as np
import pytest
from scipy.linalg import expm

from aras_visual_servo_base.poses import exponential, inverse, logarithm, matrix_from_xyz_rpy, skew
from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.experiment.robot_spec import RobotSpec
from aras_visual_servo_bench.experiment.robots import Robot
from aras_visual_servo_bench.plants import JointReading
from aras_visual_servo_bench.plants.dynamic_arm import DynamicArm
from aras_visual_servo_bench.plants.free_camera_kinematics import FreeCameraKinematics
from aras_visual_servo_bench.plants.ideal_camera import IdealCamera, IdealCameraIK
from aras_visual_servo_bench.plants.imaging import ImagingSettings
from aras_visual_servo_bench.plants.kinematic import FreeCamera, KinematicArm
from aras_visual_servo_bench.runner.loop import Loop, run
from aras_visual_servo_bench.setup.assembly import assemble
from aras_visual_servo_bench.targets.geometry import PlacedTarget, PolygonTarget
from aras_visual_servo_controller.errors import MeasurementError
from aras_visual_servo_controller.kinematics.task import Task
from aras_visual_servo_controller.observation.frame import Frame

START = np.array([0.1, 0.0, 0.17, -0.09, -0.09, 0.3])


ORIGIN, MOUNTING = matrix_from_xyz_rpy((0.1, 0.2, 0.9), (2.9, 0.2, 0.4)), matrix_from_xyz_rpy(
    (0.02, -0.01, 0.03), (0.1, -0.1, 0.3))
Q, TWIST = np.array([0.02, -0.01, 0.03, 0.1, -0.2, 0.3]), np.array([0.1, -0.3, 0.2, 0.4, 0.5, -0.6])
SQUARE = PolygonTarget(((-0.02, -0.02), (0.02, -0.02), (0.02, 0.02), (-0.02, 0.02)))


@pytest.fixture
def sight(pinhole):
    table = np.eye(4)
    table[2, 3] = 0.59
    return ImagingSettings(pinhole, PlacedTarget(SQUARE, table))


def until(plant, time_ns):
    readings = []
    while plant.time_ns < time_ns:
        readings += plant.advance(time_ns)
    return readings


def bullet(robot, preset, **options):
    joints = dict(zip(robot.make_arm().names, START, strict=True))
    camera = {**preset, **options.pop("camera", {})}
    return DynamicArm(robot, camera, joints, **options)


def test_the_simulated_arm_measures_when_a_graph_does(robot, preset):
    with contextlib.closing(bullet(robot, preset)) as plant:
        readings = until(plant, 101_000_000)
    joints = [r.stamp_ns for r in readings if isinstance(r, JointReading)]
    images = [r for r in readings if isinstance(r, Frame)]
    assert joints[:3] == [1_000_000, 10_000_000, 20_000_000]
    assert [r.stamp_ns for r in images] == [33_333_333, 66_666_667, 100_000_000]
    assert images[0].image.shape == (240, 320, 3)


def test_the_simulated_arm_is_spawned_at_its_start_and_moves_as_told(robot, preset, arm):
    with contextlib.closing(bullet(robot, preset, record_peak_speeds=True)) as plant:
        np.testing.assert_allclose(plant.read_joints()[0], START, atol=1e-5)
        goal = START + [0.0, 0.0, 0.0, 0.0, 0.0, -0.2]  # one way alone, but for some swinging
        plant.command("position", goal)
        until(plant, 1_000_000_000)
        q, _ = plant.read_joints()
        np.testing.assert_allclose(q, goal, atol=2e-2)
        assert q[5] - START[5] < -0.18
        # The pose is the physics', equal to the kinematics at the true joints.
        np.testing.assert_allclose(plant.read_pose(), arm.pose(q), atol=1e-6)
        assert 1.0 < plant.peak_speed[5] < 20.0
        with pytest.raises(ExperimentError, match="accept position commands, not velocity"):
            plant.command("velocity", goal)


@pytest.mark.parametrize(("change", "complaint"), [
    ({"urdf": "package://nowhere/arm.urdf"}, "package 'nowhere'"),
    ({"camera": "left"}, "no camera 'left'"),
    ({"camera_frame": "camera_optical_frme"}, "camera_optical_frme")])  # fmt: skip
def test_impossible_robots_are_refused(preset, change, complaint):
    with pytest.raises(ExperimentError, match=complaint):
        bullet(Robot(RobotSpec(**change)), preset)


@pytest.mark.parametrize("lag", [0.0, 0.08])
def test_a_free_camera_is_where_its_coordinates_are_whatever_it_is_told(sight, lag):
    body = FreeCameraKinematics(matrix_from_xyz_rpy((0.3, -0.2, 0.9), (2.9, 0.2, 0.4)))
    begin = np.array([0.02, -0.01, 0.03, 0.1, -0.2, 0.3])
    camera = FreeCamera(body, begin, sight, joint_rate=500.0, lag=lag)
    np.testing.assert_allclose(camera.read_pose(), body.pose(begin))
    goal = np.array([0.05, 0.04, -0.02, -0.3, 0.1, 0.6])
    h = 3e-3
    rest = np.exp(-h / lag) if lag else 0.0
    for kind, values in (("position", goal), ("velocity", goal[::-1]), ("position", begin)):
        asked = body.jacobian(camera.read_joints()[0]) @ values
        camera.command(kind, values)
        for _ in range(5):
            before, (q, rates) = camera.read_pose(), camera.read_joints()
            twist = body.jacobian(q) @ rates
            until(camera, camera.time_ns + round(1e9 * h))
            now, rates = camera.read_joints()
            np.testing.assert_allclose(camera.read_pose(), body.pose(now), atol=1e-12)
            if kind == "position":
                np.testing.assert_allclose(now, values + rest * (q - values), atol=1e-12)
                continue
            np.testing.assert_allclose(
                body.jacobian(now) @ rates, asked + rest * (twist - asked), atol=1e-9)
            moved = logarithm(inverse(before) @ camera.read_pose())
            behind = (twist - asked) * lag * (1.0 - rest)
            np.testing.assert_allclose(moved, asked * h + behind, atol=1e-7)


@pytest.mark.parametrize("mounted", [False, True])
@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 0.3, 1.5, 3.1, 6.0])
def test_a_free_bodys_jacobian_is_exact_at_any_turn(arm, angle, mounted):
    mounting = matrix_from_xyz_rpy((0.02, -0.01, 0.03), (0.3, -0.4, 0.9)) if mounted else None
    body = FreeCameraKinematics(arm.pose(START), mounting)
    move, axis = np.array([0.1, -0.2, 0.05]), np.array([0.48, -0.36, 0.8])
    turned = skew(angle * axis)
    ad = np.block([[turned, skew(move)], [np.zeros((3, 3)), turned]])
    # The right Jacobian is the integral of exp(-s ad) over s from 0 to 1: by one exponential.
    whole = expm(np.block([[-ad, np.eye(6)], [np.zeros((6, 12))]]))[:6, 6:]
    if mounted:
        R, lever = mounting[:3, :3], skew(mounting[:3, 3])
        whole = np.block([[R.T, -R.T @ lever], [np.zeros((3, 3)), R.T]]) @ whole
    q = np.array([*move, *(angle * axis)])
    np.testing.assert_allclose(body.jacobian(q), whole, atol=2e-13)


def test_a_free_body_answers_what_an_arm_does():
    body, q = FreeCameraKinematics(ORIGIN, MOUNTING), Q
    assert len(body) == 6 and body.names == ("x", "y", "z", "rx", "ry", "rz")
    assert np.isinf([body.upper, -body.lower, body.velocity, body.effort]).all()
    assert (body.lower < 0.0).all() and body.is_prismatic.tolist() == [True] * 3 + [False] * 3
    pose, jacobian = body.pose_and_jacobian(q)
    np.testing.assert_allclose(pose, ORIGIN @ exponential(q) @ MOUNTING, atol=1e-12)
    np.testing.assert_array_equal(jacobian, body.jacobian(q))
    np.testing.assert_allclose(body.inverse_kinematics(pose, np.ones(6), 0.1), q, atol=1e-12)
    np.testing.assert_allclose(body.coordinates(pose), q, atol=1e-12)
    places, axes = body.joint_frames(q)
    assert not places.any() and axes.tolist() == [*np.eye(3).tolist(), *np.eye(3).tolist()]
    for speed in ((), np.arange(6.0)):
        sample = body.read_joints(("a",), q.tolist(), speed, 2.5)
        np.testing.assert_array_equal(sample.positions, q)
        np.testing.assert_array_equal(sample.velocities, np.arange(6.0) if len(speed) else 0 * q)
        assert (sample.stamp, sample.names) == (2.5, body.names)
    for bad in ((q * np.nan, q), (q, np.full(6, np.inf))):
        with pytest.raises(MeasurementError, match="a coordinate of the free camera is not finite"):
            body.read_joints(body.names, *bad)
    body.check(q)


def test_what_a_plant_cannot_take_is_said_with_numbers(arm, sight):
    chain = KinematicArm(arm, START, sight)
    for kind, values, why in (
            ("effort", START, "this plant accepts position or velocity commands, not effort"),
            ("position", START[:5], "a command must be 6 finite numbers, got "),
            ("velocity", np.full(6, np.inf), "a command must be 6 finite numbers, got ")):
        with pytest.raises(ExperimentError) as told:
            chain.command(kind, values)
        assert str(told.value).startswith(why)


def test_joint_states_and_images_come_at_their_rates(arm, sight):
    plant = KinematicArm(arm, START, dataclasses.replace(sight, rate=8.0), joint_rate=4.0)
    assert plant.advance(500_000) == [] and plant.time_ns == 500_000
    stamps = [(r.stamp_ns, type(r).__name__) for r in until(plant, 520_000_000)]
    joints = [(1_000_000 + k * 250_000_000, "JointReading") for k in range(3)]
    assert stamps == sorted([*joints, *((k * 125_000_000, "Frame") for k in range(1, 5))])
    np.testing.assert_array_equal(plant.compute_rest_poses(np.array([START, START + 0.01])),
                                  [arm.pose(START), arm.pose(START + 0.01)])
    np.testing.assert_array_equal(plant.joint_origins(START[None]), arm.joint_origins(START[None]))
    free = FreeCamera(FreeCameraKinematics(np.eye(4)), np.zeros(6), sight)
    assert free.joint_origins(np.zeros((2, 6))).shape == (2, 0, 3)
    assert free.compute_rest_poses(np.zeros((0, 6))).shape == (0, 4, 4)
    for read in (free.read_rest_pose, lambda: free.read_joints()[0]):  # not the plant's own arrays
        read()[:] = 9.0
        assert read().flat[3] == 0.0


def test_a_chain_lags_as_its_time_constant_says_and_stops_at_its_limits(arm, sight):
    for kind, values, rest in (("position", START + 0.01, 0.01 * np.exp(-2.0)),
                               ("velocity", np.full(6, 0.1), 0.005 * (1.0 - np.exp(-2.0)))):
        for steps in (1, 10):
            chain = KinematicArm(arm, START, sight, joint_rate=0.1, lag=0.05)
            chain.command(kind, values)
            for k in range(steps):
                until(chain, round((k + 1) * 1e8 / steps))
            moved = chain.read_joints()[0] - START
            wanted = 0.01 - rest  # of 0.1 s at 0.1 m/s, or to the position
            np.testing.assert_allclose(moved, wanted, rtol=1e-9)
    for kind, value in (("velocity", 50.0), ("velocity", -50.0), ("position", 100.0)):
        chain.command(kind, np.full(6, value))
        until(chain, chain.time_ns + 2_000_000_000)
        q, speeds = chain.read_joints()
        assert (arm.lower <= q).all() and (q <= arm.upper).all()
        if value == 50.0:
            assert q[0] == arm.upper[0] and speeds[0] == 0.0


def test_joints_and_true_poses_are_those_of_the_joint_states_and_not_of_the_step_after(arm):
    heard = []
    loop = Loop(Experiment(), assemble(Experiment()), on_joint_state=lambda _, one: heard.append(
        (one.stamp, dict(zip(one.names, one.positions, strict=True)))))  # fmt: skip
    for _ in range(10):
        loop.run_to_image()
    result, end = loop.make_run(), loop.plant.read_pose()
    loop.close()
    assert [stamp for stamp, _ in heard] == result.joint_stamp.tolist()
    for (_, told), measured in zip(heard, result.measured_positions.tolist(), strict=True):
        assert [told[name] for name in result.joint_names] == measured
    for q, pose in zip(result.measured_positions, result.true_pose, strict=True):
        np.testing.assert_allclose(pose, arm.pose(q), atol=1e-9)
    # The physics has gone a step on since the last of them, and the verdict is of that.
    assert np.abs(end - arm.pose(result.measured_positions[-1])).max() > 1e-7


def test_the_ideal_camera_flies_an_exact_motion_an_image(sight):
    """By the twist of the believed camera, which sits beside the true one."""
    body, believed = FreeCameraKinematics(ORIGIN), FreeCameraKinematics(ORIGIN, MOUNTING)
    plant = IdealCamera(body, believed, Q, dataclasses.replace(sight, rate=8.0))
    joints, seen = plant.advance(10**9)
    assert (plant.time_ns, joints.stamp_ns, seen.stamp_ns) == (0, 0, 0)
    np.testing.assert_allclose(joints.positions, Q, atol=1e-12)
    assert not any(joints.velocities) and plant.outputs == {"twist"}
    plant.command("twist", TWIST)
    assert plant.advance(50_000_000) == [] and plant.time_ns == 50_000_000
    joints, seen = plant.advance(10**9)
    assert plant.time_ns == joints.stamp_ns == seen.stamp_ns == 125_000_000
    pose = body.pose(Q) @ MOUNTING @ exponential(0.125 * TWIST) @ inverse(MOUNTING)
    np.testing.assert_allclose(plant.read_pose(), pose, atol=1e-12)
    q, rate = plant.read_joints()
    np.testing.assert_allclose(body.pose(q), pose, atol=1e-12)
    np.testing.assert_allclose(believed.jacobian(q) @ rate, TWIST, atol=1e-12)
    plant.command("twist", np.zeros(6))
    assert plant.advance(10**9)[0].stamp_ns == 250_000_000
    np.testing.assert_array_equal(plant.read_pose(), plant.read_rest_pose())
    np.testing.assert_allclose(plant.read_pose(), pose, atol=1e-12)


@pytest.mark.parametrize(("speed", "slowed"), [(None, 1.0), ((0.1, 1.0), 3.0), ((1.0, 0.2), 3.0),
                                               ((0.9, 0.9), 1.0)])
def test_an_exact_resolver_reaches_with_the_next_image_what_the_twist_reaches(speed, slowed):
    body = FreeCameraKinematics(ORIGIN, MOUNTING)
    found = IdealCameraIK(body, 20.0, speed).solve(Q, Task.from_twist(TWIST), 9.0)
    reached = body.pose(Q) @ exponential(TWIST / slowed / 20.0)
    np.testing.assert_allclose(body.pose(Q + found.velocities / 20.0), reached, atol=1e-12)
    np.testing.assert_array_equal(found.primary, found.velocities)
    np.testing.assert_allclose([found.achieved_twist, found.desired_twist], [TWIST / slowed] * 2)
    assert not found.infeasible_twist.any() and found.scale == 1.0 and found.reuse_time == np.inf
    assert np.isinf(found.margins).all() and found.modelled.all()
    assert (found.stopped_joints, found.limiting_joint, found.reasons) == ((), "", ())
    np.testing.assert_allclose(found.jacobian, body.jacobian(Q))
    np.testing.assert_array_equal(found.L, np.eye(6))


def test_the_truth_of_the_arm_s_features_comes_without_pictures():
    exact, seen = (run(Experiment(duration=0.4, features=kind)) for kind in ("exact", "images"))
    assert exact.stamp == pytest.approx(seen.stamp, abs=1e-9)
    np.testing.assert_allclose(exact.features[0], seen.features[0], atol=3e-4)
    whole = run(Experiment(features="exact", scheme="points"))
    assert whole.outcome == "converged"
    assert whole.verdict.distance < 2e-5


def test_an_exposure_between_two_steps_is_seen_from_between_their_poses():
    """A thirtieth of a second is no whole number of steps; target and camera move."""
    motion = {"velocity": [0.1, 0.0, 0.0, 0.0, 0.0, 0.0]}
    target = {"shape": "l_shape", "size": [0.06, 0.06], "pose": [0, 0, 0.591, 0, 0, 0]}
    goal = [0.05, 0.0, -0.09, 0.045, 0.045, 0.0]
    parts = assemble(Experiment.from_mapping({
        "features": "exact", "scheme": "points", "goal": goal, "start": goal,
        "target": {**target, "motion": motion}}))  # fmt: skip
    plant, found, poses = parts.plant, [], []

    def points_at(pose, stamp):
        seen_from = parts.target.target_T_camera(pose, stamp)
        return np.column_stack(plant.camera.project(*parts.target.shape.points(seen_from).T))

    with contextlib.closing(plant):
        plant.command("position", np.array(goal) + [0.05, 0.0, 0.0, 0.0, 0.0, 0.9])
        while len(found) < 4:
            poses.append(plant.read_rest_pose())  # one a millisecond
            found += [r for r in plant.advance(plant.time_ns + 1) if isinstance(r, Frame)]
        poses.append(plant.read_rest_pose())
    moved = []
    for k, reading in enumerate(found, 1):
        assert reading.stamp == pytest.approx(k / 30.0, abs=1e-9)
        step, share = divmod(1e3 * reading.stamp, 1.0)
        before, after = poses[int(step)], poses[min(int(step) + 1, len(poses) - 1)]
        pose = before @ exponential(share * logarithm(inverse(before) @ after))
        assert np.abs(reading.points - points_at(pose, reading.stamp)).max() < 0.01
        apart = points_at(before, reading.stamp) - points_at(after, reading.stamp)
        moved.append(np.abs(apart).max())
    assert max(moved) > 0.1
