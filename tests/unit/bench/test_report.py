"""The report: right numbers from a run, every plot drawn, a table a person understands."""

import json

import numpy as np
import pytest

from aras_visual_servo_bench.assembly import assemble
from aras_visual_servo_bench.experiment import Experiment
from aras_visual_servo_bench.report import analysis, plots
from aras_visual_servo_bench.report.recording import Images, MomentsTrack, Recording, States
from aras_visual_servo_bench.runner import Loop
from aras_visual_servo_camera.moments import Moments

SECONDS = 4.0


@pytest.fixture(scope="module")
def loop():
    loop = Loop(*(lambda e: (e, assemble(e)))(
        Experiment(plant="chain", duration=SECONDS, linger=None)
    ))  # fmt: skip
    loop.moments = []
    while loop.to_image() is not None:
        loop.moments.append(Moments.from_polygon(loop.reading.outline, 4))
    return loop


@pytest.fixture(scope="module")
def goal(loop):
    return loop.servo.goal


@pytest.fixture(scope="module")
def run(loop):
    """A run of the runner in the form that a bag would give."""
    result = loop.result()
    count = len(result.stamp)
    states = States(
        stamp=result.stamp,
        phase=list(result.phases),
        reason=list(result.reasons),
        names=result.names,
        features=result.features,
        desired=result.desired,
        error=result.error,
        twist=result.asked,
        joint_names=result.joint_names,
        commands=result.joints,
        singular_values=np.ones((count, 4)),
    )
    picture = np.full((240, 320, 3), 255, np.uint8)
    return Recording(
        states=states,
        joint_stamp=result.joint_stamp,
        joints=result.measured,
        camera_stamp=result.stamp,
        camera_pose=result.pose,
        images=Images(result.stamp, result.stamp + 0.004, picture, picture, loop.parts.camera),
        moments=MomentsTrack(
            result.stamp,
            4,
            np.array([m.m_array for m in loop.moments]),
            np.array([m.mu_array for m in loop.moments]),
        ),
        outcome=result.outcome,
        reason=result.reason,
    )


def test_summary_has_what_it_promises(run, goal):
    summary = analysis.summarise(run, goal, scheme="moments", start="2016")
    assert summary["converged"] is True
    assert (summary["outcome"], summary["verdict"]) == ("converged", "goal_reached")
    assert summary["reason"] == ""
    assert 0.3 < summary["settling_time_s"] < 2.0
    assert set(summary["final_error"]) == {"xn", "yn", "an", "alpha"}
    assert summary["final_camera_error"]["position_mm"] < 0.1
    assert summary["final_camera_error"]["rotation_deg"] < 0.05
    assert summary["image_rate_hz"] == pytest.approx(30.0, abs=0.01)
    assert abs(summary["images"] - 30 * SECONDS) <= 2
    assert summary["images_late"] == 0
    assert json.loads(json.dumps(summary)) == summary


def test_errors_recomputed_from_moments_equal_those_of_the_loop(run, goal):
    stamp, errors = analysis.moment_errors(run, goal)
    np.testing.assert_array_equal(stamp, run.states.stamp)
    np.testing.assert_allclose(errors, run.states.error, atol=2e-3)


def test_settling_time_wants_the_error_to_stay_small():
    stamp = np.arange(6.0)
    error = np.array([[1.0], [0.01], [0.5], [0.01], [0.015], [0.0]])
    assert analysis.settling_time(stamp, error) == 3.0
    assert analysis.settling_time(stamp, error[[0, 1, 1, 1, 1, 0]]) is None


def test_late_and_missing_images_are_counted():
    stamp = np.delete(np.arange(30) / 30.0, [7, 8])
    arrival = stamp + 0.004
    arrival[12] += 0.06
    figures = analysis.image_figures(Images(stamp, arrival))
    assert figures["images"] == 28
    assert figures["images_late"] == 3  # two missing, one late


def test_table_speaks_plainly(run, goal):
    summary = analysis.summarise(run, goal, real_time_factor=0.998)
    lines = analysis.table(summary).splitlines()
    assert lines[0].split() == ["Target", "reached", "yes,", "and", "held"]
    assert any("1.00 x real time" in line for line in lines)
    summary.update(converged=False, settling_time_s=None, real_time_factor=None)
    summary.update(outcome="target_lost", reason="over the left border")
    assert "NO: target_lost (over the left border)" in analysis.table(summary)
    assert "never" in analysis.table(summary)


def test_every_plot_is_drawn(run, goal, tmp_path):
    files = plots.write_all(
        run,
        goal.world_T_camera,
        np.array([goal.moments.xg, goal.moments.yg]),
        tmp_path,
        analysis.tolerances("moments", goal),
        settling=1.2,
    )
    files += plots.write_images(run, tmp_path)
    assert len(files) == 7
    assert all(file.stat().st_size > 300 for file in files)
