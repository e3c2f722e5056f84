"""Metrics of runs whose numbers are known beforehand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from aras_visual_servo_bench.errors import StudyError
from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.metrics import decay as decays
from aras_visual_servo_bench.metrics import metrics, summary
from aras_visual_servo_bench.metrics.metric import metric as make_metric
from aras_visual_servo_bench.recording.camera_record import CameraRecord
from aras_visual_servo_bench.recording.run import Run
from aras_visual_servo_bench.recording.verdict import Verdict
from aras_visual_servo_bench.targets.geometry import PlacedTarget, PolygonTarget, TargetMotion
from aras_visual_servo_bench.targets.target_spec import TargetSpec
from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_controller.records.state import ServoState
from aras_visual_servo_controller.schemes import SchemeOutput

STAMP = np.arange(90) / 30.0  # of images
TIME = np.arange(-20, 300) / 100.0  # of joint states, which come before the first image too


def state(stamp, error):
    """Return a state with two errors; NaN: not measured in this image."""
    names, zero = ("a", "b"), np.zeros(2)
    decision = None if np.isnan(error).any() else SchemeOutput(names, error, zero, error)
    return ServoState(stamp, "servoing", scheme_output=decision)


def run(error=None, x=None, joints=None, speed=None, verdict="goal_reached", outcome="converged",
        **parts):  # fmt: skip
    """Two features, one joint; the camera moves along x to its goal at 0."""
    n, m = len(STAMP), len(TIME)
    error = np.zeros((n, 2)) if error is None else error
    poses = np.tile(np.eye(4), (m, 1, 1))
    poses[:, 0, 3] = np.zeros(m) if x is None else x
    images = np.tile(np.eye(4), (n, 1, 1))
    column = np.zeros((m, 1))
    return Run(
        states=tuple(map(state, STAMP, error)), pose=images, joint_names=("j",), joint_stamp=TIME,
        measured_positions=column if joints is None else joints[:, None],
        measured_velocities=column if speed is None else speed[:, None], joint_commands=column,
        true_pose=poses,
        goal_pose=np.eye(4), outcome=outcome, reason="", remedy="",
        verdict=Verdict(verdict, 0.002, 0.03), position_limits=(np.array([-1.0]), np.array([2.0])),
        **parts,
    )  # fmt: skip


def measured(name, result):
    return metrics.find_metric(name).measure(result)


def decay(rate, first=(1.0, 0.5)):
    return np.atleast_1d(first) * np.exp(-rate * STAMP)[:, None]


def test_the_end_of_a_run_begins_with_the_image_that_is_as_long_before_its_last():
    error = -np.arange(180.0, 0.0, -1.0).reshape(90, 2)
    made = replace(run(error), states=tuple(map(state, np.arange(90) / 32.0, error)))
    found = {one.key: one.value for one in summary.summarise(made)}
    assert found["final_error_a"] == error[-33:, 0].mean()  # 1 s
    assert found["worst_error_b"] == -error[-65, 1]  # 2 s


def test_a_camera_that_never_came_near_is_told_from_one_whose_goal_is_unknown():
    far = run(np.ones((90, 2)), np.full(len(TIME), 0.1))
    more = [summary.Quantity(f"final_error_{k}", 0.1, "m", "") for k in range(8)]
    words = summary.describe_run(far, [*summary.summarise(far), *more])
    assert words.count("Error of ") == 8  # of ten
    none = Verdict("", np.nan, np.nan)
    for made, near, off in ((far, "never", "2.00 mm"),
                            (replace(far, verdict=none), "unknown", "unknown")):
        words = summary.describe_run(made, summary.summarise(made))
        assert f"Camera within 2 % after  {near}\n" in words
        assert "Error under 2 % after    never\n" in words
        assert f"Camera off its goal by   {off}" in words


def test_success_needs_the_loop_and_the_physics():
    for parts, value in (({}, 1.0), ({"outcome": "converged, drifting"}, 1.0),
                         ({"verdict": "goal_missed"}, 0.0), ({"outcome": "timed_out"}, 0.0)):
        assert measured("success", run(**parts)) == value
    for name in ("success", "reached", "reduced", "contradicts"):
        assert np.isnan(measured(name, run(verdict="")))


def test_settling_is_of_the_cameras_way():
    x = 0.1 * np.exp(-2.0 * np.maximum(TIME, 0.0))
    assert measured("settled", run(x=x)) == pytest.approx(np.log(50.0) / 2.0, abs=0.011)
    assert measured("path_length", run(x=x)) == pytest.approx(0.1 - x[-1])
    assert measured("path_ratio", run(x=x)) == pytest.approx(1.0 - 10.0 * x[-1])
    assert np.isnan(measured("path_ratio", run(x=1e-6 * x)))  # it began at its goal
    assert np.isnan(measured("settled", run(x=np.full(len(TIME), 0.1))))


def test_overshoot_is_of_the_worst_feature_in_parts_of_its_first():
    error = decay(2.0)
    assert measured("overshoot", run(error)) == measured("overshoot", run()) == 0.0
    error[40, 1] = -0.1
    assert measured("overshoot", run(error)) == pytest.approx(0.2)
    error[50, 0] = 0.0
    assert measured("overshoot", run(-error)) == pytest.approx(0.2)
    error[60] = np.nan  # not seen for an image
    for made in (error, 0.01 * error):
        assert measured("overshoot", run(made)) == pytest.approx(0.2)
    still = np.column_stack([decay(2.0, 3.0), np.full(90, 0.05)])
    still[30, 1] = -0.05  # began at its goal: there is nothing to compare with
    assert measured("overshoot", run(still)) == 0.0
    still[[0, 30], 1] = 0.0675, -0.0675  # more than 2 % of the largest
    assert measured("overshoot", run(still)) == 1.0


@pytest.mark.parametrize("count", [1, 2, 3])
def test_what_is_summed_over_time_needs_two_joint_states(count):
    """And is known from the second on."""
    began = int(np.searchsorted(TIME, 0.0))
    found = run(joints=np.full(len(TIME), 2.0), speed=np.full(len(TIME), 3.0))
    cut = slice(0, began + count)
    found = replace(found, joint_stamp=TIME[cut], measured_positions=found.measured_positions[cut],
                    measured_velocities=found.measured_velocities[cut],
                    joint_commands=found.joint_commands[cut],
                    true_pose=found.true_pose[cut])  # fmt: skip
    lasted = 0.01 * (count - 1) if count > 1 else np.nan
    assert measured("limit_time", found) == pytest.approx(lasted, nan_ok=True)
    assert measured("energy", found) == pytest.approx(9.0 * lasted, nan_ok=True)
    # Limits of which nothing is known are never reached.
    assert measured("limit_time", replace(found, position_limits=(np.zeros(0),) * 2)) == (
        pytest.approx(0.0 * lasted, nan_ok=True))


def test_decay_is_what_the_error_has():
    for size in (1.0, 0.01):
        assert measured("decay_rate", run(size * decay(1.7))) == pytest.approx(1.7, rel=1e-6)
    apart = np.column_stack([decay(1.7, 3.0), np.full(90, 0.05)])
    assert measured("decay_rate", run(apart)) == pytest.approx(1.7, rel=1e-6)
    for nothing in (np.full((90, 2), np.nan), np.zeros((90, 2))):
        assert np.isnan(measured("decay_rate", run(nothing)))
    # By four images at least, which are from below 80 % down to 15 %.
    for between in ((0.79, 0.5, 0.15), (0.79, 0.5, 0.3, 0.15)):
        few = np.array([1.0, 0.8, *between, *[0.14] * 88])[:90, None] * [1.0, 0.0]
        slope = -np.polyfit(STAMP[2:6], np.log(between), 1)[0] if len(between) == 4 else np.nan
        assert measured("decay_rate", run(few)) == pytest.approx(slope, nan_ok=True)


def test_an_image_is_late_from_one_and_a_half_periods_after_its_exposure():
    exposed = np.array([0.0, 1.0, 2.0, 4.0, 5.0]) / 32.0  # and one is missing
    arrival = exposed + np.array([0.4, 1.5, 1.55, 2.0, 1.0]) / 32.0
    shown = run(cameras={"camera": CameraRecord(None, exposed, arrival)})
    assert measured("images_late", shown) == 3.0
    assert measured("delay", shown) == pytest.approx(6.45 / 5.0 / 32.0 * 1e3)


def target(corners, z=1.0, motion=(0.0, 0.0, 0.0)):
    """A target whose corners are also pixels, seen from above."""
    pose = np.eye(4)
    pose[2, 3] = z
    motion = TargetMotion(velocity=(*motion, 0.0, 0.0, 0.0))
    return PlacedTarget(PolygonTarget(corners), pose, motion)


def test_excursion_is_the_farthest_corner_in_half_sizes_of_the_image():
    camera = CameraRecord(CameraModel(320, 240, tuple(np.eye(3).ravel())))
    corners = ((159.5, 119.5), (199.5, 119.5), (199.5, 149.5))

    def excursion(**placed):
        return measured("image_excursion", run(target=target(corners, **placed),
                                               cameras={"camera": camera}))  # fmt: skip

    assert excursion() == pytest.approx(0.25)
    assert excursion(motion=(-200.0 / STAMP[-1], 0.0, 0.0)) == pytest.approx(1.25)
    assert excursion(motion=(0.0, 150.0 / STAMP[-1], 0.0)) == pytest.approx(1.5)
    assert excursion(z=-1.0) == np.inf
    assert np.isnan(measured("image_excursion", run()))


def test_depth_is_of_the_target_s_middle_along_the_optical_axis():
    square = ((-0.1, -0.1), (0.1, -0.1), (0.1, 0.1))
    result = run(target=target(square, z=0.6, motion=(0.0, 0.0, 0.25 / STAMP[-1])))
    assert measured("largest_depth", result) == pytest.approx(0.85)
    result.pose[11, 2, 3] = -0.05
    assert measured("largest_depth", result) == pytest.approx(0.85)
    result.pose[11, 2, 3] = -0.3
    assert measured("largest_depth", result) == pytest.approx(0.9 + 0.25 * 11 / 89)
    plates = TargetSpec().placed_target.shape
    assert plates.height > 1e-3
    assert measured("largest_depth", run(target=replace(result.target, shape=plates))) == (
        pytest.approx(0.85 + plates.height))


@pytest.mark.parametrize(("outcome", "verdict", "expected"), [
    ("converged", "goal_reached", 0.0), ("converged", "goal_missed", 1.0),
    ("timed_out", "goal_reached", 1.0), ("timed_out", "goal_missed", 0.0),
    ("converged up to 180", "goal_missed", 0.0), ("converged up to 0.4 mm", "goal_reached", 0.0),
])  # fmt: skip
def test_contradiction_is_a_word_against_the_physics(outcome, verdict, expected):
    found = run(outcome=outcome, verdict=verdict)
    assert measured("contradicts", found) == expected
    assert measured("reached", found) == float(verdict == "goal_reached")


@pytest.mark.parametrize(("x", "angle", "reduced"), [
    (0.021, 0.31, 1.0), (0.019, 0.31, 0.0), (0.021, 0.29, 0.0), (0.021, 0.0, 0.0),
])  # fmt: skip
def test_reduced_wants_a_tenth_of_both_distance_and_angle(x, angle, reduced):
    """2 mm and 0.03 rad are left."""
    found = run(x=np.where(TIME < 0.0, 5.0, x))
    c, s = np.cos(angle), np.sin(angle)
    found.true_pose[:, :2, :2] = [[c, -s], [s, c]]
    assert measured("reduced", found) == reduced
    there = replace(run(), verdict=Verdict("goal_reached", 0.0, 0.0))  # all the time
    assert measured("reduced", there) == 1.0


@pytest.mark.parametrize(("limits", "place", "part"), [
    ((-1.0, 2.0), 1.9972, 1.0), ((-1.0, 2.0), 1.9968, 0.0), ((-1.0, 2.0), -0.9972, 1.0),
    ((-1.0, 2.0), -0.9968, 0.0), ((-np.inf, 2.0), 1.9999, 0.0), ((-np.inf, 2.0), 2.0, 1.0),
    ((-1.0, np.inf), -1.0, 1.0),
])  # fmt: skip
def test_a_joint_is_at_a_limit_within_a_thousandth_of_its_range(limits, place, part):
    found = replace(
        run(joints=np.full(len(TIME), place)), position_limits=tuple(np.array([limits]).T)
    )
    assert measured("limit_time", found) == pytest.approx(2.99 * part)


def test_the_predicted_decay_needs_two_images_and_a_gain_that_is_known():
    asked = Experiment(plant="free", gain=2.0, delay=0.02, lag=0.005)
    assert decays.compute_delay(asked) == pytest.approx(0.03)
    assert decays.compute_delay(asked.with_changes(plant="bullet")) == pytest.approx(0.028)
    for count, known in ((0, False), (1, False), (2, True), (3, True)):
        found = replace(run(), states=run().states[:count], experiment=asked)
        told = measured("decay_predicted", found)
        rate = decays.predict_decay_rate(2.0, 0.03)
        assert told == pytest.approx(rate) if known else np.isnan(told)
        unknown = replace(found, experiment=asked.with_changes(gain=None))
        assert np.isnan(measured("decay_predicted", unknown))


def test_a_run_that_ended_before_its_first_image_has_what_numbers_it_can():
    nothing, none = np.zeros((0, 1)), np.zeros((0, 4, 4))
    found = replace(run(), states=(), pose=none, joint_stamp=np.zeros(0), true_pose=none,
                    measured_positions=nothing, measured_velocities=nothing, joint_commands=nothing)
    known = {name: measured(name, found) for name in metrics.METRICS}
    zero = ("reduced", "contradicts", "iterations", "servoing_time", "top_speed", "images",
            "images_late")
    told = {"success": 1.0, "reached": 1.0, "final_distance": 0.002, "final_angle": 0.03}
    assert {k: v for k, v in known.items() if v == v} == {**dict.fromkeys(zero, 0.0), **told}


def test_a_metric_says_which_values_are_better():
    with pytest.raises(StudyError, match="better is 'less'"):
        make_metric("m", "less", "here")


def test_metrics_of_the_errors_declare_that_they_depend_on_the_features():
    """Two runs with the same camera motion and different features have the same other metrics."""
    one, other = run(decay(2.0)), run(3.0 * decay(1.0, (1.0, -0.2)) - 0.5)
    changed = {n for n in metrics.METRICS if not np.array_equal(
        measured(n, one), measured(n, other), equal_nan=True)}  # fmt: skip
    assert {"overshoot", "decay_rate"} <= changed
    assert not {name for name in changed if not metrics.find_metric(name).is_feature_based}
