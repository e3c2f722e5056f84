"""Runner with plants without physics: exact, and milliseconds per run."""

import re

import numpy as np
import pytest

from aras_visual_servo_base.poses import xyz_rpy_from_matrix
from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.experiment.experiment import Experiment, RandomStart
from aras_visual_servo_bench.runner.loop import assemble, run
from aras_visual_servo_bench.setup.start_sampling import POSE_TOLERANCE

CHAIN = Experiment(plant="chain", time_after_convergence=0.0)
FREE = Experiment(plant="free", lag=0.0, time_after_convergence=0.0)


@pytest.mark.parametrize("experiment", [
    CHAIN.with_changes(features="images"),
    FREE.with_changes(features="images", camera="fisheye"),
    CHAIN.with_changes(scheme="points"),
    FREE.with_changes(scheme="points", target={"pose": [0, 0, 0.59, 0, 0, 0], "shape": [
                   [-0.03, -0.02], [0.03, -0.02], [0.02, 0.03], [-0.03, 0.01]]},
               goal={"pose": [0, 0, 0.8, 3.141592653589793, 0, 0]}, start={"pose": [
                   0.05, 0.03, 0.9, 3.05, 0.05, 0.3]}),
    CHAIN.with_changes(commands="images", delay=0.0)])  # fmt: skip
def test_reaches_its_goal(experiment):
    result = run(experiment)
    assert result.outcome == "converged", result.reason
    assert result.verdict.is_reached, result.verdict
    assert result.compute_settling_time() < 1.5
    assert result.error.shape == (len(result.stamp), len(result.names))
    np.testing.assert_allclose(np.diff(result.stamp), 1.0 / 30.0, atol=1e-8)


@pytest.mark.parametrize(("delay", "streamed", "by_images"), [
    (0.0, 1, 1), (0.005, 1, 2), (0.030, 2, 2), (0.040, 2, 3)])
def test_with_a_command_an_image_an_answer_waits_for_an_image(delay, streamed, by_images):
    """As the table of experiments says: images that still show the start, at 30 a second."""
    for commands, count in (("joint_states", streamed), ("images", by_images)):
        result = run(CHAIN.with_changes(commands=commands, delay=delay, duration=0.3,
                                        time_after_convergence=None))  # fmt: skip
        moved = np.abs(result.error - result.error[0]).max(axis=1) > 1e-9
        assert moved.argmax() == count, commands


def test_a_target_that_leaves_the_view_is_an_outcome():
    motion = {"velocity": (0.8, 0.0, 0.0, 0.0, 0.0, 0.0), "begin": 0.3}
    result = run(CHAIN.with_changes(target={"motion": motion}, duration=3.0))
    assert result.outcome == "target_lost" and not result.verdict.is_reached
    assert np.isnan(result.error[-1]).all()


@pytest.mark.parametrize("start", ["2016", {"height": [0.2, 0.4], "side": 0.05, "turn": 1.0}])
def test_a_believed_focal_length_that_is_wrong_is_diagnosed(start):
    """The loop comes to rest with no error left, and to the wrong place: it has to say why."""
    result = run(CHAIN.with_changes(features="images", calibration_offset={"focal": 0.7},
                                    start=start, time_after_convergence=0.1))  # fmt: skip
    assert not result.verdict.is_reached and result.verdict.distance > 0.05
    assert result.outcome == "wrong_camera_model" and "calibrate" in result.remedy


@pytest.mark.parametrize(("plant", "scheme", "twist", "duration"), [
    ("free", "points", (0.036, -0.048, 0.0, 0.0, 0.0, 0.0), 4.0),
    ("free", "pose", (0.006, -0.008, 0.0, 0.0, 0.0, 0.0), 5.0),
    # A camera along or about whose axis the features do not move at all is no wrong camera.
    ("free", "points", (0.0, 0.0, 0.02, 0.0, 0.0, 0.0), 4.0),
    ("chain", "pose", (0.0, 0.0, 0.0, 0.0, 0.0, 0.1), 4.0)])  # fmt: skip
def test_a_target_that_is_followed_at_one_speed_moves_at_that_speed(plant, scheme, twist, duration):
    """In the picture nothing moves any more: that is the target's doing, and no camera's."""
    experiment = FREE if plant == "free" else CHAIN
    motion = {"velocity": twist}
    result = run(experiment.with_changes(
        scheme=scheme, target={"motion": motion}, duration=duration))  # fmt: skip
    assert result.outcome == "target_moves", result.reason
    if twist[0]:
        told = re.search(r"it moves at ([0-9.]+) mm/s", result.reason)
        speed = 1e3 * np.linalg.norm(twist)
        assert told and float(told[1]) == pytest.approx(speed, rel=0.04)


SLIGHT = RandomStart(height=(0.2, 0.3), side=0.02)


def test_an_arm_without_roll_begins_at_every_heading():
    """Where a free camera begins with the same seed; the goal leans, by what no roll is missed."""
    headings = []
    for seed in range(10):
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
    np.testing.assert_allclose(assemble(FREE).plant.read_pose(), named.read_pose(), atol=1e-12)
    xyz, rpy = xyz_rpy_from_matrix(named.read_pose())
    posed = assemble(CHAIN.with_changes(start={"pose": [*xyz, *rpy]})).plant
    np.testing.assert_allclose(posed.read_pose(), named.read_pose(), atol=1e-6)


@pytest.mark.parametrize(("changes", "complaint"), [
    ({"scheme": "momments"}, "unknown scheme 'momments': did you mean 'moments'"),
    ({"scheme": "nowhere.at_all:Class"}, "nowhere"),
    ({"law": "proportionel"}, "unknown law 'proportionel': did you mean 'proportional'"),
    ({"controller_parameters": {"gian": 2.0}}, "unknown parameter ~gian.*gain"),
    ({"start": "2017"}, "start is '2017'"),
    ({"start": [0.0, 0.0]}, "start is .0.0, 0.0.*for each of gantry, J1"),
    ({"goal": "/dev/zero"}, "not a regular file")])
def test_what_cannot_be_run_is_refused(changes, complaint):
    with pytest.raises(ExperimentError, match=complaint) as caught:
        run(CHAIN.with_changes(**changes))
    assert "\n" not in str(caught.value)
