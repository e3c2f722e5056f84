"""Vibrating cameras on every plant: images, true poses, and notes."""

import contextlib

import numpy as np
import pytest
from frames import take_frames

from aras_visual_servo_base.poses import pose_difference
from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.runner.loop import Loop, run
from aras_visual_servo_bench.setup.assembly import assemble
from aras_visual_servo_bench.studies.image_table import ImageRecorder

SHAKE = {"xyz": [2e-4, 4e-4, 3e-4], "rpy": [1e-3, 2e-3, 1.5e-3], "frequency": 22.0,
         "bandwidth": 8.0}
CAMERA = {"width": 320, "height": 240, "horizontal_fov": 2.0, "near": 0.02, "update_rate": 30.0}
DOWN = [3.14159265, 0.0, 0.0]
TARGET = {"shape": "l_shape", "size": [0.06, 0.05], "pose": [0.0, 0.0, 0.591, 0.0, 0.0, 0.0]}


def experiment(plant, shake=SHAKE, **keys):
    eye = {**CAMERA, **({"shake": shake} if shake else {})}
    keys = {"features": "exact", "scheme": "moments", "camera": eye, "target": TARGET, **keys}
    return Experiment(plant=plant, **{
        "goal": {"pose": [0.0, 0.0, 0.85, *DOWN]},
        "start": {"pose": [0.01, 0.02, 0.88, 3.14159265, 0.0, 0.2]}, **keys})  # fmt: skip


@pytest.mark.parametrize("plant", ["free", "chain", "bullet", "ideal"])
def test_points_are_seen_from_where_the_camera_is(plant):
    """At each stamp, from a plant that stands still."""
    parts = assemble(experiment(plant))
    with contextlib.closing(parts.plant) as still:
        assert list(still.vibrations) == ["camera"]
        found = take_frames(still, 4)
        at_rest = still.read_rest_pose()
        off = pose_difference(at_rest, still.read_pose())
        assert off == pose_difference(at_rest, still.apply_vibration(at_rest, still.time_ns))
        assert 1e-5 < off[0] < 3e-3
    for reading in found:
        pose = still.apply_vibration(at_rest, reading.stamp_ns)
        seen = parts.target.shape.points(parts.target.target_T_camera(pose, reading.stamp))
        exact = np.column_stack(still.camera.project(*seen.T))
        assert np.abs(reading.points - exact).max() < 0.03  # the Bullet arm settles meanwhile
        bare = parts.target.shape.points(parts.target.target_T_camera(at_rest))
        assert np.abs(reading.points - np.column_stack(still.camera.project(*bare.T))).max() > 0.04


def test_nobody_is_told_and_goals_are_taught_at_rest():
    keys = {"features": "images", "scheme": "points"}  # which is taught from a picture
    shaken, still = (assemble(experiment("bullet", shake, **keys)) for shake in (SHAKE, None))
    for parts in (shaken, still):
        parts.plant.close()
    assert shaken.goal.to_yaml("x") == still.goal.to_yaml("x")
    q = np.array([0.05, 0.0, -0.09, 0.045, 0.045, 0.0])
    np.testing.assert_array_equal(shaken.servo.arm.pose(q), still.servo.arm.pose(q))
    assert not still.plant.vibrations and list(shaken.plant.vibrations) == ["camera"]


def test_a_run_repeats_and_says_that_the_camera_shakes():
    asked = experiment("chain", features="images", duration=3.0, time_after_convergence=None)
    one, two, other = run(asked), run(asked), run(asked.with_changes(seed=1))
    for a, b in ((one.features, two.features), (one.pose, two.pose)):
        np.testing.assert_array_equal(a, b)
    assert np.nanmax(np.abs(one.features[:20] - other.features[:20])) > 1e-5
    (note,) = one.notes
    assert "camera 'camera' shakes by up to 0.4 mm and 0.115° of amplitude at 22 Hz" in note
    assert "do not contain this vibration" in note
    assert one.outcome.startswith("converged up to") and one.verdict.is_reached
    about = np.array([pose_difference(one.goal_pose, p)[0] for p in one.pose[-30:]])
    assert one.verdict.distance < 0.3 * about.max()  # where it is on average is nearer
    still = run(asked.with_changes(camera={"shake": None}))
    assert still.outcome == "converged" and not still.notes


def test_a_data_sets_poses_are_true():
    """They explain what was seen, of an arm that moves and a camera that shakes."""
    asked = experiment("chain", duration=0.5, time_after_convergence=None)
    keeper, seen = ImageRecorder(records_images=False), []
    def watch(loop, reading):
        keeper.add_frame(loop, reading)
        seen.append(reading)
    parts = assemble(asked)
    loop = Loop(asked, parts, on_frame=watch)
    loop.run_to_end()
    rows = {row["stamp"]: row for row in keeper.make_rows(0, loop.make_run(), 0.5)}
    assert len(rows) > 10
    for reading in [one for one in seen if one.stamp in rows]:
        pose = np.reshape(rows[reading.stamp]["pose"], (4, 4))
        points = parts.target.shape.points(parts.target.target_T_camera(pose, reading.stamp))
        exact = np.column_stack(parts.plant.camera.project(*points.T))
        np.testing.assert_allclose(reading.points, exact, atol=1e-6)


@pytest.mark.parametrize("plant", ["free", "chain", "bullet"])
def test_each_camera_shakes_by_itself(plant):
    shaken = {**CAMERA, "shake": SHAKE}
    eyes = {"left": {"model": shaken}, "right": {"model": shaken, "xyz": [0.0, -0.03, 0.0]},
            "watcher": {"model": CAMERA, "pose": [0.1, 0.1, 1.0, *DOWN]}}  # fmt: skip
    asked = experiment(plant, camera="original", cameras=eyes, scheme="points@left+points@right",
                       duration=0.2, time_after_convergence=None)
    seen = []
    parts = assemble(asked)
    loop = Loop(asked, parts,
                on_frame=lambda of, one: seen.append((one, of.plant.read_rest_pose())))
    loop.run_to_end()
    plant = loop.plant
    assert set(plant.vibrations) == {"left", "right"}
    records = loop.make_run().cameras
    loop.close()
    last = {reading.name: (reading, at_rest) for reading, at_rest in seen}
    for name, (reading, at_rest) in last.items():
        place = parts.placements.get(name)
        pose = plant.apply_vibration(
            at_rest if place is None else place.compute_pose(at_rest), reading.stamp_ns, name)
        points = parts.target.shape.points(parts.target.target_T_camera(pose, reading.stamp))
        exact = np.column_stack(parts.cameras[name].true_camera.project(*points.T))
        assert np.abs(reading.points - exact).max() < 0.06  # the arm moves on within its step
        if place is not None:
            np.testing.assert_allclose(records[name].pose[-1], pose, atol=1e-12)
    one, two = (plant.vibrations[name].compute_pose(10**8) for name in ("left", "right"))
    assert np.abs(one - two).max() > 1e-5
