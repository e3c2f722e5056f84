"""Outline and corners of the segmented target, below a pixel exact, in normalised coordinates.

The outline is where the target covers half a pixel: from each pixel of its edge one goes along
the gradient of the grey level to the level between target and ground. Corners are where straight
lines through the sides meet; sides are straight in normalised coordinates, whatever the lens.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from .coverage import compute_coverage
from .errors import SegmentationError
from .line_fits import PARALLEL, FittedLine, compute_crossing_spread
from .polygons import Array, next_vertices, signed_area
from .segmented_target import SegmentedTarget
from .undistortion import CameraModel

# How far a side may bend before it counts as two: a part of the outline's length, and pixels; and
# pixels that a side is long at least, as sharp corners are blunted. Of outlines of four corners, 17
# to 40 px wide and with noise of up to 5 grey levels, all pictures show four; by the part alone a
# fifth of them, and most that are 10 to 17 px wide, showed five to eight.
MAX_BEND, MIN_BEND, MIN_SIDE = 0.012, 1.2, 2.0
MAX_CORNERS = 32
FIT_ITERATIONS = 2  # of the sides' lines: between rough corners, and between those so found
OUTLINE_SAMPLES = 128  # of the way round, at which an outline is compared with a model
# px rms, by which corners are off besides what the fits of their sides tell: measured on 840
# quadrilaterals of 12 to 180 px, with noise of up to 5 grey levels.
CORNER_ACCURACY = 0.022
MAX_CORNER_DISTANCE = 0.1  # of its radius that a corner may be off its model's, and a pixel


def extract_outline(grey: NDArray[np.uint8], target: SegmentedTarget, camera: CameraModel) -> Array:
    """The outer outline (n, 2) of the target, normalised, one point a pixel of its edge.

    Args:
        grey: (rows, columns) that the target was segmented in.
        target: as segment() found it.
        camera: for the undistorted place of each point.

    Raises:
        SegmentationError: no outline, no contrast, or a part of it that no ray leads to.
    """
    weights, (left, top), _, _ = compute_coverage(grey, target)
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
    out = _locate_edge(weights, u, v, nx, ny)
    x, y, valid = camera.normalise(left + u + out * nx, top + v + out * ny)
    if not valid.all():
        raise SegmentationError(
            "the target reaches beyond the part of the image that has normalised coordinates"
        )
    return np.stack([x, y], axis=1)


def _locate_edge(weights: Array, u: Array, v: Array, nx: Array, ny: Array) -> Array:
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


def find_corners(outline: Array, max_bend: float = MAX_BEND) -> Array:
    """Corners (n, 2) of a polygon's outline; see fit_corners."""
    return fit_corners(outline, max_bend)[0]


def fit_corners(outline: Array, max_bend: float = MAX_BEND) -> tuple[Array, Array]:
    """Corners (n, 2) of a polygon's outline (m, 2), in its order, with positive turn, and their
    spread (2n, 2n) by how the outline scatters about its sides: see spread_of_crossings.

    Sides are found by Douglas and Peucker's rule, fitted by total least squares without the
    points next to their ends, and met; then again between the corners so found.

    Args:
        outline: closed, as outline_of() gives it.
        bend: part of the outline's length by which a side may differ from a line, BLURRED pixels
            at least. Sides of less than SHORT pixels are none.

    Raises:
        SegmentationError: fewer than three sides, or more than 32: no polygon.
    """
    points, middle = _centre_polygon(outline)
    steps = _compute_side_lengths(points)
    pixel = float(np.median(steps))
    width = max(max_bend * float(steps.sum()), MIN_BEND * pixel)
    # approxPolyDP takes float32: numbers about the middle keep their digits.
    rough = cv2.approxPolyDP(points.astype(np.float32)[:, None], width, True)
    corners = rough[:, 0].astype(float)
    while len(corners) > 3 and (sides := _compute_side_lengths(corners)).min() < MIN_SIDE * pixel:
        first = int(sides.argmin())
        last = (first + 1) % len(corners)
        corners[first] = 0.5 * (corners[first] + corners[last])
        corners = np.delete(corners, last, axis=0)
    corners, spread = _fit_sides(points, corners)
    return corners + middle, spread


def match_corners(outline: Array, model: Array) -> Array:
    """Corners (n, 2) of a polygon's outline (m, 2), as many as the model (n, 2) has, and in its
    order: where the outline is a few pixels long, its sides cannot be told without knowing them.

    The model is laid over the outline by the similarity that fits best, points at equal parts of
    the way round compared; its corners then say where sides begin.

    Args:
        outline: closed, as outline_of() gives it.
        model: corners of the same target from another view of the same side.

    Raises:
        SegmentationError: two corners come to lie on one point of the outline; or the outline is
            no view of the model.
    """
    points, middle = _centre_polygon(outline)
    wanted, _ = _centre_polygon(model)
    seen, known = _resample(points), _resample(wanted)
    origin = known.mean()
    known = known - origin
    # Of the model begun k parts later, by the correlation theorem.
    fits = np.fft.ifft(np.fft.fft(seen) * np.conj(np.fft.fft(known)))
    turned = fits[int(np.abs(fits).argmax())] / np.vdot(known, known).real
    laid = (wanted[:, 0] + 1j * wanted[:, 1] - origin) * turned + seen.mean()
    corners, _ = _fit_sides(points, np.stack([laid.real, laid.imag], axis=1))
    if len(corners) != len(wanted):
        raise SegmentationError(
            f"the target is too small to tell its {len(wanted)} corners from each other"
        )
    # A plane seen from elsewhere is about an affine map of it.
    flat = np.column_stack([wanted, np.ones(len(wanted))])
    off = corners - flat @ np.linalg.lstsq(flat, corners, rcond=None)[0]
    pixel = float(np.median(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    radius = float(np.sqrt(points.var(axis=0).sum()))
    if np.linalg.norm(off, axis=1).max() > pixel + MAX_CORNER_DISTANCE * radius:
        raise SegmentationError(f"what is seen has not the goal's {len(wanted)} corners")
    return (corners[::-1] if signed_area(np.asarray(model, float)) < 0.0 else corners) + middle


def _centre_polygon(polygon: Array) -> tuple[Array, Array]:
    """Points (n, 2) about their middle, with positive turn; and that middle (2,)."""
    points = np.asarray(polygon, dtype=float)
    middle = points.mean(axis=0)
    points = points - middle
    return (points[::-1] if signed_area(points) < 0.0 else points), middle


def _compute_side_lengths(points: Array) -> Array:
    """Lengths (n,) of a polygon's sides, from each of its points (n, 2) to the next."""
    return np.linalg.norm(next_vertices(points) - points, axis=1)


def _resample(polygon: Array) -> Array:
    """Complex points (PARTS,) at equal parts of the way round a polygon (n, 2)."""
    closed = np.vstack([polygon, polygon[:1]])
    way = np.concatenate([[0.0], np.linalg.norm(np.diff(closed, axis=0), axis=1).cumsum()])
    at = way[-1] * np.arange(OUTLINE_SAMPLES) / OUTLINE_SAMPLES
    return np.interp(at, way, closed[:, 0]) + 1j * np.interp(at, way, closed[:, 1])


def _fit_sides(points: Array, corners: Array) -> tuple[Array, Array]:
    """Corners (n, 2) where lines through the outline's sides meet, from rough ones (k, 2), and
    their spread (2n, 2n).

    Raises:
        SegmentationError: as corners_of().
    """
    for _ in range(FIT_ITERATIONS):
        breaks = _find_nearest_indices(points, corners)
        if not 3 <= len(breaks) <= MAX_CORNERS:
            raise SegmentationError(f"the target's outline has {len(breaks)} sides: no polygon")
        corners, lines = _intersect_sides(points, breaks)
    return corners, compute_crossing_spread(lines)


def _find_nearest_indices(points: Array, corners: Array) -> NDArray[np.intp]:
    """Indices in the outline of its points nearest to the corners, rising from the first."""
    distance = np.linalg.norm(points[None, :, :] - corners[:, None, :], axis=2)
    places = distance.argmin(axis=1)
    order = np.argsort((places - places[0]) % len(points), kind="stable")
    places = places[order]
    return places[np.concatenate([[True], np.diff(places) != 0])]


def _intersect_sides(points: Array, breaks: NDArray[np.intp]) -> tuple[Array, list[FittedLine]]:
    """Corners (n, 2) where the lines of the sides between the breaks of the outline meet, and these
    lines, each of which begins at its corner."""
    ends = np.roll(breaks, -1)
    lines = [_fit_line(points, a, b) for a, b in zip(breaks, ends, strict=True)]
    corners = []
    for before, line, place in zip(lines[-1:] + lines[:-1], lines, breaks, strict=True):
        n0, n1 = before.normal, line.normal
        d0, d1 = float(n0 @ before.middle), float(n1 @ line.middle)
        cross = n0[0] * n1[1] - n0[1] * n1[0]
        if abs(cross) < PARALLEL:  # no corner to meet at
            corners.append(points[place])
            continue
        corners.append([(d0 * n1[1] - d1 * n0[1]) / cross, (n0[0] * d1 - n1[0] * d0) / cross])
    return np.array(corners), lines


def _fit_line(points: Array, first: int, last: int) -> FittedLine:
    """The line through the outline from one corner to the next."""
    count = (last - first) % len(points) or len(points)
    # Near a corner the grey levels mix both sides: two pixels, or a third of a short side.
    cut = min(3, count // 3)
    side = points[(first + np.arange(cut, count - cut + 1)) % len(points)]
    centre = side.mean(axis=0)
    _, sizes, axes = np.linalg.svd(side - centre, full_matrices=False)
    return FittedLine(centre, axes[-1], len(side), sizes[0], sizes[-1] ** 2)
