"""Imaging without a renderer: exact features, drawn images, depth, rolling shutter."""

from dataclasses import replace

import numpy as np
import pytest

from aras_sim_bridge.camera.effects import AutoExposure, Effects
from aras_sim_bridge.camera.shutter import RowBand, make_row_bands
from aras_sim_bridge.camera.vibration import Vibration
from aras_visual_servo_base.poses import matrix_from_xyz_rpy
from aras_visual_servo_base.settings import convert
from aras_visual_servo_bench.experiment import cameras
from aras_visual_servo_bench.plants import JointReading
from aras_visual_servo_bench.plants.base import CameraPlacement
from aras_visual_servo_bench.plants.exposures import (
    ExposureSchedule,
    collect_vibrations,
    make_exposure_schedules,
)
from aras_visual_servo_bench.plants.imaging import ImagingSettings, capture
from aras_visual_servo_bench.targets.geometry import PlacedTarget, PolygonTarget, TargetMotion
from aras_visual_servo_bench.targets.target_factory import make_target
from aras_visual_servo_camera.camera_model import CameraModel

CAMERA = CameraModel(60, 40, (50.0, 0, 31.0, 0, 40.0, 18.0, 0, 0, 1))
SHAPE = PolygonTarget(((-0.2, -0.15), (0.25, -0.1), (0.2, 0.2), (-0.1, 0.1)))
MOVES = TargetMotion(velocity=(0.1, 0.0, 0.0, 0.0, 0.0, 0.0))
SIGHT = ImagingSettings(
    CAMERA, PlacedTarget(SHAPE, matrix_from_xyz_rpy((0.0, 0.0, 0.1), (0.0, 0.0, 0.3)), MOVES))
SHAKE = Vibration(cameras.make_camera_config(
    {"shake": {"xyz": [0.02, 0.01, 0.01], "rpy": [0.01, 0.02, 0.03], "frequency": 20.0}}).shake, 3)
POSE = matrix_from_xyz_rpy((0.03, 0.02, 1.1), (np.pi - 0.2, 0.1, 0.2))
STAMP = 500_000_000


def see(sight, pose=POSE, stamp=STAMP):
    return capture(sight, pose, stamp, np.random.default_rng(0))


def exactly(pose, time=0.5, sight=SIGHT):
    here = matrix_from_xyz_rpy((0.1 * time, 0.0, 0.1), (0.0, 0.0, 0.3))
    corners = np.array([(x, y, 0.0, 1.0) for x, y in SHAPE.corners]) @ here.T
    x, y, z, _ = (corners @ np.linalg.inv(pose).T).T
    return np.column_stack([50.0 * x / z + 31.0, 40.0 * y / z + 18.0])


def test_exact_features_are_where_the_target_is_at_the_stamp():
    found = see(replace(SIGHT, name="left"))
    assert (found.stamp_ns, found.name, found.has_image) == (STAMP, "left", False)
    np.testing.assert_allclose(found.points, exactly(POSE), atol=1e-9)
    np.testing.assert_array_equal(found.points, found.outline)
    place = CameraPlacement(matrix_from_xyz_rpy((0.1, 0.05, 0.0), (0.0, 0.1, 0.3)))
    beside = see(replace(SIGHT, placement=place, vibration=SHAKE, is_unbounded=True))
    at = POSE @ place.pose @ SHAKE.compute_pose(STAMP)
    assert np.abs(SHAKE.compute_pose(STAMP)[:3, 3]).max() > 1e-3
    np.testing.assert_allclose(beside.points, exactly(at), atol=1e-9)


def test_what_leaves_the_picture_is_lost_unless_that_has_no_border():
    for shift in (np.array([0.8, 0.0]), np.array([0.0, 0.8])):
        aside = POSE.copy()
        aside[:2, 3] += shift
        assert see(SIGHT, aside).outline is None
        seen = see(replace(SIGHT, is_unbounded=True), aside)
        np.testing.assert_allclose(seen.points, exactly(aside), atol=1e-9)
    behind = see(replace(SIGHT, is_unbounded=True), matrix_from_xyz_rpy((0, 0, 1.1), (0, 0, 0)))
    assert behind.outline is None and behind.points is None and behind.name == "camera"


def test_an_outline_s_noise_is_drawn_a_hundred_times_at_most():
    """Of 30 corners a tenth of a pixel apart, some edges cross whatever noise of 9 px is drawn."""
    pixels, noisy = np.column_stack([0.1 * np.arange(30), np.zeros(30)]), replace(SIGHT, jitter=9.0)
    random, same = np.random.default_rng(0), np.random.default_rng(0)
    noisy.add_jitter(pixels, random, is_closed=True)
    for _ in range(100):
        same.normal(0.0, 9.0, (30, 2))
    assert random.bit_generator.state == same.bit_generator.state
    found = noisy.add_jitter(pixels, random)
    np.testing.assert_array_equal(found, pixels + same.normal(0.0, 9.0, (30, 2)))
    assert random.bit_generator.state == same.bit_generator.state
    assert noisy.add_jitter(None, random) is None


def test_each_effect_acts_on_a_drawn_image_and_on_its_seed():
    sight, bare = replace(SIGHT, has_images=True), replace(SIGHT, has_images=True)
    plain = see(bare).image
    for effects in ({"noise_stddev": 8.0}, {"shot_noise": 2.0}, {"gain": 0.5}, {"exposure": 0.5},
                    {"vignetting": 0.5}, {"noise_mean": -20.0},
                    {"sensor": {"gain": 0.1, "full_well": 2e3, "read_noise": 9.0}}):
        one = replace(sight, effects=convert(effects, Effects, "", ValueError), seed=5)
        found = see(one).image
        assert (found != plain).mean() > 0.3, effects
        np.testing.assert_array_equal(found, see(one).image)
        by_chance = not {"noise_stddev", "shot_noise", "sensor"}.isdisjoint(effects)
        other = see(replace(one, seed=6)).image
        assert (found != other).any() == by_chance, effects


def test_an_open_shutter_blurs_what_moves():
    effects = Effects(exposure_time=0.02, exposure_samples=3)
    sight = replace(SIGHT, target=FLAT, has_images=True, has_labels=True, effects=effects,
                    row_bands=make_row_bands(effects, CAMERA.height))
    found = see(sight, ASIDE)
    each = [see(replace(sight, row_bands=(), effects=Effects()), pose).image for pose in ASIDE]
    np.testing.assert_array_equal(found.image, (np.sum(each, axis=0, dtype=int) + 1) // 3)
    np.testing.assert_array_equal(found.target_mask, np.where(found.image < 128, 255, 0))


def test_the_auto_exposure_follows_the_images_that_were_delivered():
    effects = Effects(auto_exposure=AutoExposure(target=100.0, speed=1.0))
    sight = replace(SIGHT, has_images=True, effects=effects)
    exposed = ExposureSchedule(sight, np.random.default_rng(0))
    means = [exposed.expose(POSE).image.mean() for _ in range(3)]
    assert means[0] > 150 and means[1:] == pytest.approx([100.0, 100.0], abs=1.0)


def test_a_mosaic_and_wide_pixels_are_delivered_in_their_encoding():
    plain = see(replace(SIGHT, has_images=True)).image
    for encoding, factor in (("bayer_rggb8", 1), ("mono16", 257)):
        found = see(replace(SIGHT, has_images=True, encoding=encoding))
        assert found.encoding == encoding
        np.testing.assert_array_equal(found.image, plain.astype(int) * factor)


def test_depth_is_the_plane_s_in_each_pixel_and_none_behind_its_horizon():
    low = matrix_from_xyz_rpy((0.0, -0.4, 0.35), (np.pi + 1.3, 0.0, 0.0))  # looks along the ground
    found = see(replace(SIGHT, has_images=True, has_depth=True), low)
    assert found.depth.shape == (40, 60) and found.depth.dtype == np.float32
    v, u = np.indices((40, 60))
    rays = np.stack([(u - 31.0) / 50.0, (v - 18.0) / 40.0, np.ones((40, 60))], -1) @ low[:3, :3].T
    with np.errstate(divide="ignore"):
        depth = (0.1 - 0.35) / rays[..., 2]
    np.testing.assert_allclose(found.depth, np.where(depth > 0, depth, np.inf), rtol=1e-5)
    assert np.isinf(found.depth).any() and np.isfinite(found.depth).any()
    fish = CameraModel(60, 40, (8.0, 0, 31.0, 0, 8.0, 18.0, 0, 0, 1), (0.0,) * 4, "equidistant")
    seen = see(replace(SIGHT, camera=fish, has_images=True, has_depth=True))
    assert np.isinf(seen.depth[0, 0]) and np.isfinite(seen.depth[18, 31])  # no ray, and one


def test_a_flat_target_is_drawn_and_told_by_where_it_is_dark():
    sight = replace(SIGHT, has_images=True, has_labels=True, name="left")
    found = see(sight)
    assert (found.stamp_ns, found.encoding, found.name) == (STAMP, "mono8", "left")
    assert found.depth is None
    outline = (exactly(POSE) - [31.0, 18.0]) / [50.0, 40.0]
    np.testing.assert_array_equal(found.image, cameras.draw_outline(outline, CAMERA))
    np.testing.assert_array_equal(found.target_mask, np.where(found.image < 128, 255, 0))
    assert found.target_mask.dtype == np.uint8
    assert see(replace(sight, has_labels=False)).target_mask is None
    noisy = see(replace(sight, effects=Effects(noise_stddev=60.0)))
    assert (noisy.image != found.image).mean() > 0.4
    # of the picture without noise
    np.testing.assert_array_equal(noisy.target_mask, found.target_mask)
    target = PlacedTarget(make_target("box", (0.3, 0.2, 0.2)), np.eye(4))
    solid = see(replace(sight, target=target))  # by its own pixels
    assert (solid.image[solid.target_mask == 0] > 250).mean() > 0.9
    assert (solid.image[solid.target_mask > 0] < 250).mean() > 0.9


def test_a_lens_shows_nothing_beyond_its_cutoff():
    blind = np.zeros((40, 60), bool)
    blind[:, 40:] = True  # the target's right corner is there
    for features in (False, True):
        sight = replace(SIGHT, has_images=features, blind_mask=blind)
        found = see(sight)
        bare = see(replace(sight, blind_mask=None))
        if features:
            assert (found.image[:, 40:] == 0).all()
            np.testing.assert_array_equal(found.image[:, :40], bare.image[:, :40])
        else:
            assert bare.points is not None and found.points is None and found.outline is None


ROWS = (RowBand(-3_000_000, 0, 10), RowBand(1_000_000, 10, 24), RowBand(4_000_000, 24, 40))


def test_images_come_with_their_period_after_their_last_rows_and_some_are_lost():
    dropping = replace(SIGHT, rate=8.0, effects=Effects(drop_probability=0.3), seed=3)
    exposed, count = ExposureSchedule(dropping, np.random.default_rng(0)), 0
    for stamp in range(125_000_000, 401 * 125_000_000, 125_000_000):
        assert exposed.due_ns == stamp
        if (seen := exposed.expose(POSE)) is not None:
            assert seen.stamp_ns == stamp
            count += 1
    assert count == pytest.approx(280, abs=28)
    exposed = ExposureSchedule(replace(SIGHT, rate=10.0, row_bands=ROWS), np.random.default_rng(0))
    for stamp in range(100_000_000, 3_000_000_000, 100_000_000):
        for k, part in enumerate(ROWS):
            assert exposed.due_ns == stamp + part.offset_ns
            assert (exposed.expose(POSE) is None) is (k < 2)  # none is lost


def test_each_camera_draws_by_itself():
    noisy = replace(SIGHT, jitter=1.0)
    found = make_exposure_schedules(noisy, [noisy, noisy], np.random.default_rng(5), 5)
    seen = [one.expose(POSE).points for one in found]
    again = [one.expose(POSE).points
             for one in make_exposure_schedules(noisy, [noisy], np.random.default_rng(5), 5)]
    np.testing.assert_array_equal(seen[:2], again)
    for a, b in ((0, 1), (1, 2), (0, 2)):
        assert np.abs(seen[a] - seen[b]).max() > 0.1
    shakes = replace(SIGHT, name="b", vibration="v")
    assert collect_vibrations(SIGHT, shakes) == {"b": "v"}


MIDDLES = np.array([4.5, 16.5, 31.5])
SHIFTS = np.array([-0.04, 0.03, 0.10])  # m of the camera along its x, 1 m before the target
FLAT = PlacedTarget(SHAPE, np.eye(4))
ASIDE = [np.array([[1.0, 0, 0, s], [0, -1.0, 0, 0], [0, 0, -1.0, 1.0], [0, 0, 0, 1.0]])
         for s in SHIFTS]


def test_a_point_moves_evenly_between_the_parts_that_see_it():
    rolled = replace(SIGHT, target=FLAT, row_bands=ROWS, name="left")
    found = see(rolled, ASIDE)
    assert (found.stamp_ns, found.name) == (STAMP, "left")
    corners = np.array(SHAPE.corners)
    v = 18.0 - 40.0 * corners[:, 1]
    shift = np.interp(v, MIDDLES, SHIFTS)
    wanted = np.column_stack([31.0 + 50.0 * (corners[:, 0] - shift), v])
    np.testing.assert_allclose(found.points, wanted, atol=1e-9)
    np.testing.assert_allclose(found.outline, wanted, atol=1e-9)
    assert len({round(s, 3) for s in shift}) == 4
    high = PolygonTarget(((0.0, 0.4), (0.1, 0.39), (0.05, -0.5)))  # rows 2, 2.4 and 38
    ends = see(replace(rolled, target=PlacedTarget(high, np.eye(4))), ASIDE)
    np.testing.assert_allclose(
        ends.points[:, 0], 31.0 + 50.0 * (np.array([0.0, 0.1, 0.05]) - SHIFTS[[0, 0, 2]]))


def test_rows_that_the_target_runs_ahead_of():
    """The camera sinks: a point at row v moves by d v a part, and is met where the shutter is."""
    sinking = [pose.copy() for pose in ASIDE]
    for pose, y in zip(sinking, (0.0, 0.1, 0.2), strict=True):
        pose[:3, 3] = 0.0, y, 1.0
    shape = PolygonTarget(((-0.2, 0.0), (0.2, 0.05), (0.1, 0.15)))
    found = see(replace(SIGHT, target=PlacedTarget(shape, np.eye(4)), row_bands=ROWS), sinking)
    for (x, y), pixel in zip(shape.corners, found.points, strict=True):
        v = 18.0 - 40.0 * (y - np.array([0.0, 0.1, 0.2]))  # at each part
        k = 0 if v[1] <= MIDDLES[1] else 1
        share = (v[k] - MIDDLES[k]) / ((v[k] - MIDDLES[k]) - (v[k + 1] - MIDDLES[k + 1]))
        row = v[k] + np.clip(share, 0, 1) * (v[k + 1] - v[k])
        np.testing.assert_allclose(pixel, [31.0 + 50.0 * x, row], atol=1e-9)


def test_a_point_that_the_shutter_never_meets_is_of_the_last_rows():
    low = PlacedTarget(PolygonTarget(((0.0, -0.5), (0.1, -0.51), (0.05, -0.49))), np.eye(4))
    found = see(replace(SIGHT, target=low, row_bands=ROWS), ASIDE)
    x = np.array([0.0, 0.1, 0.05])
    np.testing.assert_allclose(found.points[:, 0], 31.0 + 50.0 * (x - SHIFTS[2]))
    met = PlacedTarget(PolygonTarget(((0.0, -0.3375), (0.1, -0.3), (0.05, -0.3))), np.eye(4))
    last = see(replace(SIGHT, target=met, row_bands=ROWS), ASIDE).points[0]
    assert last[1] == MIDDLES[2]  # in the middle of the last rows, to the last digit
    assert last[0] == pytest.approx(31.0 - 50.0 * SHIFTS[2])


def test_what_leaves_the_picture_while_it_is_read_is_lost():
    rolled = replace(SIGHT, target=FLAT, row_bands=ROWS, name="left")
    for axis in (0, 1):
        aside = [pose.copy() for pose in ASIDE]
        for pose in aside:
            pose[axis, 3] += 0.6
        found = see(rolled, aside)
        assert found.points is None and found.outline is None and found.name == "left"
        assert see(replace(rolled, is_unbounded=True), aside).points is not None
    behind = [pose @ np.diag([1.0, -1.0, -1.0, 1.0]) for pose in ASIDE]
    assert see(rolled, behind).points is None
    noisy = replace(rolled, jitter=0.5)
    spread = np.array([capture(noisy, ASIDE, STAMP, random).points
                       for random in [np.random.default_rng(0)] for _ in range(200)])
    np.testing.assert_allclose(spread.std(axis=0), 0.5, rtol=0.2)


def test_a_picture_s_rows_are_of_their_own_instants():
    moving = replace(
        SIGHT, has_images=True, has_depth=True, has_labels=True, row_bands=ROWS, name="left")
    found = see(moving, ASIDE)
    still = replace(moving, row_bands=())
    for part, pose in zip(ROWS, ASIDE, strict=True):
        now = see(still, pose, STAMP + part.offset_ns)
        rows = slice(part.first, part.last)
        np.testing.assert_array_equal(found.image[rows], now.image[rows])
        np.testing.assert_array_equal(found.target_mask[rows], now.target_mask[rows])
    # The part that is nearest to the stamp sees the depth.
    np.testing.assert_allclose(found.depth, see(still, ASIDE[1]).depth)
    assert (found.encoding, found.name, found.stamp_ns) == ("mono8", "left", STAMP)
    dim = see(replace(moving, effects=Effects(gain=0.5)), ASIDE)
    np.testing.assert_array_equal(dim.image, np.round(0.5 * found.image))  # once, over the whole
    np.testing.assert_array_equal(dim.target_mask, found.target_mask)


def test_another_camera_is_beside_the_control_camera_or_stands():
    a, b, c = (matrix_from_xyz_rpy(xyz, rpy) for xyz, rpy in (((1, 2, 3), (0.1, 0.2, 0.3)),
               ((0.3, 0.1, 0.2), (0.3, 0.1, -0.2)), ((0.5, 0.6, 0.1), (0.2, 0.2, 0.1))))
    np.testing.assert_allclose(CameraPlacement(b).compute_pose(a), a @ b)
    np.testing.assert_array_equal(CameraPlacement(b, is_fixed=True).compute_pose(a), b)
    found = CameraPlacement(b, target_T_control=c).compute_pose(a)
    np.testing.assert_allclose(found, c @ np.linalg.inv(a) @ b, atol=1e-12)
    reading = JointReading(1_500_000_000, ("a", "b", "c"), (1.0, 2.0, 3.0), (4.0, 5.0, 6.0))
    q, v = reading.select(("c", "a"))
    assert (reading.stamp, q.tolist(), v.tolist()) == (1.5, [3.0, 1.0], [6.0, 4.0])
