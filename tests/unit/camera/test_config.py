"""Camera settings: their effects, and error messages."""

from dataclasses import replace

import numpy as np
import pytest

from aras_sim_bridge.camera import CameraConfig
from aras_sim_bridge.camera.effects import Effects
from aras_sim_bridge.description import CameraDescription
from aras_sim_bridge.description.camera_types import CameraPlugin, LensDescription, PixelNoise
from aras_sim_bridge.errors import CameraError


def description(plugin=None, **changes):
    """The laboratory's camera of 2015, as its URDF has it."""
    plugin = CameraPlugin(**{"camera_name": "labrob/camera", "frame_name": "camera_link",
                             "hack_baseline": 0.07, **(plugin or {})})
    values = dict(name="camera1", link="camera_link", pose=((0.0,) * 3, (0.0,) * 3), kind="camera",
                  update_rate=30.0, horizontal_fov=2.0, width=320, height=240, format="R8G8B8",
                  near=0.02, far=300.0, plugin=plugin)
    return CameraDescription(**{**values, **changes})


def test_the_laboratory_camera_of_2015():
    config = CameraConfig.from_description(description())
    info = config.make_intrinsics()
    assert info.K[0, 0] == info.K[1, 1] == pytest.approx(160 / np.tan(1.0))
    assert (info.K[0, 2], info.K[1, 2]) == (159.5, 119.5)
    assert (info.width, info.height, info.model) == (320, 240, "plumb_bob")
    assert info.D == (0.0,) * 5
    # The baseline is that of a row of pixels.
    matrix = {"camera_matrix": {"fx": 210.0, "fy": 190.0, "cx": 150.0, "cy": 125.0}}
    assert CameraConfig.from_description(description(), matrix).make_intrinsics().P.tolist() == [
        [210.0, 0.0, 150.0, pytest.approx(-14.7)], [0.0, 190.0, 125.0, 0.0], [0.0, 0.0, 1.0, 0.0]]
    assert config.encoding == "rgb8"
    assert not any(np.asarray(part).flags.writeable for part in (info.K, info.P, info.R))
    assert not CameraConfig.from_mapping({}).make_intrinsics().P[:, 3].any()  # of one eye
    for told, rate in ((12.0, 12.0), (45.0, 30.0), (0.0, 30.0)):  # the plugin only leaves some out
        assert CameraConfig.from_description(description({"update_rate": told})).update_rate == rate
    assert (config.frame_name, config.camera_name) == ("camera_link", "labrob/camera")


def test_legacy_camera_info_is_gazebos():
    info = CameraConfig.from_description(
        description(), {"legacy_camera_info": True}
    ).make_intrinsics()
    assert (info.K[0, 2], info.K[1, 2]) == (160.5, 120.5)
    assert info.K[0, 0] == pytest.approx(160 / np.tan(1.0))
    told = description(dict(focal_length=200.0, cx=150.0, distortion=(0.1, 0.2, 0.3, 0.4, 0.5)))
    info = CameraConfig.from_description(told, {"legacy_camera_info": True}).make_intrinsics()
    assert info.K.ravel().tolist() == [200, 0, 150, 0, 200, 120.5, 0, 0, 1]
    assert (info.model, info.D) == ("plumb_bob", (0.1, 0.2, 0.4, 0.5, 0.3))
    auto = description(dict(auto_distortion=True, distortion=(9.0,) * 5),
                       distortion=(-0.1, 0.02, 0.0, 0.001, -0.002))
    info = CameraConfig.from_description(auto, {"legacy_camera_info": True}).make_intrinsics()
    assert info.D == (-0.1, 0.02, 0.001, -0.002, 0.0)
    straight = description(dict(auto_distortion=True, distortion=(9.0,) * 5))
    legacy = {"legacy_camera_info": True}
    assert CameraConfig.from_description(straight, legacy).make_intrinsics().D == (0.0,) * 5
    assert CameraConfig.from_mapping(legacy).make_intrinsics().D == (0.0,) * 5


def test_sensor_tags_are_rendered(caplog):
    tags = description(distortion=(-0.1, 0.02, 0.0, 0.001, -0.002),
                       noise=PixelNoise("gaussian", mean=0.02, stddev=0.01))
    config = CameraConfig.from_description(tags)
    assert not caplog.records
    CameraConfig.from_description(replace(tags, distortion_center=(0.5, 0.4)))
    assert "<center> (0.5, 0.4) of the <distortion> is ignored" in caplog.text
    assert config.distortion_coefficients == (-0.1, 0.02, 0.001, -0.002, 0.0)
    with pytest.raises(CameraError, match="'plumb_bob' does not fit lens 'equidistant'"):
        CameraConfig.from_description(replace(tags, kind="wideanglecamera"))
    assert config.effects.noise_stddev == pytest.approx(2.55)
    assert config.effects.noise_mean == pytest.approx(5.1)
    for mean, stddev in ((0.02, 0.0), (0.0, 0.01)):
        one = CameraConfig.from_description(
            replace(tags, noise=PixelNoise("gaussian", mean, stddev))
        )
        assert (one.effects.noise_mean, one.effects.noise_stddev) == (255 * mean, 255 * stddev)
    assert not config.depth
    assert CameraConfig.from_description(description(kind="depth")).depth
    silent = CameraConfig.from_description(description(noise=PixelNoise("none", 0.1, 0.1)))
    assert silent.effects == Effects()


def test_wide_angle_camera():
    lens = LensDescription("stereographic", cutoff_angle=1.5)
    config = CameraConfig.from_description(
        description(kind="wideanglecamera", horizontal_fov=3.0, lens=lens)
    )
    assert config.lens == "stereographic"
    assert config.cutoff_angle == 1.5
    assert CameraConfig.from_mapping({"lens": "equidistant", "cutoff_angle": 0.6}).projection
    assert config.make_intrinsics().model == "equidistant"
    unscaled = LensDescription("equidistant", scale_to_hfov=False)
    config = CameraConfig.from_description(
        description(kind="wideanglecamera", horizontal_fov=2.5, lens=unscaled))
    assert config.K[:2].tolist() == [[160.0, 0.0, 159.5], [0.0, 160.0, 119.5]]


@pytest.mark.parametrize("bad, says", [
    ({"horizontal_fov": 0.0}, "horizontal_fov is 0.0 rad"),
    ({"horizontal_fov": 3.2}, "use a fisheye lens"),
    ({"format": "RGB888"}, "format 'RGB888' is not known; the nearest is 'R8G8B8'"),
    ({"distortion_coefficients": [1.0, 2.0]}, "needs 4 or 5"),
    ({"distortion_coefficients": [-0.8, 0.0, 0.0, 0.0, 0.0]}, "distorted radius stops increasing"),
    ({"distortion_model": "equidistant", "distortion_coefficients": [-0.5, 0, 0, 0],
      "horizontal_fov": 3.0}, "the distorted radius stops increasing at"),
    ({"near": 1.0, "far": 0.5}, "0 < near < far"),
    ({"camera_matrix": {"fx": 0, "fy": 1, "cx": 0, "cy": 0}}, "focal lengths above 0"),
    ({"camera_matrix": {"fx": 100, "fy": 100}},
     "camera_matrix.cx is missing: give a finite number"),
    ({"effects": {"row_time": 0.005}},
     "row_time 0.005 s of 240 rows, which takes 1.2 s in all, must be shorter than the image pe"),
    ({"effects": {"exposure_time": 0.04}}, "exposure_time 0.04 s must be shorter than the image p"),
    ({"effects": {"exposure_time": 0.02, "row_time": 1e-4}}, "together 0.044 s"),
    ({"width": 16384, "height": 2049}, "reduce width and height"),
    ({"cutoff_angle": 0.5}, "cutoff_angle has no effect on the lens pinhole"),
    ({"lens": "equidistant", "cutoff_angle": 0.0}, "cutoff_angle is 0.0 rad"),
    ({"camera_name": "my camera"}, "camera_name 'my camera' is not a valid ROS name"),
    ({"image_topic": ""}, "image_topic ''"),
    ({"image_topic": "camera_info"}, "must be different names"),
    *(({"effects": {"sensor": {"gain": 0.01, "full_well": 1e4, **sensor}, **effects}}, says)
      for sensor, effects, says in (
          ({"gain": 0.0}, {}, "effects.sensor.gain is 0.0, must be > 0"),
          ({"gain": 1e-5}, {}, "is only 0.1 grey levels, so that images would be"),
          ({"read_noise": 2e4}, {}, "read_noise 20000 e- is not below"),
          ({"dark_current": 5.0}, {}, "exposure_time, which is 0"),
          ({}, {"shot_noise": 0.1}, "remove effects.shot_noise"))),
    ({"shake": {"xyz": [1e-3] * 3}}, "frequency"),
    ({"shake": {"frequency": 10.0, "bandwidth": 25.0}}, "bandwidth of 25 Hz around 10 Hz would"),
])
def test_impossible_settings_are_refused_by_name(bad, says):
    with pytest.raises(CameraError, match="camera|effects|shake") as caught:
        CameraConfig.from_description(description(), bad)
    assert says in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(("path", "fits", "beyond"), [
    ("width", 1, 0), ("width", 16384, 16385), ("height", 1, 0), ("height", 16384, 16385),
    ("update_rate", 1e-6, 0.0), ("near", 1e-9, 0.0), ("far", 0.101, 0.1), ("latency", 0.0, -1e-9),
    ("depth_topics.nearest", 0.0, -1e-9), ("depth_topics.nearest", 2.5, float("inf")),
    ("depth_topics.farthest", float("inf"), 0.0), ("depth_topics.farthest", 1e-9, float("nan")),
    ("seed", 0, -1),
    ("effects.noise_mean", -255.0, -255.1), ("effects.noise_mean", 255.0, 255.1),
    ("effects.noise_stddev", 0.0, -1e-9), ("effects.shot_noise", 0.0, -1e-9),
    ("effects.exposure", 1e-9, 0.0), ("effects.gain", 1e-9, 0.0),
    ("effects.vignetting", 0.0, -1e-9), ("effects.vignetting", 1.0, 1.001),
    ("effects.exposure_time", 0.0, -1e-9), ("effects.exposure_time", 0.0999, 0.1),
    ("effects.exposure_samples", 1, 0), ("effects.exposure_samples", 64, 65),
    ("effects.drop_probability", 0.0, -1e-9), ("effects.drop_probability", 0.999, 1.0),
    ("effects.row_time", 0.0, -1e-9), ("effects.rows_together", 1, 0),
    ("effects.auto_exposure.target", 1e-3, 0.0), ("effects.auto_exposure.target", 254.9, 255.0),
    ("effects.auto_exposure.speed", 1e-3, 0.0), ("effects.auto_exposure.speed", 1.0, 1.001),
    ("effects.auto_exposure.least", 1e-6, 0.0), ("effects.auto_exposure.least", 1.0, 1.001),
    ("effects.auto_exposure.most", 1.0, 0.999), ("effects.sensor.read_noise", 0.0, -1e-9),
    ("effects.sensor.read_noise", 8999.0, 9000.0), ("effects.sensor.dark_current", 0.0, -1e-9),
    ("effects.sensor.full_well", 50.0, 49.9), ("shake.frequency", 1e-3, 0.0),
    ("shake.xyz", [0.1, 0.0, 0.05], [0.101, 0.0, 0.05]), ("shake.xyz", [0.0] * 3, [0, -1e-9, 0]),
    ("shake.rpy", [0.5, 0.0, 0.2], [0.5, 0.501, 0.2]), ("shake.rpy", [0.0] * 3, [0, 0, -1e-9]),
    ("shake.bandwidth", 0.0, -1e-9), ("shake.bandwidth", 16.0, 16.001),
])
def test_settings_hold_up_to_their_bounds_and_no_further(path, fits, beyond):
    def make(value):
        *groups, name = path.split(".")
        beside = {"sensor": {"gain": 0.02, "full_well": 9000.0}, "shake": {"frequency": 8.0}}
        settings = {**beside.get(groups[-1] if groups else "", {}), name: value}
        for group in reversed(groups):
            settings = {group: settings}
        return CameraConfig.from_mapping({"update_rate": 10.0, **settings})

    assert make(fits).name == "camera"
    with pytest.raises(CameraError, match=path.split(".")[-1]):
        make(beyond)
    assert CameraConfig.from_mapping({"width": 16384, "height": 2048}).height == 2048


@pytest.mark.parametrize(("fits", "beyond"), [
    ((44, 1), (45, 1)), ((1, 44), (1, 45)), ((31, 31), (32, 32)),
])
def test_a_picture_may_reach_up_to_the_fold_and_no_further(fits, beyond):
    """The radius r - 0.8 r^3 grows up to 43.03 pixels."""
    lens = {"camera_matrix": {"fx": 100.0, "fy": 100.0, "cx": 0.0, "cy": 0.0},
            "distortion_coefficients": [-0.8, 0.0, 0.0, 0.0, 0.0]}  # fmt: skip
    CameraConfig.from_mapping({**lens, **dict(zip(("width", "height"), fits, strict=True))})
    with pytest.raises(CameraError, match="radius stops increasing inside the image"):
        CameraConfig.from_mapping({**lens, **dict(zip(("width", "height"), beyond, strict=True))})


@pytest.mark.parametrize(("lens", "reach"), [
    ("pinhole", 90.0), ("equidistant", 110.0), ("stereographic", 110.0), ("equisolid", 110.0),
    ("orthographic", 90.0),
])
def test_a_picture_may_reach_up_to_what_its_lens_sees(lens, reach):
    """Degrees from the axis."""
    widest = 2.0 * np.radians(reach) - (1e-9 if lens == "pinhole" else 0.0)
    CameraConfig.from_mapping({"lens": lens, "horizontal_fov": widest})
    with pytest.raises(CameraError, match=f"lens {lens} it must be above 0 and below"):
        CameraConfig.from_mapping({"lens": lens, "horizontal_fov": widest + 1e-6})
    if lens != "pinhole":
        CameraConfig.from_mapping({"lens": lens, "cutoff_angle": widest / 2.0})
        with pytest.raises(CameraError, match=f"lens {lens} it must be above 0 and at most"):
            CameraConfig.from_mapping({"lens": lens, "cutoff_angle": widest / 2.0 + 1e-6})
