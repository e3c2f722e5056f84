"""Overlay image for rviz: the detected target, drawn into the camera image."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import atan2, cos, sin, sqrt

import cv2
import numpy as np
from numpy.typing import NDArray

from .detection_pipeline import TargetDetection

_GREEN, _RED, _YELLOW, _BLUE = (0, 220, 0), (230, 30, 30), (255, 210, 0), (60, 120, 255)
_FRACTION_BITS = 4  # the coordinates of drawn lines are in units of 1/16 px


def draw(
    rgb: NDArray[np.uint8],
    detection: TargetDetection,
    desired_outline: Sequence[tuple[float, float]] = (),
) -> NDArray[np.uint8]:
    """Draw the detected target and the desired outline into a copy of an image.

    The contour of the target is green if it is valid, otherwise red. Its main axis is yellow, its
    centre red, and the desired outline blue. If the target is invalid, the reason is written at the
    bottom of the image.

    Args:
        rgb: (rows, columns, 3) image.
        detection: target in this image.
        desired_outline: x, y of each corner, normalised.
    """
    overlay = np.ascontiguousarray(rgb).copy()
    colour = _GREEN if detection.valid else _RED
    camera = detection.camera
    if camera is not None and len(desired_outline) >= 3:
        x, y = np.array(desired_outline, dtype=float).T
        _draw_polyline(overlay, np.stack(camera.project(x, y), axis=1), _BLUE)
    if detection.target.pixel_count:
        contours, _ = cv2.findContours(
            detection.target.mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE
        )
        cv2.drawContours(overlay, contours, -1, colour, 1)
    moments = detection.moments
    if moments is not None and camera is not None:
        mu = moments.mu
        alpha = 0.5 * atan2(2.0 * mu(1, 1), mu(2, 0) - mu(0, 2))
        half_length = 2.0 * sqrt((mu(2, 0) + mu(0, 2)) / moments.m00)
        offsets = np.linspace(-half_length, half_length, 9)
        x, y = moments.xg + offsets * cos(alpha), moments.yg + offsets * sin(alpha)
        axis = np.stack(camera.project(x, y), axis=1)
        _draw_polyline(overlay, axis, _YELLOW, closed=False)
        u, v = (float(a[0]) for a in camera.project([moments.xg], [moments.yg]))
        cross = np.array([[u - 4, v], [u + 4, v], [u, v], [u, v - 4], [u, v + 4]])
        _draw_polyline(overlay, cross, _RED, closed=False)
    if detection.reason:
        _draw_text(overlay, detection.reason)
    return overlay


def _draw_polyline(image: NDArray, points: NDArray, colour: tuple, closed: bool = True) -> None:
    scaled = np.round(points * 2**_FRACTION_BITS).astype(np.int32).reshape(-1, 1, 2)
    cv2.polylines(image, [scaled], closed, colour, 1, cv2.LINE_AA, _FRACTION_BITS)


def _draw_text(image: NDArray, text: str) -> None:
    """Write a text at the bottom of an image, in letters that are legible in small images."""
    font, margin = cv2.FONT_HERSHEY_SIMPLEX, 4
    scale = 0.5 if image.shape[1] >= 480 else 0.35
    (_, height), below = cv2.getTextSize("Ag", font, scale, 1)
    step = height + below + 1
    room = image.shape[1] - 2 * margin
    lines = _wrap_text(text, lambda words: cv2.getTextSize(words, font, scale, 1)[0][0] <= room)
    lines = lines[: max((image.shape[0] // 2 - margin) // step, 1)]
    # Make the text legible: lighten the image behind it. (A border around small letters would be
    # confused with the letters.)
    top = image.shape[0] - len(lines) * step - margin
    image[max(top, 0) :] = image[max(top, 0) :] // 5 + 204
    for number, line in enumerate(lines):
        place = (margin, top + (number + 1) * step - below + 1)
        cv2.putText(image, line, place, font, scale, _RED, 1, cv2.LINE_AA)


def _wrap_text(text: str, fits: Callable[[str], bool]) -> list[str]:
    """Split a text into lines; a word that does not fit into a line is a line of its own.

    fits: function that returns whether a text fits into one line.
    """
    lines: list[str] = []
    for word in text.split():
        if lines and fits(f"{lines[-1]} {word}"):
            lines[-1] += f" {word}"
        else:
            lines.append(word)
    return lines
