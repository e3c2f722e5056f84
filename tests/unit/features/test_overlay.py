"""Overlay image for rviz: colour and position of each mark, to the pixel."""

from math import cos, sin

import cv2
import numpy as np
import pytest
from feature_cases import RECTANGLE, grey_image

from aras_visual_servo_camera import detection_pipeline
from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_camera.images import Image
from aras_visual_servo_camera.overlay import draw

CAMERA = CameraModel(320, 240, (200.0, 0, 150.0, 0, 190.0, 110.0, 0, 0, 1), (0.0,) * 5)
GREEN, RED, YELLOW, BLUE = (0, 220, 0), (230, 30, 30), (255, 210, 0), (60, 120, 255)
ANGLE = 0.6
CENTRE = np.array([0.1, 0.06])  # normalised; pixel (170, 121.4)


@pytest.fixture
def grey() -> np.ndarray:
    turn = np.array([[cos(ANGLE), -sin(ANGLE)], [sin(ANGLE), cos(ANGLE)]])
    return grey_image(RECTANGLE @ turn.T + CENTRE, CAMERA.pinhole)


def measured(grey: np.ndarray) -> detection_pipeline.TargetDetection:
    pipeline = detection_pipeline.DetectionPipeline(detection_pipeline.DetectionSettings())
    pipeline.set_camera(CAMERA)
    return pipeline.measure(Image(grey, "mono8"))


def in_colour(grey: np.ndarray) -> np.ndarray:
    return np.repeat(grey[..., None], 3, axis=2)


def places(picture: np.ndarray, colour: tuple[int, int, int]) -> np.ndarray:
    """(n, 2) column, row of the pixels of this colour, a fifth of their ground shining through."""
    return np.argwhere((np.abs(picture - np.array(colour)) <= 50).all(axis=2))[:, ::-1]


def test_contour_axis_and_desired_outline_are_drawn(grey):
    measurement, rgb = measured(grey), in_colour(grey)
    picture = draw(rgb, measurement)
    np.testing.assert_array_equal(rgb, in_colour(grey))  # the picture given stays as it is
    inside = cv2.erode(measurement.target.mask, cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3)))
    rim = (measurement.target.mask > 0) & (inside == 0)
    green = (picture == GREEN).all(axis=2)
    assert not green[~rim].any()  # one pixel wide, on the target
    assert green.sum() > 0.9 * rim.sum()  # the axis crosses it
    yellow = places(draw(in_colour(grey), measured(grey)), YELLOW)
    assert len(yellow) > 10  # the rest of it is blended with its ground
    x = (yellow[:, 0] - 150.0) / 200.0 - CENTRE[0]
    y = (yellow[:, 1] - 110.0) / 190.0 - CENTRE[1]
    along, across = cos(ANGLE) * x + sin(ANGLE) * y, cos(ANGLE) * y - sin(ANGLE) * x
    assert np.abs(across).max() < 1.0 / 190.0
    reach = 2.0 * np.sqrt((0.2**2 + 0.12**2) / 12.0)
    assert along.max() == pytest.approx(reach, abs=4.0 / 190.0)
    assert along.min() == pytest.approx(-reach, abs=4.0 / 190.0)
    desired = [(-0.5, -0.4), (-0.25, -0.4), (-0.25, -0.1), (-0.5, -0.1)]
    picture = draw(in_colour(grey), measured(grey), desired)
    blue = {tuple(place) for place in places(picture, BLUE).tolist()}
    box = {(u, v) for u in range(51, 100) for v in (34, 91)}
    box |= {(u, v) for v in range(35, 91) for u in (50, 100)}
    assert box <= blue <= box | {(u, v) for u in (50, 100) for v in (34, 91)}
    assert len(places(draw(in_colour(grey), measured(grey), desired[:2]), BLUE)) == 0


def test_cross_stands_on_the_centre_of_gravity() -> None:
    grey = np.full((240, 320), 255, np.uint8)
    grey[100:121, 180:221] = 0  # centre: column 200, row 110
    red = places(draw(in_colour(grey), measured(grey)), RED)
    upright, level = red[red[:, 0] == 200, 1], red[red[:, 1] == 110, 0]
    assert len(red) == len(upright) + len(level) - 1  # nothing but the two arms
    assert {106, 107, 108, 110, 112, 113} <= set(upright) <= set(range(105, 116))
    assert {197, 198, 200, 202, 203} <= set(level) <= set(range(195, 206))
    # how far it reaches: the red that is drawn on black adds up to nine pixels, four each way
    drawn = draw(in_colour(grey), measured(grey))[101:120, 200, 0] / 230.0
    assert [drawn[:9].sum(), drawn[10:].sum()] == pytest.approx([3.6, 3.6], abs=0.4)


def test_a_target_that_is_not_valid_is_red_with_the_reason_below() -> None:
    cut = np.full((240, 320), 255, np.uint8)
    cut[0:40, 100:160] = 0
    measurement = measured(cut)
    assert measurement.reason
    picture = draw(in_colour(cut), measurement)
    assert len(places(picture, GREEN)) == 0
    red = {tuple(place) for place in places(picture, RED).tolist()}
    assert {(100, 35), (159, 35), (105, 39), (155, 39)} <= red
    assert tuple(picture[10, 105]) == (0, 0, 0)  # its inside is not drawn over
    low = picture[120:].astype(int)
    written = np.argwhere((low[..., 0] - low[..., 1] > 60) & (low[..., 1] < 160)) + (120, 0)
    assert written[:, 0].min() > 195 and written[:, 0].max() < 239  # two lines, not cut off below
    assert written[:, 1].min() >= 2 and 150 < written[:, 1].max() < 319  # all of it is there
