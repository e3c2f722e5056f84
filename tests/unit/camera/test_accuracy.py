"""The picture agrees with CameraInfo and with geometry to a fraction of a pixel."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scenes import TARGET_CORNERS, chessboard, looking, table_and_target, to_camera

from aras_sim_bridge.camera import CameraConfig, CameraSensor
from aras_sim_bridge.rendering import View, create_renderer

SIZE = (480, 360)
LENSES = {
    "pinhole": dict(horizontal_fov=1.0),
    "off_centre": dict(camera_matrix=dict(fx=420, fy=430, cx=262.3, cy=161.8)),
    "plumb_bob": dict(
        camera_matrix=dict(fx=300.0, fy=301.0, cx=243.6, cy=190.7), distortion_model="plumb_bob",
        distortion_coefficients=[-0.3306, 0.117, 0.001, -0.002, 0.01]),
    "rational": dict(
        camera_matrix=dict(fx=300.0, fy=301.0, cx=243.6, cy=175.7),
        distortion_model="rational_polynomial",
        distortion_coefficients=[0.2, 0.05, 0.001, -0.002, 0.01, 0.3, 0.02, 0.0]),
    "equidistant": dict(lens="equidistant", horizontal_fov=np.pi),
    "kannala_brandt": dict(
        lens="equidistant", camera_matrix=dict(fx=150.0, fy=151.0, cx=238.8, cy=180.3),
        distortion_coefficients=[0.02, -0.01, 0.003, -0.0005]),
    "equidistant_220": dict(lens="equidistant", horizontal_fov=3.83),
    "stereographic": dict(lens="stereographic", horizontal_fov=3.0),
    "equisolid": dict(lens="equisolid", horizontal_fov=3.0),
    "orthographic": dict(lens="orthographic", horizontal_fov=3.0),
}


def opencv_projection(info, points):
    """Pixels (N, 2) of points in the optical frame, by OpenCV from CameraInfo's content."""
    zero, K, D = np.zeros(3), np.array(info.K), np.array(info.D)
    if info.model == "equidistant":
        return cv2.fisheye.projectPoints(points[:, None], zero, zero, K, D)[0][:, 0]
    return cv2.projectPoints(points, zero, zero, K, D)[0][:, 0]


def measured(image, guess):
    """Corners (N, 2) found near a guess."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    half = int(np.clip(np.linalg.norm(np.diff(guess, axis=0), axis=1).min() / 2.2, 2, 8))
    start = np.clip(guess, 0, np.array(SIZE) - 1).astype(np.float32).reshape(-1, 1, 2).copy()
    return cv2.cornerSubPix(grey, start, (half, half), (-1, -1), (3, 100, 1e-4))[:, 0]


def well_inside(points, pixels):
    """Which corners are in front of the camera and away from the picture's border."""
    return ((points[:, 2] > 0.01) & (pixels > 10).all(axis=1)
            & (pixels < np.array(SIZE) - 11).all(axis=1))


def poses(config, count, seed=1, aside=0.5):
    """Poses from which a board of 0.28 m fills much of the picture."""
    rng = np.random.default_rng(seed)
    away = 0.42 * config.K[0, 0] / config.width
    for _ in range(count):
        eye = [*rng.uniform(-aside, aside, 2) * away, away * rng.uniform(0.9, 1.3)]
        turn = rng.uniform(0, 2 * np.pi)
        yield looking(eye, [*rng.uniform(-0.2, 0.2, 2) * away, 0.0],
                      (np.cos(turn), np.sin(turn), 0))


def residuals(sensor, board, count):
    out = []
    for T in poses(sensor.config, count):
        points = to_camera(T, board)
        expected = opencv_projection(sensor.info, points)
        view = View(*SIZE, T, sensor.config.K, 0.005, 20.0, sensor._lens)
        found = measured(sensor.renderer.render(view), expected)
        inside = well_inside(points, expected)
        out.append((found - expected)[inside])
    out = np.concatenate(out)
    assert len(out) > 15 * count
    return out


def rms(errors):
    return np.sqrt((errors**2).sum(axis=1).mean())


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("renderer, count", [("opengl", 6), ("tiny", 1)])
def test_chessboard_corners_lie_where_camera_info_says(bench, lens, renderer, count):
    board = chessboard(bench)
    config = CameraConfig.from_mapping({"width": SIZE[0], "height": SIZE[1], **LENSES[lens]})
    sensor = CameraSensor(config, create_renderer(renderer, bench.client, bench.materials))
    errors = residuals(sensor, board, count)
    assert rms(errors) <= 0.1
    assert np.abs(errors.mean(axis=0)).max() < 0.04, "the whole picture is shifted"


@pytest.mark.parametrize("lens", ["plumb_bob", "rational", "kannala_brandt"])
def test_each_coefficient_matters(bench, lens):
    board = chessboard(bench)
    config = CameraConfig.from_mapping({"width": SIZE[0], "height": SIZE[1], **LENSES[lens]})
    sensor = CameraSensor(config, create_renderer("opengl", bench.client, bench.materials))
    views = []
    for T in poses(config, 4):
        points = to_camera(T, board)
        view = View(*SIZE, T, config.K, 0.005, 20.0, sensor._lens)
        expected = opencv_projection(sensor.info, points)
        inside = well_inside(points, expected)
        views.append((points[inside], measured(sensor.renderer.render(view), expected)[inside]))

    def residual(info):
        return rms(np.concatenate([opencv_projection(info, p) - found for p, found in views]))

    right = residual(sensor.info)
    for k in range(len(sensor.info.D)):
        for change in (-0.01, 0.01):
            D = list(sensor.info.D)
            D[k] += change
            assert residual(replace(sensor.info, D=tuple(D))) > right, f"coefficient {k}"
    for (row, column), change in {(0, 0): 1.0, (1, 1): 1.0, (0, 2): 0.2, (1, 2): 0.2}.items():
        for sign in (-1, 1):
            K = np.array(sensor.info.K)
            K[row, column] += sign * change
            assert residual(replace(sensor.info, K=K)) > right


def target_errors(renderer, count, seed=0):
    """Centroid errors (N, 2), px, and area errors (N,), relative, of the black target."""
    K = CameraConfig(horizontal_fov=2.0).K
    rng = np.random.default_rng(seed)
    centroids, areas = [], []
    for _ in range(count):
        eye = [*rng.uniform(-0.06, 0.06, 2), 0.59 + rng.uniform(0.15, 0.3)]
        turn = rng.uniform(0, 2 * np.pi)
        T = looking(eye, [*rng.uniform(-0.03, 0.03, 2), 0.59], (np.cos(turn), np.sin(turn), 0))
        p = to_camera(T, TARGET_CORNERS)
        outline = cv2.convexHull((p[:, :2] / p[:, 2:] @ K[:2, :2] + K[:2, 2]).astype(np.float32))
        outline = outline[:, 0].astype(float)
        low, high = outline.min(axis=0).astype(int) - 3, outline.max(axis=0).astype(int) + 4
        image = renderer.render(View(320, 240, T, K, 0.02, 100.0))
        dark = (255.0 - image[low[1]:high[1], low[0]:high[0], 0]) / 255.0
        v, u = np.mgrid[low[1]:high[1], low[0]:high[0]]
        (x, y), (x2, y2) = outline.T, np.roll(outline, -1, axis=0).T
        cross = x * y2 - x2 * y
        area = cross.sum() / 2
        centre = np.array([((x + x2) * cross).sum(), ((y + y2) * cross).sum()]) / (6 * area)
        mass = dark.sum()
        centroids.append([(dark * u).sum() / mass - centre[0], (dark * v).sum() / mass - centre[1]])
        areas.append(mass / abs(area) - 1.0)
    return np.array(centroids), np.array(areas)


def test_centroid_and_area_of_the_target(bench):
    table_and_target(bench)
    centroids, areas = target_errors(
        create_renderer("opengl", bench.client, bench.materials), 150
    )
    assert rms(centroids) <= 0.015
    assert np.sqrt((areas**2).mean()) <= 0.001
    assert abs(areas.mean()) <= 0.0003


def test_target_by_tiny(bench):
    table_and_target(bench)
    centroids, _ = target_errors(create_renderer("tiny", bench.client, bench.materials), 10)
    assert rms(centroids) <= 0.06


def calibration_views(sensor, board, count):
    object_points, image_points = [], []
    for T in poses(sensor.config, 20 * count, seed=5, aside=1.0):
        points = to_camera(T, board)
        expected = opencv_projection(sensor.info, points)
        if not well_inside(points, expected).all():
            continue
        view = View(*SIZE, T, sensor.config.K, 0.005, 20.0, sensor._lens)
        # All in one plane z = 0: that is how OpenCV knows a planar target.
        object_points.append((board * [1, 1, 0]).astype(np.float32))
        image_points.append(measured(sensor.renderer.render(view), expected).astype(np.float32))
        if len(image_points) == count:
            break
    assert len(image_points) == count
    return object_points, image_points


@pytest.mark.parametrize("lens", ["pinhole", "plumb_bob", "kannala_brandt"])
def test_calibration_returns_what_is_published(bench, lens):
    board = chessboard(bench, 10, 8, 0.03)
    config = CameraConfig.from_mapping({"width": SIZE[0], "height": SIZE[1], **LENSES[lens]})
    sensor = CameraSensor(config, create_renderer("opengl", bench.client, bench.materials))
    seen, found = calibration_views(sensor, board, 20)
    if sensor.info.model == "equidistant":
        names = ("CALIB_RECOMPUTE_EXTRINSIC", "CALIB_FIX_SKEW", "CALIB_USE_INTRINSIC_GUESS")
        flags = sum(getattr(cv2.fisheye, "fisheye_" + n, getattr(cv2, n, 0)) for n in names)
        guess = np.array([[140.0, 0, 240], [0, 140, 180], [0, 0, 1]])
        K = cv2.fisheye.calibrate(
            [s.reshape(1, -1, 3).astype(float) for s in seen],
            [f.reshape(1, -1, 2).astype(float) for f in found], SIZE, guess, np.zeros((4, 1)),
            flags=flags)[1]
    else:
        K = cv2.calibrateCamera(seen, found, SIZE, None, None)[1]
    truth = sensor.info.K
    np.testing.assert_allclose([K[0, 0], K[1, 1]], [truth[0, 0], truth[1, 1]], rtol=0.002)
    np.testing.assert_allclose(K[:2, 2], truth[:2, 2], atol=0.3)
