"""Vibrating camera: its poses and its images."""

from itertools import count

import numpy as np
import pytest
from scenes import link_pose, looking, table_and_target

from aras_sim_bridge.camera import CameraConfig, CameraSensor
from aras_sim_bridge.camera.vibration import Shake, Vibration
from aras_sim_bridge.rendering import View, create_renderer
from aras_visual_servo_base.poses import rpy_from_rotation

MS = 1_000_000
XYZ, RPY = (1e-3, 2e-3, 3e-3), (0.01, 0.02, 0.03)
LINK = link_pose(looking([0.02, 0.0, 0.782], [0.0, 0.0, 0.59], (1, 0, 0)))
# The sensor's forward, left and up are the optical z, -x and -y.
AXES = np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0]])


def moved(vibration, seconds=8.0, rate=500.0):
    """(n, 6) along and about the sensor's axes, m and rad."""
    found = []
    for k in range(round(seconds * rate)):
        pose = vibration.compute_pose(round(k / rate * 1e9))
        xyz, rpy = AXES.T @ pose[:3, 3], rpy_from_rotation(AXES.T @ pose[:3, :3] @ AXES)
        found.append([*xyz, *rpy])
    return np.array(found)


def test_a_sine_in_each_direction():
    found = moved(Vibration(Shake(frequency=12.5, xyz=XYZ, rpy=RPY), 3))
    np.testing.assert_allclose(np.abs(found).max(axis=0), [*XYZ, *RPY], rtol=0.02)
    power = np.abs(np.fft.rfft(found, axis=0)) ** 2
    at = np.fft.rfftfreq(len(found), 1 / 500.0)
    assert (at[power[:, :3].argmax(axis=0)] == 12.5).all()
    phases = np.angle(np.fft.rfft(found[:, :3], axis=0)[round(12.5 * 8)])
    assert np.abs(np.subtract.outer(phases, phases))[~np.eye(3, dtype=bool)].min() > 0.05


def test_noise_within_a_band_has_a_sines_power():
    shake = Shake(frequency=30.0, xyz=XYZ, rpy=RPY, bandwidth=20.0)
    found = moved(Vibration(shake, 3), 60.0, 125.0)
    np.testing.assert_allclose(found.std(axis=0) * np.sqrt(2.0), [*XYZ, *RPY], rtol=0.05)
    power = np.abs(np.fft.rfft(found[:, :3] * np.hanning(len(found))[:, None], axis=0)) ** 2
    at = np.fft.rfftfreq(len(found), 1 / 125.0)
    outside = (at < 19.9) | (at > 40.1)
    assert (power[outside].sum(axis=0) < 1e-3 * power.sum(axis=0)).all()
    for low in (20.0, 25.0, 30.0, 35.0):  # no part of the band is empty
        part = power[(at >= low) & (at < low + 5.0)].sum(axis=0) / power.sum(axis=0)
        assert (part > 0.1).all()


def test_a_seed_is_a_shake():
    assert Shake(frequency=20.0).xyz == Shake(frequency=20.0).rpy == (0.0, 0.0, 0.0)
    shake = Shake(frequency=20.0, xyz=XYZ, bandwidth=5.0)
    at = Vibration(shake, 7).compute_pose(123_456_789)
    np.testing.assert_array_equal(at, Vibration(shake, 7).compute_pose(123_456_789))
    assert np.abs(at - Vibration(shake, 8).compute_pose(123_456_789)).max() > 1e-5
    # in every version, with which pictures of a study are made again
    assert 1e6 * AXES.T @ at[:3, 3] == pytest.approx([-309.953, -2633.949, -971.269], abs=1e-2)


def camera(**keys):
    return CameraConfig.from_mapping(
        {"name": "eye", "width": 160, "height": 120, "near": 0.02, "update_rate": 30.0, **keys})


def next_frame(sensor, ticks):
    """The next frame of a camera whose link stays at LINK; ticks: a clock, ms."""
    frame = None
    while frame is None:
        k = next(ticks)
        if sensor.needs_previous_pose(k * MS):
            sensor.before_step(LINK, (k - 1) * MS)
        if sensor.is_due(k * MS):
            frame = sensor.capture(LINK, k * MS)
    return frame


def test_pictures_are_of_where_it_is_at_their_instants(bench):
    """Also between two ticks; what is known of its mounting stays."""
    table_and_target(bench)
    renderer = create_renderer("exact", bench.world)
    shake = {"xyz": [2e-3, 1e-3, 3e-3], "rpy": [0.01, 0.02, 0.03], "frequency": 21.0}
    config = camera(shake=shake, xyz=[0.01, 0.0, 0.02], seed=5)
    one = CameraSensor(config, renderer)
    still = CameraSensor(camera(xyz=[0.01, 0, 0.02]), renderer)
    np.testing.assert_array_equal(one.link_T_optical, still.link_T_optical)
    np.testing.assert_array_equal(one.info.K, still.info.K)
    vibration, ticks = Vibration(Shake(**shake), 5), count(1)
    frames = [next_frame(one, ticks) for _ in range(3)]
    assert [frame.stamp_ns for frame in frames] == [round(k * 1e9 / 30) for k in (1, 2, 3)]
    mean = LINK @ still.link_T_optical
    for frame in frames:
        pose = mean @ vibration.compute_pose(frame.stamp_ns)
        drawn = renderer.render(View(160, 120, pose, config.K, config.near, config.far))
        np.testing.assert_array_equal(frame.image, drawn)
    assert (frames[0].image != frames[1].image).any()


def test_rows_that_are_read_one_after_the_other_shake_by_themselves(bench):
    table_and_target(bench)
    renderer = create_renderer("exact", bench.world)
    shake = {"rpy": [0.0, 0.0, 0.05], "frequency": 60.0}
    rows = {"row_time": 1e-4, "rows_together": 8}
    sensor = CameraSensor(camera(shake=shake, effects=rows), renderer)
    frame = next_frame(sensor, count(1))
    vibration, mean = Vibration(Shake(**shake), 0), LINK @ sensor.link_T_optical
    for first in (0, 56, 112):
        at = frame.stamp_ns + round(1e5 * (first + 3.5 - 59.5))
        pose, K = mean @ vibration.compute_pose(at), sensor.config.K
        whole = renderer.render(View(160, 120, pose, K, 0.02, sensor.config.far)).astype(int)
        np.testing.assert_allclose(frame.image[first:first + 8], whole[first:first + 8], atol=3)
