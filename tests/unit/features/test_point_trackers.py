"""Point trackers on drawn images: which shapes are detected as dots."""

import cv2
import numpy as np
import pytest

from aras_visual_servo_camera.errors import VisionError
from aras_visual_servo_camera.trackers.dots import DotTracker

SIZE, FINE = (160, 120), 8
# Column, row and radius, px; in order of angle about their middle.
DOTS = np.array([[41.3, 30.2, 9.0], [102.6, 33.8, 8.0], [110.1, 88.4, 7.5], [52.7, 85.9, 8.5]])


V, U = (np.mgrid[:FINE * SIZE[1], :FINE * SIZE[0]] + 0.5) / FINE - 0.5
ALONE = np.where([np.hypot(U - x, V - y) < r for x, y, r in DOTS], 40, 210).min(0).astype(np.uint8)


def drawn(draw) -> np.ndarray:
    """An image of the dots and of what `draw` draws, at FINE times the resolution."""
    large = ALONE.copy()
    draw(large, U, V)
    return cv2.resize(large, SIZE, interpolation=cv2.INTER_AREA)


def ellipse(x, y, a, b):
    def draw(large, u, v):
        large[((u - x) / a) ** 2 + ((v - y) / b) ** 2 < 1.0] = 40
    return draw


def box(left, top, right, bottom):
    def draw(large, u, v):
        large[(u > left) & (u < right) & (v > top) & (v < bottom)] = 40
    return draw


def half_moon(large, u, v):
    away = np.hypot(u - 76, v - 60)
    large[(away < 11.0) & (away > 7.5) & (u > 70)] = 40


NO_DOTS = {
    "nothing": lambda *_: None, "wide": ellipse(76.0, 60.0, 20.0, 4.6),
    "high": ellipse(78.0, 58.0, 4.4, 19.5), "square": box(68, 52, 88, 72), "moon": half_moon,
    "left border": ellipse(4.0, 60.0, 12.0, 12.0), "low border": ellipse(80.0, 112.0, 12.0, 12.0),
    "bar by a dot": box(52.5, 12, 59, 50), "smaller": ellipse(76.0, 60.0, 6.5, 6.5),
    "speck": ellipse(76.0, 60.0, 0.9, 0.9)}


@pytest.mark.parametrize("what", NO_DOTS)
def test_dots_are_the_largest_round_ones_away_from_the_border(what):
    """Their blurred edges count, but not what is darker next to them."""
    grey = drawn(NO_DOTS[what])
    for image in (grey, cv2.GaussianBlur(grey, (0, 0), 1.0)):
        assert np.abs(DotTracker().find(image) - DOTS[:, :2]).max() < 0.02


def test_dots_may_be_a_few_pixels_or_seen_askew_and_all_must_be_there():
    grey = drawn(ellipse(76.3, 59.8, 2.2, 1.6))
    small = DotTracker(5).find(grey)
    assert np.abs(small - (76.3, 59.8)).sum(axis=1).min() < 0.1
    askew = DotTracker(5).find(drawn(ellipse(76.3, 59.8, 14.0, 5.0)))
    assert np.abs(askew - (76.3, 59.8)).sum(axis=1).min() < 0.03
    with pytest.raises(VisionError, match="5 of 6 dots"):
        DotTracker(6).find(grey)


@pytest.mark.parametrize("at", [(11.6, 11.2), (147.6, 107.4)])
def test_a_dot_beside_the_border_is_measured_like_another(at):
    """Two pixels from it, where less of the ground is seen."""
    def draw(large, u, v):
        large[:] = 210
        large[np.hypot(u - at[0], v - at[1]) < 9.0] = 40

    assert np.abs(DotTracker(1).find(drawn(draw)) - at).max() < 0.02
