"""Images of free cameras, compared with exact projection."""

from __future__ import annotations

import numpy as np
import pytest

from aras_visual_servo_base.poses import inverse, matrix_from_xyz_rpy
from aras_visual_servo_bench.targets.geometry import project
from aras_visual_servo_bench.targets.rendering import render_target
from aras_visual_servo_bench.targets.textures import TexturedTarget
from aras_visual_servo_camera.undistortion import CameraModel

K = (301.0, 0.0, 163.2, 0.0, 295.0, 114.7, 0.0, 0.0, 1.0)
CAMERAS = {
    "pinhole": CameraModel(320, 240, K),
    "plumb_bob": CameraModel(320, 240, K, (-0.2, 0.05, 0.001, -0.002, 0.0)),
    "equidistant": CameraModel(320, 240, K, (0.02, -0.01, 0.003, 0.0), "equidistant"),
}
# A black rectangle on white, 0.1 x 0.075 m, off the middle of a poster of 0.4 x 0.3 m.
SIZE = np.array([0.4, 0.3])
LOW, HIGH = np.array([-0.05, -0.0375]), np.array([0.05, 0.0375])
OFF = np.array([0.025, -0.01875])


def rectangle() -> TexturedTarget:
    pixels = np.full((768, 1024), 255, np.uint8)
    per = pixels.shape[1] / SIZE[0]
    x0, y0 = np.rint((LOW + OFF + SIZE / 2) * per).astype(int)
    x1, y1 = np.rint((HIGH + OFF + SIZE / 2) * per).astype(int)
    pixels[768 - y1:768 - y0, x0:x1] = 0
    return TexturedTarget(pixels, tuple(SIZE))


def centroid(outline: np.ndarray) -> np.ndarray:
    (x, y), (x2, y2) = outline.T, np.roll(outline, -1, axis=0).T
    cross = x * y2 - x2 * y
    return np.array([((x + x2) * cross).sum(), ((y + y2) * cross).sum()]) / (3 * cross.sum())


def dark_centroid(image: np.ndarray) -> np.ndarray:
    dark = 255.0 - image
    v, u = np.mgrid[:image.shape[0], :image.shape[1]]
    return np.array([(u * dark).sum(), (v * dark).sum()]) / dark.sum()


@pytest.mark.parametrize("name", CAMERAS)
def test_the_centroid_of_what_a_poster_shows_is_where_it_is_projected(name):
    camera, target = CAMERAS[name], rectangle()
    random, errors = np.random.default_rng(3), []
    side = np.linspace(0.0, 1.0, 33)[:-1]
    (x0, y0), (x1, y1) = LOW + OFF, HIGH + OFF
    corners = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
    rim = np.concatenate([a + side[:, None] * (b - a)
                          for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])
    rim = np.column_stack([rim, np.zeros(len(rim))])
    for _ in range(30):
        turn = random.uniform(-0.4, 0.4, 2)
        target_T_camera = matrix_from_xyz_rpy((0, 0, 0), (np.pi, 0, 0)) @ matrix_from_xyz_rpy(
            (0, 0, 0), (*turn, random.uniform(-np.pi, np.pi))) @ matrix_from_xyz_rpy(
            (*random.uniform(-0.03, 0.03, 2), -random.uniform(0.35, 0.6)), (0, 0, 0))
        outline = np.column_stack(camera.project(*project(rim, target_T_camera).T))
        assert (outline > 3).all() and (outline < (316, 236)).all()
        errors.append(
            dark_centroid(render_target(target, camera, target_T_camera)) - centroid(outline)
        )
    assert np.sqrt((np.array(errors) ** 2).sum(axis=1).mean()) < 0.004


def test_an_occluder_is_white_and_lies_on_the_picture():
    """What it covers of the rectangle is the half with y below its middle."""
    camera, target = CAMERAS["pinhole"], rectangle()
    above = matrix_from_xyz_rpy((0, 0, 0), (np.pi, 0, 0)) @ matrix_from_xyz_rpy(
        (0.01, 0.0, -0.45), (0, 0, 0.3)
    )
    cover = ((-0.1, -0.15), (0.15, float(OFF[1])))
    whole, half = render_target(target, camera, above), render_target(target, camera, above, cover)
    assert (half >= whole).all()
    assert (255.0 - half).sum() == pytest.approx(0.5 * (255.0 - whole).sum(), rel=0.02)
    there = inverse(above) @ [OFF[0], OFF[1] - 0.01, 0.0, 1.0]
    u, v = np.rint(np.array(camera.project(*(there[:2, None] / there[2]))).ravel()).astype(int)
    assert whole[v, u] == 0 and half[v, u] == 255


def test_a_poster_shows_nothing_from_behind():
    camera = CAMERAS["pinhole"]
    assert (
        render_target(rectangle(), camera, matrix_from_xyz_rpy((0, 0, -0.5), (0, 0, 0))) == 255
    ).all()
