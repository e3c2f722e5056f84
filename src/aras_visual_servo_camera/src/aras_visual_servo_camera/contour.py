"""Outline and corners of the segmented target, below a pixel exact, in normalised coordinates.

The outline is where the target covers half a pixel: from each pixel of its edge one goes along
the gradient of the grey level to the level between target and ground. Corners are where straight
lines through the sides meet; sides are straight in normalised coordinates, whatever the lens.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from .errors import SegmentationError
from .moments import Array
from .segmentation import Target, coverage
from .undistortion import CameraModel

# Of the outline's length: how far a side may bend before it counts as two.
BEND = 0.012
MAX_CORNERS = 32


def outline_of(grey: NDArray[np.uint8], target: Target, camera: CameraModel) -> Array:
    """The outer outline (n, 2) of the target, normalised, one point a pixel of its edge.

    Args:
        grey: (rows, columns) that the target was segmented in.
        target: as segment() found it.
        camera: for the undistorted place of each point.

    Raises:
        SegmentationError: no outline, no contrast, or a part of it that no ray leads to.
    """
    weights, (left, top), _, _ = coverage(grey, target)
    rows, columns = weights.shape
    mask = np.ascontiguousarray(target.mask[top : top + rows, left : left + columns])
    found, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not found:
        raise SegmentationError("the target has no outline")
    edge = max(found, key=len)[:, 0, :]
    if len(edge) < 8:
        raise SegmentationError(f"the target's outline is {len(edge)} pixel(s) long: too small")
    # Sobel's kernels weigh a step of one in both directions 8 times.
    gx = cv2.Sobel(weights, cv2.CV_64F, 1, 0, borderType=cv2.BORDER_REPLICATE) / 8.0
    gy = cv2.Sobel(weights, cv2.CV_64F, 0, 1, borderType=cv2.BORDER_REPLICATE) / 8.0
    u, v = edge[:, 0], edge[:, 1]
    slope = np.hypot(gx[v, u], gy[v, u])
    steep = slope > 0.05
    if steep.sum() < 8:
        raise SegmentationError("the target's outline is blurred out")
    u, v, slope = u[steep], v[steep], slope[steep]
    nx, ny = -gx[v, u] / slope, -gy[v, u] / slope  # outwards
    out = _to_edge(weights, u, v, nx, ny)
    x, y, valid = camera.normalise(left + u + out * nx, top + v + out * ny)
    if not valid.all():
        raise SegmentationError(
            "the target reaches beyond the part of the image that has normalised coordinates"
        )
    return np.stack([x, y], axis=1)


def _to_edge(weights: Array, u: Array, v: Array, nx: Array, ny: Array) -> Array:
    """How far (n,), pixels, the edge is from each pixel (u, v) along its normal.

    The weights along the normal add up to the part of it that the target covers: from two pixels
    inside, where they are one, to two outside, where they are zero. That is right for an edge
    blurred by any symmetric kernel.
    """
    steps = np.arange(-2.0, 2.25, 0.25)
    columns = (u[:, None] + nx[:, None] * steps).astype(np.float32)
    rows = (v[:, None] + ny[:, None] * steps).astype(np.float32)
    profile = cv2.remap(
        weights.astype(np.float32), columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    covered = 0.25 * (profile.sum(axis=1) - 0.5 * (profile[:, 0] + profile[:, -1]))
    return np.clip(covered - 2.0, -1.5, 1.5)


def corners_of(outline: Array, bend: float = BEND) -> Array:
    """Corners (n, 2) of a polygon's outline (m, 2), in its order, with positive turn.

    Sides are found by Douglas and Peucker's rule, fitted by total least squares without the
    points next to their ends, and met.

    Args:
        outline: closed, as outline_of() gives it.
        bend: part of the outline's length by which a side may differ from a line.

    Raises:
        SegmentationError: fewer than three sides, or more than 32: no polygon.
    """
    points = np.asarray(outline, dtype=float)
    x, y = points.T
    if np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)) < 0.0:
        points = points[::-1]
    length = float(np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1).sum())
    # approxPolyDP takes float32: numbers about the middle keep their digits.
    middle = points.mean(axis=0)
    rough = cv2.approxPolyDP((points - middle).astype(np.float32)[:, None], bend * length, True)
    breaks = _places(points - middle, rough[:, 0].astype(float))
    if not 3 <= len(breaks) <= MAX_CORNERS:
        raise SegmentationError(f"the target's outline has {len(breaks)} sides: no polygon")
    lines = [_line(points - middle, a, b) for a, b in zip(breaks, np.roll(breaks, -1), strict=True)]
    corners = []
    for before, after, place in zip(np.roll(np.arange(len(lines)), 1), range(len(lines)), breaks,
                                    strict=True):  # fmt: skip
        (n0, d0), (n1, d1) = lines[before], lines[after]
        cross = n0[0] * n1[1] - n0[1] * n1[0]
        if abs(cross) < 0.05:  # nearly parallel: no corner to meet at
            corners.append(points[place] - middle)
            continue
        corners.append([(d0 * n1[1] - d1 * n0[1]) / cross, (n0[0] * d1 - n1[0] * d0) / cross])
    return np.array(corners) + middle


def _places(points: Array, vertices: Array) -> NDArray[np.intp]:
    """Indices in the outline of the vertices that approxPolyDP chose from it, rising."""
    distance = np.linalg.norm(points[None, :, :] - vertices[:, None, :], axis=2)
    return np.unique(distance.argmin(axis=1))


def _line(points: Array, first: int, last: int) -> tuple[Array, float]:
    """Normal (2,) and offset of the line through the outline from one corner to the next."""
    count = (last - first) % len(points) or len(points)
    # Near a corner the grey levels mix both sides: two pixels, or a quarter of a short side.
    cut = min(3, count // 4)
    side = points[(first + np.arange(cut, count - cut + 1)) % len(points)]
    centre = side.mean(axis=0)
    normal = np.linalg.svd(side - centre, full_matrices=False)[2][-1]
    return normal, float(normal @ centre)
