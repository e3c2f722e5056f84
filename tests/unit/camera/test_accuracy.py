"""Images agree with CameraInfo and with geometry to a fraction of a pixel."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from scenes import bright_renderer, chessboard, looking, to_camera

from aras_sim_bridge.camera import CameraConfig, CameraSensor

LENSES = {
    "pinhole": dict(horizontal_fov=1.0),
    "off_centre": dict(camera_matrix=dict(fx=420, fy=430, cx=262.3, cy=161.8)),
    "plumb_bob": dict(
        camera_matrix=dict(fx=200.0, fy=201.0, cx=243.6, cy=190.7), distortion_model="plumb_bob",
        distortion_coefficients=[-0.3306, 0.117, 0.001, -0.002, 0.01]),
    "rational": dict(
        camera_matrix=dict(fx=200.0, fy=201.0, cx=243.6, cy=175.7),
        distortion_model="rational_polynomial",
        distortion_coefficients=[0.2, 0.05, 0.001, -0.002, 0.01, 0.3, 0.02, 0.0]),
    "equidistant": dict(lens="equidistant", horizontal_fov=np.pi),
    "kannala_brandt": dict(
        lens="equidistant", camera_matrix=dict(fx=150.0, fy=151.0, cx=238.8, cy=180.3),
        distortion_coefficients=[0.02, -0.01, 0.003, -0.0005]),
    "equidistant_220": dict(lens="equidistant", horizontal_fov=3.83),
    "stereographic": dict(lens="stereographic", horizontal_fov=3.0),
    "orthographic": dict(lens="orthographic", horizontal_fov=3.0),
}
PRESETS = Path(__file__).parents[3] / "src/aras_visual_servo_gazebo/config/cameras"


def opencv_projection(info, points):
    """Pixels (N, 2) of points in the optical frame, by OpenCV from CameraInfo's content."""
    zero, K, D = np.zeros(3), np.array(info.K), np.array(info.D)
    if info.model == "equidistant":
        return cv2.fisheye.projectPoints(points[:, None], zero, zero, K, D)[0][:, 0]
    return cv2.projectPoints(points, zero, zero, K, D)[0][:, 0]


def rms(errors):
    return np.sqrt((errors**2).sum(axis=1).mean())


# The noisy preset has the lens of the original one.
@pytest.mark.parametrize("lens", [
    *LENSES, *sorted({path.stem for path in PRESETS.glob("*.yaml")} - {"noisy"})])
def test_chessboard_corners_lie_where_camera_info_says(bench, lens):
    board, rng, errors = chessboard(bench), np.random.default_rng(1), []
    if lens in LENSES:
        values = {"width": 480, "height": 360, **LENSES[lens]}
    else:
        values = yaml.safe_load((PRESETS / f"{lens}.yaml").read_text())
    config = CameraConfig.from_mapping({**values, "near": 0.005, "far": 20.0})
    sensor = CameraSensor(config, bright_renderer(bench.world))
    size = np.array([config.width, config.height])
    away = 0.42 * config.K[0, 0] / config.width  # where the board fills a large part of the image
    for _ in range(2):
        eye = [*rng.uniform(-0.5, 0.5, 2) * away, away * rng.uniform(0.9, 1.3)]
        turn = rng.uniform(0, 2 * np.pi)
        T = looking(eye, [*rng.uniform(-0.2, 0.2, 2) * away, 0.0], (np.cos(turn), np.sin(turn), 0))
        points = to_camera(T, board)
        expected = opencv_projection(sensor.info, points)
        image = sensor.renderer.render(sensor.make_view(T @ np.linalg.inv(sensor.link_T_optical)))
        # The search starts up to a pixel away: without a board it would stay there.
        half = int(np.clip(np.linalg.norm(np.diff(expected, axis=0), axis=1).min() / 2.2, 2, 8))
        start = expected + np.random.default_rng(3).choice([-0.7, 0.7], expected.shape)
        start = np.clip(start, 0, size - 1).astype(np.float32).reshape(-1, 1, 2)
        found = cv2.cornerSubPix(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), start, (half, half),
                                 (-1, -1), (3, 100, 1e-4))[:, 0]
        inside = ((expected > 10) & (expected < size - 11)).all(axis=1) & (points[:, 2] > 0.01)
        errors.append((found - expected)[inside])
    errors = np.concatenate(errors)
    assert len(errors) > 30 and rms(errors) <= 0.1
    assert np.abs(errors.mean(axis=0)).max() < 0.04, "the whole image is shifted"
