"""Runner with plants without physics: exact, and milliseconds per run."""

import dataclasses
import re

import numpy as np
import pytest

from aras_visual_servo_base.poses import inverse
from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.experiment.camera_specs import CalibrationOffset
from aras_visual_servo_bench.experiment.experiment import (
    CameraPoseSpec,
    Experiment,
    RandomStart,
    TargetSpec,
)
from aras_visual_servo_bench.runner.loop import Loop, assemble, run
from aras_visual_servo_bench.setup.start_sampling import POSE_TOLERANCE
from aras_visual_servo_bench.targets.geometry import TargetMotion
from aras_visual_servo_controller.errors import MeasurementError
from aras_visual_servo_controller.features import Feature
from aras_visual_servo_controller.features.base import FeatureMeasurement
from aras_visual_servo_controller.schemes import Scheme

CHAIN = Experiment(plant="chain", time_after_convergence=0.0)
FREE = Experiment(plant="free", lag=0.0, time_after_convergence=0.0)


class TwoMeans(Feature):
    """A user's own: the target's centre, from the contour alone."""

    name = "two_means"
    names, tolerances = ("x", "y"), (1e-3, 1e-3)
    directions = (True, True, False, False, False, False)

    def measure(self, observation, goal):
        m, wanted = observation.moments, goal.moments
        s, goal_s = np.array([m.xg, m.yg]), np.array([wanted.xg, wanted.yg])
        L = np.zeros((2, 6))
        L[0, 0] = L[1, 1] = -1.0 / goal.depth
        return FeatureMeasurement(s, goal_s, s - goal_s, L)


class Failing(Scheme):
    """A user's own that fails at its tenth image."""

    names, tolerances = ("x",), (1e-3,)

    def compute(self, observation, goal, t):
        raise RuntimeError("no idea")


@pytest.mark.parametrize("experiment", [
    CHAIN.with_changes(features="images"),
    FREE.with_changes(features="images", camera="fisheye"),
    CHAIN.with_changes(scheme="points"),
    FREE.with_changes(scheme="points", target={"pose": [0, 0, 0.59, 0, 0, 0], "shape": [
                   [-0.03, -0.02], [0.03, -0.02], [0.02, 0.03], [-0.03, 0.01]]},
               goal={"pose": [0, 0, 0.8, 3.141592653589793, 0, 0]}, start={"pose": [
                   0.05, 0.03, 0.9, 3.05, 0.05, 0.3]}),
    CHAIN.with_changes(commands="images", delay=0.0),
])  # fmt: skip
def test_reaches_its_goal(experiment):
    result = run(experiment)
    assert result.outcome == "converged", result.reason
    assert result.verdict.is_reached, result.verdict
    assert result.compute_settling_time() < 1.5
    assert result.error.shape == (len(result.stamp), len(result.names))
    np.testing.assert_allclose(np.diff(result.stamp), 1.0 / 30.0, atol=1e-8)


@pytest.mark.parametrize(("delay", "streamed", "by_images"), [
    (0.0, 1, 1), (0.005, 1, 2), (0.015, 1, 2), (0.030, 2, 2), (0.040, 2, 3),
])  # fmt: skip
def test_with_a_command_an_image_an_answer_waits_for_an_image(delay, streamed, by_images):
    """As the table of experiments says: images that still show the start, at 30 a second."""
    for commands, count in (("joint_states", streamed), ("images", by_images)):
        result = run(
            CHAIN.with_changes(
                commands=commands, delay=delay, duration=0.3, time_after_convergence=None
            )
        )
        moved = np.abs(result.error - result.error[0]).max(axis=1) > 1e-9
        assert moved.argmax() == count, commands


def test_a_users_own_feature_is_named_by_its_class():
    result = run(FREE.with_changes(scheme=f"{__name__}:TwoMeans"))
    assert result.names == ("x", "y")
    assert result.outcome == "converged"
    assert result.verdict.is_reached  # the directions that it does not model are held at the goal


def test_what_goes_wrong_while_it_runs_is_an_outcome():
    result = run(CHAIN.with_changes(scheme=f"{__name__}:Failing", duration=0.5))
    assert result.outcome == "scheme_fault"
    assert "no idea" in result.reason
    assert not result.verdict.is_reached
    assert (
        np.isnan(result.joint_commands).all()
        or np.ptp(result.measured_positions, axis=0).max() < 1e-9
    )


def test_a_target_that_leaves_the_view_is_an_outcome():
    moving = TargetSpec(motion=TargetMotion((0.8, 0.0, 0.0, 0.0, 0.0, 0.0), begin=0.3))
    result = run(CHAIN.with_changes(target=dataclasses.asdict(moving), duration=3.0))
    assert result.outcome == "target_lost"
    assert not result.verdict.is_reached
    assert np.isnan(result.error[-1]).all()


def test_true_poses_are_the_plants_and_not_the_controllers_belief():
    wrong = CalibrationOffset(xyz=(0.0, 0.01, 0.0), rpy=(0.0, 0.02, 0.0))
    experiment = CHAIN.with_changes(calibration_offset=dataclasses.asdict(wrong), duration=3.0)
    loop = Loop(experiment, assemble(experiment))
    loop.run_to_end()
    result = loop.make_run()
    arm = loop.plant.arm
    for q, pose in zip(result.measured_positions[::50], result.true_pose[::50], strict=True):
        np.testing.assert_allclose(arm.pose(q), pose, atol=1e-12)
    believed = loop.servo.arm.pose(result.measured_positions[-1])
    assert np.linalg.norm(believed[:3, 3] - result.true_pose[-1][:3, 3]) > 5e-3


@pytest.mark.parametrize("start", ["2016", {"height": [0.2, 0.4], "side": 0.05, "turn": 1.0}])
def test_a_believed_focal_length_that_is_wrong_is_diagnosed(start):
    """The loop comes to rest with no error left, and to the wrong place: it has to say why."""
    experiment = CHAIN.with_changes(
        features="images",
        calibration_offset={"focal": 0.7},
        start=start,
        time_after_convergence=0.1,
    )
    result = run(experiment)
    assert not result.verdict.is_reached and result.verdict.distance > 0.05
    assert result.outcome == "wrong_camera_model" and "calibrate" in result.remedy


def test_a_believed_depth_that_is_wrong_does_no_harm():
    result = run(
        CHAIN.with_changes(
            features="images", calibration_offset={"depth": 1.4}, time_after_convergence=0.1
        )
    )
    assert result.verdict.is_reached and result.outcome == "converged"
    assert {word.split(" up to ")[0] for word in result.outcomes} <= {"running", "converged"}


def test_a_moving_target_takes_its_goal_along():
    shift = TargetSpec(motion=TargetMotion((0.05, 0.0, 0.0, 0.0, 0.0, 0.0)))
    experiment = FREE.with_changes(
        target=dataclasses.asdict(shift), duration=1.0, time_after_convergence=None
    )
    loop = Loop(experiment, assemble(experiment))
    loop.run_to_end()
    seconds = loop.plant.time_ns * 1e-9
    moved = loop.compute_goal_pose() @ inverse(loop.parts.goal_pose)
    np.testing.assert_allclose(moved[:3, 3], [0.05 * seconds, 0.0, 0.0], atol=1e-12)


@pytest.mark.parametrize(("scheme", "speed", "duration"), [
    ("points", 0.06, 4.0), ("pose", 0.01, 8.0),
])
def test_a_target_that_is_followed_at_one_speed_moves_at_that_speed(scheme, speed, duration):
    """In the picture nothing moves any more: that is the target's doing, and no camera's."""
    motion = {"velocity": (0.6 * speed, -0.8 * speed, 0.0, 0.0, 0.0, 0.0)}
    result = run(FREE.with_changes(scheme=scheme, target={"motion": motion}, duration=duration))
    assert result.outcome == "target_moves", result.reason
    told = re.search(r"it moves at ([0-9.]+) mm/s", result.reason)
    assert told and float(told[1]) == pytest.approx(1e3 * speed, rel=0.04)


@pytest.mark.parametrize(
    ("plant", "scheme", "twist"),
    [("free", "points", (0.0, 0.0, 0.02, 0.0, 0.0, 0.0)),
     ("chain", "pose", (0.0, 0.0, 0.0, 0.0, 0.0, 0.1))],
)  # fmt: skip
def test_a_target_that_rises_or_turns_is_no_wrong_camera(plant, scheme, twist):
    """A camera along or about whose axis the features do not move at all is none."""
    result = run(Experiment.from_mapping({
        "plant": plant, "scheme": scheme, "duration": 4.0, "target": {"motion": {"velocity": twist}}
    }))  # fmt: skip
    assert result.outcome == "target_moves", result.reason


SLIGHT = RandomStart(height=(0.2, 0.3), side=0.02)


def test_an_arm_without_roll_begins_at_every_heading():
    """Where a free camera begins with the same seed; the goal leans, by what no roll is missed."""
    headings = []
    for seed in range(14):
        ways = [assemble(Experiment(plant=plant, start=SLIGHT, seed=seed))
                for plant in ("chain", "free")]  # fmt: skip
        chain, free = (parts.plant.read_pose() for parts in ways)
        turned = ways[0].goal_pose[:3, :3].T @ chain[:3, :3]
        headings.append(np.degrees(np.arctan2(turned[1, 0], turned[0, 0])))
        np.testing.assert_allclose(chain, free, atol=2 * POSE_TOLERANCE)
    assert np.histogram(headings, bins=4, range=(-180, 180))[0].min() >= 1


def test_starts_in_every_form_are_one():
    named = assemble(CHAIN).plant
    joints = assemble(CHAIN.with_changes(start=list(named.read_joints()[0]))).plant
    np.testing.assert_array_equal(named.read_pose(), joints.read_pose())
    free = assemble(FREE).plant
    np.testing.assert_allclose(free.read_pose(), named.read_pose(), atol=1e-12)
    x, y, z = named.read_pose()[:3, 3].tolist()
    from aras_visual_servo_base.poses import xyz_rpy_from_matrix

    xyz, rpy = xyz_rpy_from_matrix(named.read_pose())
    posed = assemble(
        CHAIN.with_changes(start=dataclasses.asdict(CameraPoseSpec((*xyz, *rpy))))
    ).plant
    np.testing.assert_allclose(posed.read_pose(), named.read_pose(), atol=1e-6)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"scheme": "momments"}, "unknown scheme 'momments': did you mean 'moments'"),
        ({"scheme": "nowhere.at_all:Class"}, "nowhere"),
        ({"law": "proportionel"}, "unknown law 'proportionel': did you mean 'proportional'"),
        ({"controller_parameters": {"gian": 2.0}}, "unknown parameter ~gian.*gain"),
        ({"start": "2017"}, "start is '2017'"),
        ({"start": [0.0, 0.0]}, "start is .0.0, 0.0.*for each of gantry, J1"),
        ({"goal": "/nowhere/goal.yaml"}, "cannot read the goal /nowhere/goal.yaml"),
        ({"goal": "/dev/zero"}, "not a regular file"),
        ({"start": {"height": [3.0, 4.0], "attempts": 3}}, "no start found in 3 attempts"),
        ({"gain": -1.0}, "gain is -1.0, must be > 0"),
        ({"gain": 1e9}, "gain is 1000000000.0, must be <= 1000"),
        ({"robot": {"urdf": "/nowhere.urdf"}}, "there is no file /nowhere.urdf"),
        ({"robot": "/nowhere.urdf"}, "there is no file /nowhere.urdf"),
        ({"camera": "orignal"}, "camera 'orignal' is no preset: did you mean 'original'"),
        ({"camera": {"widht": 3}}, "widht"),
    ],
)
def test_what_cannot_be_run_is_refused(changes, complaint):
    with pytest.raises(ExperimentError, match=complaint) as caught:
        run(CHAIN.with_changes(**changes))
    assert "\n" not in str(caught.value)


class Blind(Feature):
    """Finds nothing in any image."""

    names, tolerances = ("nothing",), (1e-3,)

    def measure(self, observation, goal):
        raise MeasurementError("nothing is found")


def test_a_run_that_is_over_while_nothing_is_measured_has_an_outcome():
    """Ten of two hundred runs drawn by chance ended as 'running'."""
    result = run(Experiment(plant="chain", scheme=f"{__name__}:Blind", duration=0.5))
    assert result.outcome == "timed_out" and "0.5 s" in result.reason
