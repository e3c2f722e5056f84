"""The report: right numbers from a made-up run, every plot drawn, a table a person understands."""

import json

import numpy as np
import pytest

from aras_visual_servo_bench.report import analysis, plots
from aras_visual_servo_bench.report.recording import Images, MomentsTrack, Recording, States
from aras_visual_servo_camera.undistortion import CameraModel
from aras_visual_servo_controller.before.schemes.moments import MomentsScheme
from aras_visual_servo_controller.virtual_robot import VirtualRobot

CAMERA = CameraModel(320, 240, (102.74, 0.0, 159.5, 0.0, 102.74, 119.5, 0.0, 0.0, 1.0))
SECONDS = 4.0


@pytest.fixture(scope="module")
def run(loops):
    """A run of the virtual robot in the form that a bag would give."""
    robot = VirtualRobot(np.array(loops.starts["2016"]))
    joints, moments = [], []

    def look(stamp):
        measurement = robot.measure(stamp)
        joints.append(robot.q.copy())
        moments.append(measurement.moments)
        return measurement

    history = robot.run(loops.servo("2016", smoothing=0.0), SECONDS, look)
    stamp = np.array([c.stamp for c in history])
    results = [c.scheme_result for c in history]
    states = States(
        stamp=stamp,
        phase=[c.phase for c in history],
        reason=[c.reason for c in history],
        names=results[0].names,
        features=np.array([r.features for r in results]),
        desired=np.array([r.desired for r in results]),
        error=np.array([r.error for r in results]),
        twist=np.array([r.twist for r in results]),
        commands=np.array([c.joint_commands for c in history]),
        singular_values=np.array([c.resolution.singular_values for c in history]),
    )
    picture = np.full((240, 320, 3), 255, np.uint8)
    return Recording(
        states=states,
        joint_stamp=stamp,
        joints=np.array(joints),
        camera_stamp=stamp,
        camera_pose=np.array([loops.kinematics.pose(q) for q in joints]),
        images=Images(stamp, stamp + 0.004, picture, picture, CAMERA),
        moments=MomentsTrack(
            stamp,
            3,
            np.array([m.m_array for m in moments]),
            np.array([m.mu_array for m in moments]),
        ),
    )


def test_summary_has_what_it_promises(run, loops):
    summary = analysis.summarise(run, loops.desired("2016"), scheme="moments", start="2016")
    assert summary["converged"] is True
    assert 0.5 < summary["settling_time_s"] < 2.0
    assert set(summary["final_error"]) == {"xn", "yn", "an", "alpha"}
    assert summary["final_camera_error"]["position_mm"] < 0.1
    assert summary["final_camera_error"]["rotation_deg"] < 0.05
    assert summary["image_rate_hz"] == pytest.approx(30.0, abs=0.01)
    assert summary["images"] == round(30 * SECONDS)
    assert summary["images_late"] == 0
    assert json.loads(json.dumps(summary)) == summary


def test_errors_recomputed_from_moments_equal_those_of_the_loop(run, loops):
    stamp, errors = analysis.moment_errors(run.moments, loops.desired("2016"))
    np.testing.assert_array_equal(stamp, run.states.stamp)
    np.testing.assert_allclose(errors, run.states.error, atol=1e-12)


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


def test_table_speaks_plainly(run, loops):
    summary = analysis.summarise(run, loops.desired("2016"), real_time_factor=0.998)
    lines = analysis.table(summary).splitlines()
    assert lines[0].split() == ["Target", "reached", "yes,", "and", "held"]
    assert any("1.00 x real time" in line for line in lines)
    summary.update(converged=False, settling_time_s=None, real_time_factor=None)
    assert "NO" in analysis.table(summary)
    assert "never" in analysis.table(summary)


def test_every_plot_is_drawn(run, loops, tmp_path):
    desired = loops.desired("2016")
    files = plots.write_all(
        run,
        loops.kinematics.pose(desired.joints),
        desired.m[1:3] / desired.m[0],
        tmp_path,
        MomentsScheme.thresholds,
        settling=1.2,
    )
    files += plots.write_images(run, tmp_path)
    assert len(files) == 7
    assert all(file.stat().st_size > 300 for file in files)
