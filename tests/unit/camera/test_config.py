"""Camera settings: what they give, and what is refused and how."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from aras_sim_bridge.camera import CameraConfig
from aras_sim_bridge.camera.effects import Effects
from aras_sim_bridge.description import CameraDescription
from aras_sim_bridge.description.types import CameraPlugin, LensDescription, Noise
from aras_sim_bridge.errors import CameraError

PRESETS = Path(__file__).parents[3] / "src/aras_visual_servo_gazebo/config/cameras"


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
    info = config.intrinsics()
    assert info.K[0, 0] == info.K[1, 1] == pytest.approx(160 / np.tan(1.0))
    assert (info.K[0, 2], info.K[1, 2]) == (159.5, 119.5)
    assert info.model == "plumb_bob"
    assert info.D == (0.0,) * 5
    assert info.P[0, 3] == pytest.approx(-info.K[0, 0] * 0.07)
    assert config.encoding == "rgb8"
    assert (config.frame_name, config.camera_name) == ("camera_link", "labrob/camera")


def test_legacy_camera_info_is_gazebos():
    info = CameraConfig.from_description(description(), {"legacy_camera_info": True}).intrinsics()
    assert (info.K[0, 2], info.K[1, 2]) == (160.5, 120.5)
    assert info.K[0, 0] == pytest.approx(160 / np.tan(1.0))
    told = description(dict(focal_length=200.0, cx=150.0, distortion=(0.1, 0.2, 0.3, 0.4, 0.5)))
    info = CameraConfig.from_description(told, {"legacy_camera_info": True}).intrinsics()
    assert info.K.ravel().tolist() == [200, 0, 150, 0, 200, 120.5, 0, 0, 1]
    assert (info.model, info.D) == ("plumb_bob", (0.1, 0.2, 0.4, 0.5, 0.3))
    auto = description(dict(auto_distortion=True, distortion=(9.0,) * 5),
                       distortion=(-0.1, 0.02, 0.0, 0.001, -0.002))
    info = CameraConfig.from_description(auto, {"legacy_camera_info": True}).intrinsics()
    assert info.D == (-0.1, 0.02, 0.001, -0.002, 0.0)


def test_sensor_tags_are_rendered():
    config = CameraConfig.from_description(description(
        distortion=(-0.1, 0.02, 0.0, 0.001, -0.002),
        noise=Noise("gaussian", mean=0.02, stddev=0.01),
    ))
    assert config.distortion_coefficients == (-0.1, 0.02, 0.001, -0.002, 0.0)
    assert config.effects.noise_stddev == pytest.approx(2.55)
    assert config.effects.noise_mean == pytest.approx(5.1)
    silent = CameraConfig.from_description(description(noise=Noise("none", 0.1, 0.1)))
    assert silent.effects == Effects()


def test_wide_angle_camera():
    lens = LensDescription("stereographic", cutoff_angle=1.5)
    config = CameraConfig.from_description(
        description(kind="wideanglecamera", horizontal_fov=3.0, lens=lens)
    )
    assert config.lens == "stereographic"
    assert config.cutoff_angle == 1.5
    assert config.intrinsics().model == "equidistant"
    unscaled = LensDescription("equidistant", scale_to_hfov=False)
    config = CameraConfig.from_description(description(kind="wideanglecamera", lens=unscaled))
    assert config.K[0].tolist() == [160.0, 0.0, 159.5]


@pytest.mark.parametrize("preset", sorted(PRESETS.glob("*.yaml")), ids=lambda p: p.stem)
def test_every_shipped_preset_is_valid(preset):
    overrides = yaml.safe_load(preset.read_text())
    config = CameraConfig.from_description(description(), overrides)
    corners = np.array([[0, 0], [config.width - 1, 0], [0, config.height - 1],
                        [config.width - 1, config.height - 1]])
    assert np.isfinite(config.model.unproject(corners)).all(), "a corner would be black"


@pytest.mark.parametrize("bad, says", [
    ({"horizontal_fov": 0.0}, "horizontal_fov 0.0"),
    ({"horizontal_fov": 3.2}, "take a fisheye lens"),
    ({"lens": "equidistant", "horizontal_fov": 4.0}, "reaches above 0 and below 3.84"),
    ({"width": 0}, "width is 0, must be >= 1 px"),
    ({"height": 2.5}, "height is 2.5, must be a whole number"),
    ({"format": "RGB888"}, "format 'RGB888' is not known; the nearest is 'R8G8B8'"),
    ({"lens": "fishy"}, "lens is 'fishy': known are pinhole"),
    ({"distortion_model": "brown"}, "distortion_model is 'brown': known are"),
    ({"distortion_coefficients": [1.0, 2.0]}, "takes 4 or 5"),
    ({"distortion_coefficients": [-0.8, 0.0, 0.0, 0.0, 0.0]}, "fold the picture over"),
    ({"distortion_model": "equidistant", "distortion_coefficients": [-0.5, 0, 0, 0],
      "horizontal_fov": 3.0}, "fold the picture over at"),
    ({"update_rate": 0.0}, "update_rate is 0.0, must be > 0 Hz"),
    ({"near": 1.0, "far": 0.5}, "0 < near < far"),
    ({"camera_matrix": {"fx": -1, "fy": 1, "cx": 0, "cy": 0}}, "focal lengths above 0"),
    ({"camera_matrix": {"fx": 1, "fy": 0, "cx": 0, "cy": 0}}, "focal lengths above 0"),
    ({"camera_matrix": {"fx": 1, "fy": 1, "cx": 0, "cy": float("nan")}},
     "camera_matrix.cy is nan, must be a finite number"),
    ({"camera_matrix": {"fx": 100, "fy": 100}},
     "camera_matrix.cx is missing, must be a finite number"),
    ({"witdh": 320}, "unknown key 'witdh': did you mean 'width'?"),
    ({"effects": {"noise": 5}}, "unknown key 'effects.noise'"),
    ({"effects": {"noise_stddev": -1}}, "effects.noise_stddev is -1.0, must be >= 0"),
    ({"effects": {"exposure_time": 0.1}}, "shorter than the period"),
    ({"update_rate": "fast"}, "update_rate is 'fast', must be a finite number"),
    ({"latency": -1e-3}, "latency is -0.001, must be >= 0 s"),
    ({"width": 16000, "height": 16000}, "make width and height smaller"),
    ({"width": 16385, "height": 1}, "width is 16385, must be <= 16384 px"),
    ({"seed": -1}, "seed is -1, must be >= 0"),
    ({"hack_baseline": float("nan")}, "hack_baseline is nan, must be a finite number"),
    ({"cutoff_angle": 0.5}, "cutoff_angle is for wide-angle lenses"),
    ({"xyz": [0.0, float("nan"), 0.0]}, "xyz[1] is nan, must be a finite number"),
    ({"camera_name": "my camera"}, "camera_name 'my camera' is no name"),
    ({"image_topic": ""}, "image_topic ''"),
    ({"image_topic": "camera_info"}, "two different names"),
    ({"effects": {"noise_stddev": True}}, "noise_stddev is True, must be a finite number"),
    ({"effects": {"exposure_samples": True}}, "exposure_samples is True, must be a whole number"),
    ({"effects": {"exposure": 0.0}}, "effects.exposure is 0.0, must be > 0"),
    ({"effects": {"gain": 0.0}}, "effects.gain is 0.0, must be > 0"),
    ({"effects": {"drop_probability": 1.0}}, "no frame would ever come"),
])
def test_impossible_settings_are_refused_by_name(bad, says):
    with pytest.raises(CameraError, match="camera|effects") as caught:
        CameraConfig.from_description(description(), bad)
    assert says in str(caught.value)
