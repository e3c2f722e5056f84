"""Calibration errors: the controller interprets pixels of the true camera with wrong intrinsics."""

import numpy as np
import pytest
from frames import take_frames

from aras_visual_servo_base import poses
from aras_visual_servo_base.poses import exponential, inverse, matrix_from_xyz_rpy
from aras_visual_servo_bench import Experiment, assemble, run
from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.experiment.robots import Robot
from aras_visual_servo_bench.setup.assembly import check
from aras_visual_servo_controller.observation.frame import Frame

SHAPE = [[-0.025, -0.03], [0.03, -0.025], [0.025, 0.02], [-0.015, 0.025]]
CAMERA = {"width": 320, "height": 240, "update_rate": 30.0,
          "camera_matrix": {"fx": 300.0, "fy": 280.0, "cx": 166.0, "cy": 115.0}}  # fmt: skip
GOAL = matrix_from_xyz_rpy((0.01, -0.02, -0.2), (0.05, -0.08, 0.3))
JOINTS = [0.05, 0.0, -0.09, 0.045, 0.045, 0.0]
START = [0.03, 0.0, -0.05, 0.03, 0.03, 0.15]
NEAR = (0.01, 0.005, -0.03, 0.0, 0.0, 0.2)  # twist from the goal to the start
TILTED = (0.005, np.radians(2.0), -0.03, np.radians(10.0), 0.0, 0.1)
WRONG = {"focal": {"focal": 1.3}, "centre": {"centre": [10.0, -6.0]},
         "distortion": {"distortion": [-0.12, 0.03, 0.0, 0.0]},
         "mounting": {"rpy": [0.0, 0.0, np.radians(10.0)]}}  # fmt: skip


def posed(pose):
    return {"pose": [*np.concatenate(poses.xyz_rpy_from_matrix(pose))]}


def flying(away=NEAR, wrong="", **changes):
    """A camera that flies before a flat target without symmetry."""
    return Experiment.from_mapping({
        "plant": "free", "features": "exact", "camera": CAMERA, "scheme": "points",
        "target": {"shape": SHAPE}, "goal": posed(GOAL), "start": posed(GOAL @ exponential(away)),
        "duration": 12.0, "time_after_convergence": 0.0, "gain": 4.0,
        "calibration_offset": WRONG.get(wrong, {}), **changes,
    })  # fmt: skip


def held(plant="chain", **changes):
    """The camera of the shipped arm, with goal and start as joint positions."""
    return Experiment.from_mapping({
        "plant": plant, "scheme": "points", "goal": JOINTS, "start": START, **changes
    })  # fmt: skip


@pytest.mark.parametrize("experiment", [
    flying(wrong="focal"), flying(wrong="centre", plant="ideal"),
    flying(wrong="distortion", scheme="moments"), flying(wrong="centre", scheme="pose"),
    flying((0.01, 0.005, -0.02, 0, 0, 0.15), "focal", scheme="moments", features="images"),
    flying(TILTED, scheme="points_3d"),
    *(held(plant, scheme=scheme, calibration_offset=WRONG["mounting"], duration=12.0,
           features="exact") for plant, scheme in (("chain", "moments"), ("ideal", "points"))),
])  # fmt: skip
def test_a_goal_that_is_shown_is_reached_whatever_is_believed(experiment):
    result = run(experiment)
    assert result.converged, (result.outcome, result.reason, result.verdict)
    assert result.verdict.is_reached and result.verdict.distance < 2e-4


@pytest.mark.parametrize("plant", ["chain", "bullet"])
@pytest.mark.parametrize("goal", [JOINTS, "2016"])
def test_the_goal_is_where_the_true_camera_stood_when_it_was_shown(plant, goal):
    belief = {"xyz": [0.02, 0.0, -0.01], "rpy": [0.02, np.radians(5), -0.1]}
    parts = assemble(held(plant, goal=goal, calibration_offset=belief, features="images"))
    parts.plant.close()
    robot = Robot(Experiment().robot)
    true, believed = robot.make_arm(), robot.make_calibrated_arm(**belief)
    np.testing.assert_allclose(parts.goal_pose, true.pose(np.array(JOINTS)), atol=1e-12)
    np.testing.assert_allclose(
        parts.servo.goal.world_T_camera, believed.pose(np.array(JOINTS)), atol=1e-9
    )
    assert min(poses.pose_difference(parts.goal_pose, parts.servo.goal.world_T_camera)) > 0.01


@pytest.mark.parametrize("plant", ["chain", "free", "ideal"])
def test_exact_features_are_seen_through_the_believed_camera(plant):
    seen = {}
    pixels = np.array([[150.0, 90.0], [210.0, 95.0], [205.0, 140.0], [160.0, 150.0]])
    arm = {"goal": JOINTS, "start": START, "target": {}} if plant == "chain" else {}
    for wrong in ("none", "focal", "centre", "distortion"):
        parts = assemble(flying(wrong=wrong, plant=plant, **arm))
        joints = parts.servo.arm.read_joints(parts.plant.joint_names, parts.plant.read_joints()[0])
        reading = Frame(40_000_000, outline=pixels, points=pixels,
                        camera=parts.cameras["camera"].true_camera)
        observation = parts.observe(reading, joints)
        seen[wrong] = observation.moments, observation.corners
    true, moved = seen["none"], seen["focal"]
    np.testing.assert_allclose(moved[1], true[1] / 1.3)
    assert moved[0].m00 == pytest.approx(true[0].m00 / 1.3**2)
    expected = true[0].xg - 10.0 / 300.0, true[0].yg + 6.0 / 280.0
    assert (seen["centre"][0].xg, seen["centre"][0].yg) == pytest.approx(expected)
    # The believed lens draws edges inwards, so what is seen there is taken to be further out.
    assert seen["distortion"][0].m00 > 1.003 * true[0].m00


@pytest.mark.parametrize(("make", "plant", "depth"), [
    (flying, "free", 1.25), (held, "chain", 1.0), (held, "chain", 1.25), (flying, "ideal", 1.25)
])  # fmt: skip
def test_every_observation_has_the_plane_of_goal_and_kinematics(make, plant, depth):
    parts = assemble(make(plant=plant, calibration_offset={"depth": depth}))
    (reading,), arm = take_frames(parts.plant), parts.servo.arm
    joints = arm.read_joints(parts.plant.joint_names, parts.plant.read_joints()[0])
    seen = parts.observe(reading, joints)
    shape, pose = parts.target.shape, parts.plant.read_pose()
    wanted = np.array(shape.plane(parts.target.target_T_camera(parts.goal_pose))) / depth
    np.testing.assert_allclose(parts.servo.goal.plane, wanted, rtol=1e-9)
    if depth == 1.0:
        true = shape.plane(parts.target.target_T_camera(pose))
        np.testing.assert_allclose(seen.plane, true, rtol=1e-6, atol=1e-7)
    else:  # any point of the goal's plane, seen from here
        point = np.array([0.1, -0.2, 1.0]) / (wanted @ (0.1, -0.2, 1.0))
        here = (inverse(pose) @ parts.goal_pose @ (*point, 1.0))[:3]
        assert np.dot(seen.plane, here) == pytest.approx(1.0)


@pytest.mark.parametrize("scheme", ["points_3d", "lines", "moments_six"])
def test_the_plane_comes_from_the_depth_image_where_that_is_asked_for(scheme):
    """A target that has been carried 4 cm away since the goal was shown: kinematics is wrong."""
    away = {"shape": SHAPE, "motion": {"step": [0.01, 0.0, 0.04], "begin": 0.01}}
    gain = 2.0 if scheme == "moments_six" else 4.0
    experiment = flying(scheme=scheme, features="images", target=away, duration=6.0, gain=gain)
    result = run(experiment.with_changes(controller_parameters={"depth_image": True}))
    assert result.verdict.distance < 1e-3, (result.outcome, result.verdict)
    if scheme == "points_3d":
        assert run(experiment).verdict.distance > 0.005


@pytest.mark.parametrize(("scheme", "features"), [("points", "exact"), ("luminance", "images")])
def test_a_goal_is_not_shown_where_the_target_is_not_in_view(scheme, features):
    away = posed(GOAL @ matrix_from_xyz_rpy((0.5, 0.0, 0.0), (0.0, 0.0, 0.0)))
    for refuse in (check, assemble):
        with pytest.raises(ExperimentError, match="^goal: the target .* camera's view; give a goal"
                           ) as told:  # fmt: skip
            refuse(flying(scheme=scheme, features=features, goal=away))
        assert "\n" not in str(told.value)
