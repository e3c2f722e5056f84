"""Exposure times of a camera, contents of its frames, and effects."""

import logging

import numpy as np
import pytest
from scenes import BRIGHT, link_pose, looking, table_and_target

from aras_sim_bridge.camera import CameraConfig, CameraSensor
from aras_sim_bridge.camera.effects import EffectChain, Effects, SensorModel
from aras_sim_bridge.camera.pixel_formats import find_shape, read_out, widen
from aras_sim_bridge.description import Geometry, Link, RobotDescription, Visual
from aras_sim_bridge.errors import CameraError
from aras_sim_bridge.rendering import Lighting, create_renderer
from aras_sim_bridge.rendering.renderer import Renderer
from aras_sim_bridge.world import Pose, World

MS = 1_000_000
DOWN = link_pose(looking([0.0, 0.0, 0.782], [0.0, 0.0, 0.59], (1, 0, 0)))


def grey_renderer(level=100):
    """A renderer of an empty world, whose images have one grey level."""
    return create_renderer("exact", World(), Lighting(background=(level / 255.0,) * 3 + (1.0,)))


def frames(sensor, ticks, step=MS, start=0):
    out = []
    for k in range(1, ticks + 1):
        after = start + k * step
        if sensor.needs_previous_pose(after):
            sensor.before_step(np.eye(4), after - step)
        if sensor.is_due(after):
            frame = sensor.capture(np.eye(4), after)
            if frame is not None:
                out.append((after, frame))
    return out


def camera(renderer=None, **settings):
    settings = {"width": 16, "height": 8, **settings}
    return CameraSensor(CameraConfig.from_mapping(settings), renderer or grey_renderer())


def test_stamps_are_exact_multiples_of_the_period():
    got = frames(camera(update_rate=30.0), 4_000)
    assert [f.stamp_ns for _, f in got] == [round(k * 1e9 / 30) for k in range(1, 121)]
    assert all(0 <= tick - f.stamp_ns < MS for tick, f in got)


@pytest.mark.parametrize("effects", [
    {}, {"exposure_time": 0.02, "exposure_samples": 4}, {"row_time": 1e-4, "rows_together": 8},
    {"row_time": 8e-5, "rows_together": 5, "exposure_time": 0.01, "exposure_samples": 2},
])  # fmt: skip
def test_a_moving_bar_is_in_each_row_where_it_is_at_the_row_s_instant(bench, effects):
    """The bar is as long as the image is high; 1 m/s along x are 0.63 px a tick."""
    bench.box([0.5, 0.5, 0.01], [0, 0, -0.01])
    body = bench.box([0.02, 0.5, 0.001], [0, 0, 0], "Gazebo/Black")
    sensor = CameraSensor(
        CameraConfig.from_mapping({"horizontal_fov": 0.5, "update_rate": 30.0, "near": 0.01,
                                   "effects": effects}),
        create_renderer("exact", bench.world, BRIGHT),
    )
    pose = link_pose(looking([0, 0, 1.0], [0, 0, 0], (0, 1, 0)))
    shown, together = [], effects.get("rows_together", 1)
    for k in range(1, 90):
        if sensor.needs_previous_pose(k * MS):
            sensor.before_step(pose, (k - 1) * MS)
        body.set_pose(Pose((k * 1e-3, 0.0, 0.0)))
        if sensor.is_due(k * MS):
            shown.append(sensor.capture(pose, k * MS))
    shown = [frame for frame in shown if frame is not None]
    assert [frame.stamp_ns for frame in shown] == [33_333_333, 66_666_667]
    first = np.arange(240) // together * together
    middle = (first + np.minimum(first + together, 240) - 1) / 2
    late = effects.get("row_time", 0.0) * (middle - 119.5)
    for frame in shown:
        dark = 255.0 - frame.image[..., 0]
        columns = (dark * np.arange(320)).sum(axis=1) / dark.sum(axis=1)
        x = frame.stamp_ns * 1e-9 + late
        np.testing.assert_allclose(columns, 159.5 + sensor.info.K[0, 0] * x / 0.999, atol=0.1)
        blurred = ((dark > 30.0) & (dark < 225.0)).sum(axis=1)
        assert (blurred[100:140].min() > 4) == ("exposure_time" in effects)


def test_a_reset_leaves_no_frame_of_the_time_before(bench):
    """Neither one that waits for its publication nor the half of an exposure."""
    renderer = create_renderer("exact", bench.world, BRIGHT)
    sensor = camera(renderer, update_rate=10.0, latency=0.05, effects={"exposure_time": 0.02})
    assert frames(sensor, 120) == []
    sensor.reset(120 * MS)
    assert frames(sensor, 80, start=120 * MS) == []  # three fifths of the one at 200 ms were drawn
    sensor.reset(0)
    bench.box([0.01, 9.0, 9.0], [1.0, 0.0, 0.0], "Gazebo/Black")
    got = frames(sensor, 260)
    assert [(tick // MS, frame.stamp_ns // MS) for tick, frame in got] == [(150, 100), (250, 200)]
    assert not any(frame.image.any() for _, frame in got)


def test_a_camera_that_cannot_be_drawn_is_refused_at_once(bench):
    renderer = create_renderer("exact", bench.world, BRIGHT)
    for matrix in ((1e-300, 1e-300, 10.0, 10.0), (1e12, 1e12, 10.0, 10.0),
                   (100.0, 1e9, 10.0, 10.0), (100.0, 100.0, 10.0, -1e12)):
        with pytest.raises(CameraError, match=r"camera 'camera': a pinhole camera with fx=.*px "
                                              r"cannot"):
            camera(renderer, camera_matrix=matrix)
    camera(renderer, camera_matrix=(1e-3, 1e7, 1e4, -1e4))

    class FullRenderer(Renderer):
        def prepare(self, view):
            raise MemoryError

    with pytest.raises(CameraError, match="not enough memory; make width and height smaller"):
        camera(FullRenderer(bench.world, BRIGHT, 0))


def test_reset_and_rate_change():
    sensor = camera(update_rate=10.0)
    frames(sensor, 250)
    sensor.reset(0)
    assert frames(sensor, 100)[0][1].stamp_ns == 100 * MS
    sensor.set_rate(20.0, 120 * MS, MS)
    assert sensor.due_ns == 150 * MS
    with pytest.raises(CameraError, match="above 0"):
        sensor.set_rate(0.0, 0, MS)
    with pytest.raises(CameraError, match="2000 Hz is above the physics rate of 1000 Hz"):
        sensor.set_rate(2000.0, 0, MS)
    assert sensor.rate == 20.0
    camera(update_rate=1000.0).check_time_step(MS)
    with pytest.raises(CameraError, match="1001 Hz is above the physics rate of 1000 Hz"):
        camera(update_rate=1001.0).check_time_step(MS)
    blurred = camera(update_rate=10.0, effects={"exposure_time": 0.02})
    with pytest.raises(CameraError, match="exposure_time 0.02 s must .* 0.0166667 s; .* this time"):
        blurred.set_rate(60.0, 0, MS)


def test_with_steps_longer_than_the_period_only_the_newest_picture_is_taken(caplog):
    sensor = camera(update_rate=30.0)
    got = frames(sensor, 4, step=100 * MS)
    assert [f.stamp_ns // MS for _, f in got] == [100, 200, 300, 400]
    told = [r.getMessage() for r in caplog.records if "drops frames" in r.getMessage()]
    assert len(told) == 1
    assert "30 Hz is above the physics rate" in told[0]
    # also where a step ends with a picture's instant, to the nanosecond
    assert [f.stamp_ns for _, f in frames(camera(update_rate=30.0), 1, step=133_333_333)] == [
        133_333_333]  # fmt: skip


def test_latency_delays_publication_not_the_stamp():
    """And what waits survives a change of rate."""
    got = frames(camera(update_rate=10.0, latency=0.035), 400)
    assert [(tick // MS, f.stamp_ns // MS) for tick, f in got] == [(135, 100), (235, 200),
                                                                    (335, 300)]
    sensor = camera(update_rate=10.0, latency=0.25)
    assert not frames(sensor, 310)
    sensor.set_rate(20.0, 310 * MS, MS)
    stamps = [f.stamp_ns // MS for _, f in frames(sensor, 320, start=310 * MS)]
    assert stamps == [100, 200, 300, 350]


def test_dropped_frames_are_seeded_and_keep_the_grid():
    def run(seed):
        sensor = camera(update_rate=100.0, seed=seed, effects={"drop_probability": 0.3})
        return [f.stamp_ns // MS for _, f in frames(sensor, 3000)]

    first = run(1)
    assert first == run(1) != run(2)
    assert 180 < len(first) < 240
    # the same ones in every version, with which a study is made again
    assert sorted({*range(10, 200, 10)} - {*first}) == [60, 80, 150, 180, 190]
    assert all(stamp % 10 == 0 for stamp in first)


def test_a_blurred_picture_of_what_stands_is_as_bright_and_comes_after_its_exposure():
    for samples, tick in ((5, 108), (2, 105)):
        effects = {"exposure_time": 0.02, "exposure_samples": samples}
        ((after, frame),) = frames(camera(update_rate=10.0, effects=effects), 150)
        assert (after, frame.stamp_ns) == (tick * MS, 100 * MS)
        assert (frame.image == 100).all() and frame.image.dtype == np.uint8
    # The shutter of the image at 100 ms opened at 90 ms, before there was a subscriber.
    sensor = camera(update_rate=10.0, effects={"exposure_time": 0.02})
    sensor.reset(95 * MS)
    assert [f.stamp_ns // MS for _, f in frames(sensor, 200, start=95 * MS)] == [200]


def test_a_triggered_picture_is_read_before_the_next_one_begins():
    sensor = camera(update_rate=10.0, trigger_topic="go", effects={"row_time": 0.004})
    for _ in range(2):
        sensor.trigger(100 * MS, MS)
    first, second = (frame.stamp_ns for _, frame in frames(sensor, 300, start=100 * MS))
    assert first == 101 * MS and second == first + 32 * MS
    sensor = camera(trigger_topic="go", effects={"exposure_time": 0.004, "exposure_samples": 4})
    for _ in range(2):
        sensor.trigger(0, MS)
    assert [f.stamp_ns for _, f in frames(sensor, 20)] == [2_500_000, 6_500_000]


@pytest.mark.parametrize(("gain", "vignetting", "shot"), [
    (1.0, 0.0, 0.0), (0.7, 0.3, 0.0), (0.7, 0.0, 0.05), (1.0, 0.3, 0.05)])
def test_auto_exposure_brings_the_mean_to_its_target(gain, vignetting, shot):
    def means(level, **auto):
        effects = {"auto_exposure": {"target": 90.0, **auto}, "gain": gain, "shot_noise": shot,
                   "vignetting": vignetting}  # fmt: skip
        sensor = camera(grey_renderer(level), update_rate=100.0, effects=effects, width=64,
                        height=48)
        found = [frame.image.mean() for _, frame in frames(sensor, 200)]
        sensor.reset(0)
        assert [frame.image.mean() for _, frame in frames(sensor, 60)] == found[:6]
        return found

    for level in (30, 160):
        found = means(level)
        assert found[0] == pytest.approx(level * gain * (1 - vignetting / 3), rel=0.02)
        assert found[-1] == pytest.approx(90.0, abs=1.5)
        ratio = np.log(90.0 / found[1]) / np.log(90.0 / found[0])
        assert ratio == pytest.approx(0.5, abs=0.1)
    assert means(20, most=2.0)[-1] == pytest.approx(2.0 * 20 * gain * (1 - vignetting / 3), abs=1.0)


def test_depth_is_that_of_the_middle_of_the_exposure(bench):
    """Of a wall that comes nearer by 1 m/s."""
    wall = bench.box([0.01, 9.0, 9.0], [3.0, 0.0, 0.0])
    sensor = camera(create_renderer("exact", bench.world, BRIGHT), update_rate=10.0, depth=True,
                    effects={"exposure_time": 0.02, "exposure_samples": 5})

    def frame_until(end, begin):
        found = []
        for k in range(begin, end):
            if sensor.needs_previous_pose(k * MS):
                sensor.before_step(np.eye(4), (k - 1) * MS)
            wall.set_pose(Pose((3.0 - k * 1e-3, 0.0, 0.0)))
            found.append(sensor.capture(np.eye(4), k * MS))
        return [frame for frame in found if frame is not None]

    (frame,) = frame_until(151, 1)
    np.testing.assert_allclose(frame.depth, 2.89, atol=1e-5)
    sensor.depth = False
    assert not frame_until(203, 151)
    sensor.depth = True  # too late for this picture, which has no earlier one's
    (frame,) = frame_until(223, 203)
    assert frame.depth is None


@pytest.mark.parametrize("stddev", [1.0, 20.0])
def test_noise_has_the_asked_statistics_and_a_seed(stddev):
    grey = np.full((240, 320, 3), 128, np.uint8)
    chain = EffectChain(Effects(noise_stddev=stddev, noise_mean=2.0), grey.shape, seed=4)
    noise = np.array([chain.apply(grey, stamp) for stamp in range(12)]) - 130.0
    # Of 2.8 million values the deviation itself deviates by 0.04 %.
    assert noise.std() == pytest.approx(stddev, rel=1.5e-3)
    assert noise.mean() == pytest.approx(0.0, abs=4 * stddev / np.sqrt(noise.size))
    assert (noise**4).mean() / (noise**2).mean() ** 2 == pytest.approx(3.0, abs=0.08)
    for level in (0, 255):  # within what a byte holds
        off = chain.apply(np.full_like(grey, level), 33).astype(int) - level
        assert np.abs(off).max() < 7 * stddev + 3
    first, second = chain.apply(grey, 33), chain.apply(grey, 66)
    for other in (second, EffectChain(chain.effects, grey.shape, 5).apply(grey, 33)):
        assert abs(np.corrcoef(first.ravel(), other.ravel())[0, 1]) < 0.02
    part = np.full((240, 640, 3), 128, np.uint8)[:, :320]
    assert np.array_equal(chain.apply(part, 33), chain.apply(grey, 33))  # a view of a larger one
    again = EffectChain(chain.effects, grey.shape, seed=4)
    assert (again.apply(grey, 33) == first).all()


@pytest.mark.parametrize("format", ["rgb8", "bgr8", "mono8", "mono16", "bayer_grbg8"])
def test_noise_is_as_strong_in_every_format(format):
    sensor = camera(width=320, height=240, format=format, effects={"noise_stddev": 5.0})
    image = sensor.capture(np.eye(4), 100 * MS).image
    full = 257.0 if image.dtype == np.uint16 else 1.0
    assert image.std() / full == pytest.approx(5.0, rel=0.02)


def test_a_picture_is_the_same_whoever_looked_before():
    """Noise and loss hang on the stamp, not on how many pictures were drawn."""
    def stamps_and_pictures(start):
        sensor = camera(update_rate=100.0, effects={"noise_stddev": 9.0, "drop_probability": 0.3})
        sensor.reset(start * MS)
        got = frames(sensor, 500 - start, start=start * MS)
        return {frame.stamp_ns: frame.image.tobytes() for _, frame in got}

    all_of_it, late = stamps_and_pictures(0), stamps_and_pictures(247)
    assert len(late) > 10
    assert late.items() <= all_of_it.items()


@pytest.mark.parametrize(("level", "exposure", "gain"), [
    (60, 1.0, 0.5), (110, 1.3, 1.5), (250, 1.0, 0.5)])
def test_noise_is_that_of_a_characterised_sensor(level, exposure, gain):
    """EMVA 1288: variance K (K e + K read^2) + 1/12 of e electrons, up to the full well."""
    K, well, read, dark, time = 0.04, 4000.0, 9.0, 50_000.0, 0.002
    effects = Effects(
        sensor=SensorModel(gain=K, full_well=well, read_noise=read, dark_current=dark),
        exposure=exposure, exposure_time=time, gain=gain,
    )  # fmt: skip
    grey = np.full((240, 320, 3), level, np.uint8)
    out = EffectChain(effects, grey.shape, 3).apply(grey, 5)
    electrons = min(level * exposure / K + dark * time, well)
    assert out.mean() == pytest.approx(gain * K * electrons, abs=0.1)
    variance = (gain * K) ** 2 * (electrons + read**2) + 1 / 12
    assert out.var() == pytest.approx(variance, rel=0.02)


@pytest.mark.parametrize(("level", "exposure", "gain", "shot", "stddev", "mean"), [
    (40, 1.25, 2.0, 0.25, 3.0, 7.0), (40, 1.25, 2.0, 0.25, 0.0, -6.0),
    (120, 0.5, 0.5, 0.5, 4.0, 0.0), (200, 2.0, 0.4, 0.25, 2.0, -6.0),  # full wells
    (40, 1.25, 2.0, 0.0, 3.0, 7.0), (120, 0.5, 0.5, 0.0, 4.0, -6.0),
])
def test_gain_amplifies_light_and_not_reading_noise(level, exposure, gain, shot, stddev, mean):
    effects = Effects(shot_noise=shot, exposure=exposure, gain=gain, noise_stddev=stddev,
                      noise_mean=mean)
    grey = np.full((240, 320, 3), level, np.uint8)
    light = min(level * exposure, 255.0)
    out = EffectChain(effects, grey.shape, 3).apply(grey, 5)
    assert out.mean() == pytest.approx(gain * light + mean, abs=0.15)
    rounding = 1 / 12 if shot else 0.0  # what is added without shot noise is less by it
    assert out.var() == pytest.approx(gain**2 * shot * light + stddev**2 + rounding, rel=0.02)


def test_exposure_gain_and_vignetting():
    grey = np.full((240, 320, 3), 100, np.uint8)

    def after(image, **effects):
        return EffectChain(Effects(**effects), image.shape, 0).apply(image, 0)

    assert (after(grey, exposure=0.5, gain=3.0) == 150).all()
    out = after(grey, vignetting=0.4)
    assert out[120, 160, 0] == 100
    assert out[0, 0, 0] == pytest.approx(60, abs=1)
    assert (out == out[::-1]).all() and (out == out[:, ::-1]).all()
    assert (after(grey[..., 0], vignetting=0.4) == out[..., 0]).all()
    assert after(grey) is grey
    for shot in (0.0, 0.25):
        assert not after(np.zeros_like(grey), exposure=2.0, gain=3.0, shot_noise=shot).any()
    # Gain after a full well, and no bands where the exposure is short.
    assert after(grey, exposure=4.0, gain=0.5, vignetting=0.1)[120, 160, 0] == 128
    assert after(grey, exposure=4.0, gain=1.2, vignetting=0.1)[120, 160, 0] == 255
    assert len(np.unique(after(grey, exposure=0.1, gain=10.0, vignetting=0.4))) > 35


def test_formats():
    rgb = np.zeros((4, 6, 3), np.uint8)
    rgb[:] = (10, 20, 30)
    assert read_out(rgb, "bgr8")[0, 0].tolist() == [30, 20, 10]
    assert find_shape("mono8", 4, 6) == (4, 6)
    assert read_out(rgb, "rgb16").shape == find_shape("rgb16", 4, 6) == (4, 6, 3)
    assert widen(rgb, "rgb8") is rgb
    assert widen(rgb, "mono16").dtype == np.uint16
    assert widen(np.full_like(rgb, 255), "rgb16").max() == 65535
    assert read_out(rgb, "bayer_rggb8")[:2, :2].tolist() == [[10, 20], [20, 30]]
    assert read_out(rgb, "bayer_grbg8")[:2, :2].tolist() == [[20, 10], [30, 20]]
    assert read_out(rgb, "bayer_gbrg8")[:2, :2].tolist() == [[20, 30], [10, 20]]
    assert read_out(rgb, "bayer_bggr8")[:2, :2].tolist() == [[30, 20], [20, 10]]


def test_a_black_picture_is_explained_once(bench, caplog):
    renderer = create_renderer("exact", bench.world, Lighting(background=(0.0, 0.0, 0.0, 1.0)))
    around = bench.box([0.1, 0.1, 0.1], [0.0, 0.0, 0.0])
    with caplog.at_level(logging.WARNING):
        frames(camera(renderer, update_rate=10.0), 500)
    assert len(caplog.records) == 1 and "sends a black image" in caplog.text
    assert f"inside {around.name}::link" in caplog.text
    caplog.clear()
    around.set_pose(Pose((-3.0, 0.0, 0.0)))
    bench.box([0.1, 1.0, 2.0], [1.0, -1.2, 0.0])  # on the right
    (_, frame), *_ = frames(camera(renderer, update_rate=10.0, width=32), 300)
    assert not frame.image[0, 0].any() and not caplog.records


@pytest.mark.parametrize("name", ["robot", "rig::robot"])
def test_a_camera_inside_a_body_says_so_unless_it_is_its_own(bench, caplog, name):
    box = Visual("visual", (0, 0, 0), (0, 0, 0), Geometry("box", size=(0.2, 0.2, 0.2)))
    robot = RobotDescription("robot", "link6", {"link6": Link("link6", None, (box,))}, {},
                             static=True, colours={})
    bench.world.spawn(robot, name)
    renderer = create_renderer("exact", bench.world, BRIGHT)
    frames(camera(renderer, update_rate=10.0), 300)
    assert len(caplog.records) == 1
    assert f"the camera is inside {name}::link6 and therefore does not see it" in caplog.text
    caplog.clear()
    frames(camera(renderer, update_rate=10.0, link="link6"), 300)
    assert not caplog.records


def test_depth_and_segmentation_come_with_the_frame(bench):
    table_and_target(bench)
    sensor = CameraSensor(CameraConfig.from_mapping({
        "horizontal_fov": 2.0, "near": 0.02, "depth": True, "segmentation": True,
        "format": "mono8"}), create_renderer("exact", bench.world, BRIGHT))
    frame = sensor.capture(DOWN, 40 * MS)
    assert frame.image.shape == (240, 320)
    for pixel, height, label in (((120, 160), 0.5905, 1), ((10, 10), 0.59, 0)):
        assert frame.depth[pixel] == pytest.approx(0.782 - height, abs=1e-5)
        assert frame.segmentation[pixel] == label


def test_a_triggered_camera_exposes_once_for_each_trigger(caplog):
    sensor = camera(trigger_topic="go", update_rate=30.0)
    assert not frames(sensor, 100)
    sensor.trigger(100 * MS, MS)
    sensor.trigger(100 * MS, MS)  # close together: two pictures, one a step
    assert [f.stamp_ns for _, f in frames(sensor, 50, start=100 * MS)] == [101 * MS, 102 * MS]
    sensor.trigger(150 * MS, MS)
    assert [(t, f.stamp_ns) for t, f in frames(sensor, 9, start=150 * MS)] == [(151 * MS,) * 2]
    sensor.trigger(159 * MS, MS)
    sensor.reset(0)  # time went back: what was asked for is over
    assert not frames(sensor, 300)
    assert not any("drops frames" in text for text in caplog.messages)
    streaming = camera(update_rate=30.0)
    streaming.trigger(0, MS)
    assert [f.stamp_ns for _, f in frames(streaming, 40)] == [33_333_333]
