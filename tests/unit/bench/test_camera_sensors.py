"""Sensors of cameras on every plant: a rolling shutter, noise, a mosaic, auto exposure."""

from dataclasses import replace

import numpy as np
import pytest
from test_plants import SQUARE, START, bullet, until

from aras_sim_bridge.camera.effects import Effects
from aras_sim_bridge.camera.shutter import make_row_bands
from aras_visual_servo_base.poses import exponential
from aras_visual_servo_bench import Experiment, run
from aras_visual_servo_bench.plants.free_camera_kinematics import FreeCameraKinematics
from aras_visual_servo_bench.plants.imaging import ImagingSettings, capture
from aras_visual_servo_bench.plants.kinematic import FreeCamera
from aras_visual_servo_bench.targets.geometry import PlacedTarget
from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_controller.observation.frame import Frame

ROW, PERIOD = 1.1e-4, 1.0 / 30.0
K = (240.0, 0.0, 165.3, 0.0, 251.0, 112.8, 0.0, 0.0, 1.0)
CAMERA = CameraModel(320, 240, K, (-0.2, 0.05, 0.001, -0.002, 0.0), "plumb_bob")
ORIGIN = np.array([[1.0, 0, 0, 0.01], [0, -1.0, 0, -0.02], [0, 0, -1.0, 0.25], [0, 0, 0, 1.0]])
TWIST = np.array([0.5, -0.4, 0.2, 0.8, -1.1, 2.0])
STAMP = round(PERIOD * 1e9)


def sight(**further):
    rows = make_row_bands(Effects(row_time=ROW, rows_together=8), CAMERA.height)
    return ImagingSettings(CAMERA, PlacedTarget(SQUARE, np.eye(4)), row_bands=rows, **further)


def flying(seen):
    begin = FreeCameraKinematics(ORIGIN @ exponential(-PERIOD * TWIST))
    plant = FreeCamera(begin, np.zeros(6), seen)
    plant.command("velocity", TWIST)
    readings = [r for r in until(plant, 60_000_000) if isinstance(r, Frame)]
    assert [r.stamp_ns for r in readings] == [STAMP]
    return readings[0]


def pose_at(offset):
    return ORIGIN @ exponential(offset * TWIST)


def test_a_point_is_where_it_was_when_its_own_row_was_exposed():
    found = flying(sight())
    for pixel, corner in zip(found.points, SQUARE.vertices(), strict=True):
        row = 120.0
        for _ in range(30):
            seen = np.linalg.inv(pose_at((row - 119.5) * ROW)) @ [*corner, 1.0]
            u, row = CAMERA.project(seen[0] / seen[2], seen[1] / seen[2])
        np.testing.assert_allclose(pixel, [u, row], atol=0.01)
    still = capture(replace(sight(), row_bands=()), ORIGIN, STAMP, np.random.default_rng(0))
    assert np.abs(found.points - still.points).max() > 1.0
    np.testing.assert_allclose(found.outline, found.points)


@pytest.mark.parametrize("depth", [False, True])
def test_a_picture_is_made_of_rows_of_the_pictures_of_their_instants(depth):
    rolling = sight(has_images=True, has_depth=depth)
    found, still = flying(rolling), replace(rolling, row_bands=(), effects=Effects())
    for part in rolling.row_bands:
        now = capture(still, pose_at(1e-9 * part.offset_ns), STAMP, np.random.default_rng(0)).image
        rows = slice(part.first, part.last)
        np.testing.assert_allclose(found.image[rows].astype(int), now[rows], atol=1)
    middle = capture(still, pose_at(0.0), STAMP, np.random.default_rng(0))
    assert np.abs(found.image.astype(int) - middle.image).max() > 50
    if depth:
        np.testing.assert_allclose(found.depth, middle.depth, rtol=5e-3)


def test_an_arms_exact_points_are_of_their_own_rows_too(robot, preset, pinhole):
    table = np.eye(4)
    table[2, 3] = 0.59
    rows = make_row_bands(Effects(row_time=5e-5), pinhole.height)
    found = {}
    for name, own in (("global", ()), ("rolling", rows)):
        seen = ImagingSettings(
            pinhole, PlacedTarget(SQUARE, table), row_bands=own, is_unbounded=True
        )
        plant = bullet(robot, preset, imaging_settings=(seen,))
        try:
            plant.command("position", START + [0.0, 0.0, 0.0, 0.0, 0.0, 0.8])
            found[name] = [r for r in until(plant, 220_000_000) if isinstance(r, Frame)]
        finally:
            plant.close()
    assert [r.stamp_ns for r in found["global"]] == [r.stamp_ns for r in found["rolling"]]
    assert len(found["global"]) == 6
    apart = [np.abs(a.points - b.points).max() for a, b in zip(*found.values(), strict=True)]
    assert 0.02 < max(apart) < 10.0


NOISY = {"row_time": 1e-4, "sensor": {"gain": 0.01, "full_well": 25e3, "read_noise": 20.0}}


@pytest.mark.parametrize(("plant", "camera"), [
    ("bullet", {"format": "bayer_gbrg8"}), ("bullet", {"effects": {"auto_exposure": {}}}),
    ("chain", {"effects": NOISY}),
])  # fmt: skip
def test_the_loop_converges_with_other_sensors(plant, camera):
    """A mosaic loses half of the edges' places: its corners are less exact, not its loop."""
    result = run(Experiment.from_mapping({
        "plant": plant, "features": "images", "gain": 3.0, "time_after_convergence": 0.1,
        "camera": {"horizontal_fov": 2.0, **camera},
    }))  # fmt: skip
    assert result.converged and result.verdict.distance < 1e-3
