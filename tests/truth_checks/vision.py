"""Camera images, compared with OpenCV, ray casting and the configured noise."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from scenes import Bench, link_pose, looking, to_camera

from aras_sim_bridge.camera import CameraConfig, CameraSensor
from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.rendering import Lighting, View, create_renderer
from aras_sim_bridge.world import Pose, Twist

from .check import Row, check
from .robots import SOURCES
from .sensor import WALL, black_plate, weightless
from .wall import SIDE, TEXELS, aslant, blocks, errors, wall

_PRESETS = SOURCES / "aras_visual_servo_gazebo" / "config" / "cameras"
_SIZE = {"width": 480, "height": 360}
_LENSES = {
    "pinhole": {**_SIZE, "horizontal_fov": 1.0},
    "plumb_bob": {
        **_SIZE, "camera_matrix": {"fx": 300.0, "fy": 301.0, "cx": 243.6, "cy": 190.7},
        "distortion_model": "plumb_bob",
        "distortion_coefficients": [-0.3306, 0.117, 0.001, -0.002, 0.01]},
    "rational_polynomial": {
        **_SIZE, "camera_matrix": {"fx": 300.0, "fy": 301.0, "cx": 243.6, "cy": 175.7},
        "distortion_model": "rational_polynomial",
        "distortion_coefficients": [0.2, 0.05, 0.001, -0.002, 0.01, 0.3, 0.02, 0.0]},
    "equidistant": {
        **_SIZE, "lens": "equidistant",
        "camera_matrix": {"fx": 150.0, "fy": 151.0, "cx": 238.8, "cy": 180.3},
        "distortion_coefficients": [0.02, -0.01, 0.003, -0.0005]},
    "stereographic": {**_SIZE, "lens": "stereographic", "horizontal_fov": 3.0},
    "equisolid": {**_SIZE, "lens": "equisolid", "horizontal_fov": 3.0},
    "orthographic": {**_SIZE, "lens": "orthographic", "horizontal_fov": 3.0},
}
_EXACT = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-12)
_EYE = looking((0.06, -0.04, 0.5), (0.02, 0.01, 0.0), (0.0, 1.0, 0.0))


def _configs(**more: Any) -> Iterator[tuple[str, CameraConfig]]:
    """Yield all lenses and presets, without effects, with more settings."""
    lenses = _LENSES | {f"preset {path.stem}": yaml.safe_load(path.read_text())
                        for path in sorted(_PRESETS.glob("*.yaml"))}  # fmt: skip
    for name, values in lenses.items():
        plain = {key: value for key, value in values.items() if key != "effects"}
        yield name, CameraConfig.from_mapping({**plain, **more})


def _shot(config: CameraConfig, bench: Bench) -> tuple[CameraSensor, np.ndarray, np.ndarray | None,
                                                       np.ndarray | None]:
    """Return the sensor, and grey values, depth and labels of its image from _EYE."""
    sensor = CameraSensor(config, create_renderer("exact", bench.world))
    frame = sensor.capture(link_pose(_EYE), sensor.due_ns)
    image = frame.image if frame.image.ndim == 2 else frame.image[..., 0]
    return sensor, image.astype(float), frame.depth, frame.segmentation


def _lens(sensor: CameraSensor) -> tuple[Any, np.ndarray, np.ndarray]:
    """OpenCV's module for a published CameraInfo, K, and D."""
    info = sensor.info
    return (cv2.fisheye if info.model == "equidistant" else cv2, np.array(info.K, float),
            np.array(info.D, float))  # fmt: skip


def _pixels(sensor: CameraSensor, points: np.ndarray) -> np.ndarray:
    """Project points of the world to pixels (N, 2), by OpenCV with the published CameraInfo."""
    (lens, K, D), zero = _lens(sensor), np.zeros(3)
    return lens.projectPoints(to_camera(_EYE, points)[:, None], zero, zero, K, D)[0][:, 0]


def _centroid(outline: np.ndarray) -> np.ndarray:
    x, y = outline.T
    nx, ny = np.roll(outline, -1, axis=0).T
    part = x * ny - nx * y
    return np.array([((x + nx) * part).sum(), ((y + ny) * part).sum()]) / (3 * part.sum())


@check("OpenCV")
def projection() -> Iterator[Row]:
    """Compare centroids of 25 black squares on white with outlines projected by OpenCV."""
    half, side = 0.012, np.linspace(-1.0, 1.0, 41)[:-1]
    outline = half * np.concatenate([
        np.stack([side, -np.ones(40)], 1), np.stack([np.ones(40), side], 1),
        np.stack([-side, np.ones(40)], 1), np.stack([-np.ones(40), -side], 1)])
    for name, config in _configs():
        with closing(Bench()) as bench:
            bench.box([5.0, 5.0, 0.05], [0, 0, -0.05])
            spots = [(x, y) for x in np.linspace(-0.16, 0.16, 5)
                     for y in np.linspace(-0.12, 0.12, 5)]
            for x, y in spots:
                bench.box([half, half, 1e-5], [x, y, 0.0], "Gazebo/Black")
            sensor, image, _, _ = _shot(config, bench)
        errors = []
        for x, y in spots:
            expected = _pixels(sensor, np.column_stack([outline + (x, y), np.full(160, 1e-5)]))
            low = np.floor(expected.min(axis=0)).astype(int) - 2
            high = np.ceil(expected.max(axis=0)).astype(int) + 3
            if (low < 2).any() or (high > np.array(image.shape[::-1]) - 2).any():
                continue
            window = image[low[1] : high[1], low[0] : high[0]]
            dark = window.max() - window
            rows, columns = np.mgrid[low[1] : high[1], low[0] : high[0]]
            found = np.array([(columns * dark).sum(), (rows * dark).sum()]) / dark.sum()
            errors.append(found - _centroid(expected))
        if len(errors) < 5:
            raise RuntimeError(f"{name}: only {len(errors)} squares are seen")
        rms = float(np.sqrt((np.square(errors)).sum(axis=1).mean()))
        yield Row(f"{name}, {len(errors)} squares", "projection by CameraInfo", rms, 0.02, "px RMS")


def _rays(sensor: CameraSensor) -> np.ndarray:
    """Return ray directions (H, W, 3) with z = 1 from OpenCV; NaN beyond 76° from the axis."""
    (lens, K, D), config = _lens(sensor), sensor.config
    grid = np.stack(np.meshgrid(np.arange(config.width), np.arange(config.height)), -1)
    flat = lens.undistortPoints(grid.reshape(-1, 1, 2).astype(float), K, D, criteria=_EXACT)
    flat = flat.reshape(config.height, config.width, 2)
    rays = np.concatenate([flat, np.ones((*flat.shape[:2], 1))], axis=-1)
    again = lens.projectPoints(rays.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), K, D)[0]
    off = np.abs(again.reshape(*grid.shape) - grid).max(axis=-1)
    rays[(off > 1e-3) | (np.hypot(*np.moveaxis(flat, -1, 0)) > 4.0)] = np.nan
    return rays


@check("ray casting")
def depth_and_labels() -> Iterator[Row]:
    """Compare images of a box and a floor with the intersections of rays from OpenCV."""
    top, half = 0.12, np.array([0.09, 0.06])
    for name, config in _configs(depth=True, segmentation=True):
        with closing(Bench()) as bench:
            floor = bench.box([5.0, 5.0, 0.05], [0, 0, -0.05])
            box = bench.box([*half, top / 2], [0, 0, top / 2], "Gazebo/Red")
            sensor, _, depth, labels = _shot(config, bench)
        rays = _rays(sensor)
        turn, eye = _EYE[:3, :3], _EYE[:3, 3]
        world = rays @ turn.T
        with np.errstate(all="ignore"):
            far = -eye[2] / world[..., 2]
            low = (np.array([*-half, 0.0]) - eye) / world
            high = (np.array([*half, top]) - eye) / world
            enter = np.minimum(low, high).max(axis=-1)
            leave = np.maximum(low, high).min(axis=-1)
        hit = (enter < leave) & (enter > 0)
        expected = np.where(hit, enter, far)  # rays have z = 1, so this is along the axis
        usable = np.isfinite(expected) & (expected > 0)
        usable &= expected * np.linalg.norm(rays, axis=-1) < 1.0  # m; the floor is 0.5 m away
        # Pixels at the outline of the box show both surfaces.
        edge = cv2.morphologyEx(hit.astype(np.uint8), cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8))
        usable &= edge == 0
        if usable.sum() < 5000:
            raise RuntimeError(f"{name}: only {usable.sum()} pixels")
        if sensor.info.model == "equidistant":
            expected = expected * np.linalg.norm(rays, axis=-1)  # wide-angle depth is distance
        error = 1e3 * (depth - expected)[usable]
        yield Row(f"{name}, depth", "depth of the nearest plane",
                  float(np.sqrt((error**2).mean())), 0.2, "mm RMS")
        wanted = np.where(hit, box.body_id, floor.body_id)[usable]
        wrong = (labels[usable] & 0xFFFFFF) != wanted
        yield Row(f"{name}, labels", "label of the nearest body", float(wrong.mean()), 0.0,
                  "of pixels")


@check("covered area")
def thin_objects() -> Iterator[Row]:
    """Compare the darkness of a black wire on white, 24 px long, with its area."""
    focal, long = 100.0, 24.0  # px, from 1 m above
    K = np.array([[focal, 0, 23.5], [0, focal, 19.5], [0, 0, 1.0]])
    places = np.random.default_rng(5).uniform(-0.5, 0.5, (50, 2)) / focal
    for wide in (0.1, 0.3, 0.5, 1.0, 2.0):
        with closing(Bench()) as bench:
            bench.box([1.5, 1.5, 0.05], [0, 0, -0.06])
            bench.box([long / focal / 2, wide / focal / 2, 1e-6], [0, 0, -1e-6], "Gazebo/Black")
            renderer = create_renderer("exact", bench.world, Lighting(ambient=1.0, diffuse=0.0))
            worst = 0.0
            for n in range(12):
                turn = n * (np.pi / 12 + 0.011)
                for x, y in places:
                    eye = looking([x, y, 1.0], [x, y, 0.0], (np.sin(turn), np.cos(turn), 0.0))
                    picture = renderer.render(View(48, 40, eye, K))[..., 0]
                    area = (1.0 - picture / 255.0).sum()
                    worst = max(worst, abs(area / (long * wide) - 1.0))
        yield Row(f"wire of {wide:g} px, 12 angles, 50 positions", "its width", worst, 0.02)


@check("2 304 samples per pixel")
def oblique_textures() -> Iterator[Row]:
    """Compare a checkered wall (grey levels 85 and 171, squares of 8 texels) with its mean."""
    pixels = blocks(8)
    views = {"perpendicular": 0.0, "60° oblique": 60.0, "80° oblique": 80.0, "87° oblique": 87.0}
    bounds = {"perpendicular": 1.6, "60° oblique": 2.0, "80° oblique": 2.0, "87° oblique": 4.0}
    K = np.array([[300.0, 0.0, 161.3], [0.0, 310.0, 117.2], [0.0, 0.0, 1.0]])
    bench = Bench()
    with tempfile.TemporaryDirectory() as folder:
        try:
            wall(bench, Path(folder), pixels)
            renderer = create_renderer("exact", bench.world, Lighting(ambient=1.0, diffuse=0.0))
            for name, angle in views.items():
                worst = bias = 0.0
                # Tilts about both axes in both directions, and about a diagonal.
                for turn in (0.0, np.pi / 2, np.pi, -np.pi / 2, 0.7):
                    view = View(320, 240, aslant(np.radians(angle), turn, turn, 2.5), K)
                    off = errors(pixels, view, renderer.render(view))
                    worst = max(worst, float(np.sqrt((off**2).mean())))
                    bias = max(bias, float(abs(off.mean())))
                yield Row(f"{name}, 5 directions", "mean over the pixel", worst, bounds[name],
                          "grey levels RMS")
                yield Row(f"{name}, mean of the image", "unchanged", bias, 0.5, "grey levels")
        finally:
            bench.close()


@check("the same image without a sun")
def edges_in_the_sun() -> Iterator[Row]:
    """Compare area and position of a dark square on a bright wall in sun and ambient light."""
    pixels = np.full((TEXELS, TEXELS), 255, np.uint8)
    pixels[150:340, 170:380] = 40
    margin = SIDE * (np.array([[110, 100], [440, 100], [440, 390], [110, 390]]) / TEXELS - 0.5)
    margin[:, 1] *= -1.0  # the first row of the image is at +y
    K = np.array([[300.0, 0.0, 161.3], [0.0, 310.0, 117.2], [0.0, 0.0, 1.0]])
    views = {"perpendicular": 0.0, "40° oblique": 40.0, "75° oblique": 75.0}
    bench = Bench()
    with tempfile.TemporaryDirectory() as folder:
        try:
            wall(bench, Path(folder), pixels)
            sunny = create_renderer("exact", bench.world)
            even = create_renderer("exact", bench.world, Lighting(ambient=1.0, diffuse=0.0))
            for name, angle in views.items():
                worst = 0.0
                for turn in (0.0, 0.4, 1.9, -2.3):
                    view = View(320, 240, aslant(np.radians(angle), turn, turn, 2.9), K)
                    # The square with a margin, which is completely on the wall.
                    seen = to_camera(view.world_T_optical, np.column_stack([margin, np.zeros(4)]))
                    seen = seen @ K.T
                    wanted = cv2.fillConvexPoly(np.zeros((240, 320), np.uint8), np.rint(
                        seen[:, :2] / seen[:, 2:]).astype(np.int32), 1)
                    found = []
                    for renderer in (sunny, even):
                        picture = renderer.render(view)[..., 0].astype(float)
                        bright, least = picture[wanted > 0].max(), picture[wanted > 0].min()
                        dark = wanted * (bright - picture) / (bright - least)
                        rows, columns = np.indices(dark.shape)
                        found.append([np.sqrt(dark.sum()), (columns * dark).sum() / dark.sum(),
                                      (rows * dark).sum() / dark.sum()])
                    worst = max(worst, float(np.abs(np.subtract(*found)).max()))
                yield Row(f"{name}, side and middle, 4 directions", "equal", worst, 0.01, "px")
        finally:
            bench.close()


_WATCH = """<robot name="watch"><link name="world"/><link name="eye"/>
<joint name="j" type="fixed"><parent link="world"/><child link="eye"/></joint>
<gazebo reference="eye"><sensor type="camera" name="eye"><update_rate>30</update_rate><camera>
<horizontal_fov>0.9</horizontal_fov><image><width>640</width><height>160</height></image>
<clip><near>0.02</near><far>10</far></clip></camera></sensor></gazebo></robot>"""


@check("a body of known speed", quick=True)
def exposure_instants() -> Iterator[Row]:
    """Compute the exposure instant from the image position of a square that moves at 1 m/s."""
    with closing(weightless()) as simulation:
        simulation.spawn(WALL, "wall")
        mover = simulation.spawn(black_plate(0.05, 0.05), "mover", Pose((-0.25, 0.0, 0.0)))
        # The camera looks down, along +x of its link, with its rows parallel to the motion.
        simulation.spawn(parse_urdf(_WATCH), "watch",
                         Pose.from_rpy((0.0, 0.0, 0.6), (np.pi / 2, np.pi / 2, 0.0)))
        camera = simulation.cameras[0]
        frames = []
        camera.on_frame = frames.append
        camera.enabled = True
        mover.set_twist(Twist((1.0, 0.0, 0.0)))
        for _ in range(500):
            simulation.step()
    late = []
    for frame in frames:
        image = frame.image[..., 0].astype(float)
        dark = image.max() - image
        column = (dark.sum(axis=0) * np.arange(image.shape[1])).sum() / dark.sum()
        K = camera.sensor.info.K
        where = abs((column - K[0][2]) / K[0][0] * 0.6)  # m; the camera is at a height of 0.6 m
        stamp = frame.stamp_ns * 1e-9
        late.append(where - abs(stamp - 0.25))
    late = np.array(late)
    if len(late) < 10:
        raise RuntimeError(f"only {len(late)} pictures")
    yield Row(f"{len(frames)} images", "at the stamp", 1e6 * float(np.abs(late).max()), 20.0,
              "µs")


@check("the normal distribution")
def noise() -> Iterator[Row]:
    """Compare noise of 5 grey levels in 100 images of a grey wall with the normal distribution."""
    with closing(Bench()) as bench:
        bench.box([5.0, 5.0, 0.05], [0, 0, -0.05], "Gazebo/Grey")
        sensor = CameraSensor(CameraConfig.from_mapping({
            "width": 320, "height": 240, "horizontal_fov": 1.0, "format": "mono16", "seed": 7,
            "effects": {"noise_stddev": 5.0}}), create_renderer("exact", bench.world))
        clean = CameraSensor(CameraConfig.from_mapping({
            "width": 320, "height": 240, "horizontal_fov": 1.0, "format": "mono16"}),
            create_renderer("exact", bench.world))
        still = clean.capture(link_pose(_EYE), clean.due_ns).image.astype(float)
        pictures = [sensor.capture(link_pose(_EYE), sensor.due_ns).image - still
                    for _ in range(100)]
    values = np.array(pictures) / 257.0  # from mono16 to grey levels
    yield Row("standard deviation", "5 grey levels", float(abs(values.std() / 5.0 - 1.0)), 1e-3)
    yield Row("mean", "0", float(abs(values.mean())), 5e-3, "grey levels")
    kurtosis = float((values**4).mean() / values.var() ** 2 - 3.0)
    yield Row("excess kurtosis", "0", abs(kurtosis), 0.01)
    flat = values.reshape(len(values), -1)
    pairs = np.corrcoef(flat) - np.eye(len(flat))
    yield Row("correlation of two images", "0", float(np.abs(pairs).max()), 0.02)
