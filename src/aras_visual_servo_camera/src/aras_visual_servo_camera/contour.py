"""Outline and corners of the segmented target, with sub-pixel accuracy, in normalised coordinates.

The outline runs where the target covers half of a pixel. From each edge pixel it is searched along
the gradient of the grey level. Corners are the intersections of straight lines that are fitted to
the sides. The lines are fitted in normalised coordinates, where sides are straight for any lens.
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

# A side that deviates from a line by more than MAX_BEND (as a fraction of the outline's length) and
# MIN_BEND (px) is split in two. Sides shorter than MIN_SIDE (px) are blunted corners, not sides.
# With all three, four corners are found in every image of a quadrilateral 17 to 40 px wide with
# noise of up to 5 grey levels. With MAX_BEND alone, a fifth of these images, and most images of
# quadrilaterals 10 to 17 px wide, gave five to eight corners.
MAX_BEND, MIN_BEND, MIN_SIDE = 0.012, 1.2, 2.0
MAX_CORNERS = 32
FIT_ITERATIONS = 2  # lines are fitted between the rough corners, then between the fitted ones
OUTLINE_SAMPLES = 128  # points at which an outline is compared with a model
# Error of corners in px rms in addition to that estimated from the line fits, measured on 840
# quadrilaterals of 12 to 180 px with noise of up to 5 grey levels.
CORNER_ACCURACY = 0.022
# A corner may be this far (in radii of the outline), plus one pixel, from that of the model.
MAX_CORNER_DISTANCE = 0.1


def extract_outline(grey: NDArray[np.uint8], target: SegmentedTarget, camera: CameraModel) -> Array:
    """Extract the outer outline (n, 2) of the target, normalised, with one point per edge pixel.

    Args:
        grey: (rows, columns) image in which the target was segmented.
        target: result of `segment`.
        camera: model that normalises the points.

    Raises:
        SegmentationError: the target has no outline or no contrast, or a part of the outline lies
            where the lens model has no ray.
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
    # The weights of a Sobel kernel multiply a slope of one per pixel by 8.
    gx = cv2.Sobel(weights, cv2.CV_64F, 1, 0, borderType=cv2.BORDER_REPLICATE) / 8.0
    gy = cv2.Sobel(weights, cv2.CV_64F, 0, 1, borderType=cv2.BORDER_REPLICATE) / 8.0
    u, v = edge[:, 0], edge[:, 1]
    slope = np.hypot(gx[v, u], gy[v, u])
    steep = slope > 0.05
    if steep.sum() < 8:
        raise SegmentationError("the target's outline is too blurred: the image has no sharp edge")
    u, v, slope = u[steep], v[steep], slope[steep]
    nx, ny = -gx[v, u] / slope, -gy[v, u] / slope  # outward normal
    out = _locate_edge(weights, u, v, nx, ny)
    x, y, valid = camera.normalise(left + u + out * nx, top + v + out * ny)
    if not valid.all():
        raise SegmentationError(
            "the target reaches beyond the part of the image that has normalised coordinates"
        )
    return np.stack([x, y], axis=1)


def _locate_edge(weights: Array, u: Array, v: Array, nx: Array, ny: Array) -> Array:
    """Compute the distance (n,), px, of the edge from each pixel (u, v) along its normal.

    The coverage is integrated along the normal from two pixels inside the target, where it is one,
    to two pixels outside, where it is zero. The integral is the covered length. It is exact for an
    edge that is blurred by a symmetric kernel.
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
    """Find the corners (n, 2) of a polygon's outline; `fit_corners` explains the method."""
    return fit_corners(outline, max_bend)[0]


def fit_corners(outline: Array, max_bend: float = MAX_BEND) -> tuple[Array, Array]:
    """Fit the corners (n, 2) of a polygon's outline (m, 2) and their uncertainty.

    The corners have positive orientation (from x to y). The sides are found by the
    Douglas-Peucker algorithm and fitted by total least squares, without the points next to their
    ends. Neighbouring lines are intersected, and the fit is repeated between these corners.

    Args:
        outline: closed outline, as `extract_outline` returns it.
        max_bend: largest deviation of a side from a line, as a fraction of the outline's length; at
            least MIN_BEND pixels. Sides shorter than MIN_SIDE pixels are merged into a corner.

    Returns:
        The corners, and their spread (2n, 2n) from the scatter of the outline about its sides, as
        `compute_crossing_spread` returns it.

    Raises:
        SegmentationError: the outline has fewer than three or more than 32 sides.
    """
    points, middle = _centre_polygon(outline)
    steps = _compute_side_lengths(points)
    pixel = float(np.median(steps))
    width = max(max_bend * float(steps.sum()), MIN_BEND * pixel)
    # approxPolyDP takes float32; coordinates about the middle lose fewer digits.
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
    """Find the corners (n, 2) of a polygon's outline (m, 2) with the help of a model.

    The result has as many corners as the model (n, 2), in its order. A model is needed where the
    outline is only a few pixels long, because its sides cannot be found without it. The model is
    aligned with the outline by the best-fitting similarity, with points at equal distances along
    both. Its corners then separate the sides.

    Args:
        outline: closed outline, as `extract_outline` returns it.
        model: corners of the same target in another view of the same side.

    Raises:
        SegmentationError: two corners fall on one point of the outline, or the outline is no view
            of the model.
    """
    points, middle = _centre_polygon(outline)
    model_points, _ = _centre_polygon(model)
    outline_samples, model_samples = _resample(points), _resample(model_points)
    origin = model_samples.mean()
    model_samples = model_samples - origin
    # Correlation with the model for every start point, by the correlation theorem.
    correlation = np.fft.ifft(np.fft.fft(outline_samples) * np.conj(np.fft.fft(model_samples)))
    similarity = (
        correlation[int(np.abs(correlation).argmax())] / np.vdot(model_samples, model_samples).real
    )
    aligned = (
        model_points[:, 0] + 1j * model_points[:, 1] - origin
    ) * similarity + outline_samples.mean()
    corners, _ = _fit_sides(points, np.stack([aligned.real, aligned.imag], axis=1))
    if len(corners) != len(model_points):
        raise SegmentationError(
            f"the target is too small to separate its {len(model_points)} corners"
        )
    # Two views of a plane are related approximately by an affine map.
    homogeneous = np.column_stack([model_points, np.ones(len(model_points))])
    deviation = corners - homogeneous @ np.linalg.lstsq(homogeneous, corners, rcond=None)[0]
    pixel = float(np.median(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    radius = float(np.sqrt(points.var(axis=0).sum()))
    if np.linalg.norm(deviation, axis=1).max() > pixel + MAX_CORNER_DISTANCE * radius:
        raise SegmentationError(
            f"the outline does not match the {len(model_points)} corners of the goal's target"
        )
    return (corners[::-1] if signed_area(np.asarray(model, float)) < 0.0 else corners) + middle


def _centre_polygon(polygon: Array) -> tuple[Array, Array]:
    """Return the points (n, 2) about their middle, with positive orientation, and the middle (2,).
    """
    points = np.asarray(polygon, dtype=float)
    middle = points.mean(axis=0)
    points = points - middle
    return (points[::-1] if signed_area(points) < 0.0 else points), middle


def _compute_side_lengths(points: Array) -> Array:
    """Compute the lengths (n,) of a polygon's sides, from each point (n, 2) to the next."""
    return np.linalg.norm(next_vertices(points) - points, axis=1)


def _resample(polygon: Array) -> Array:
    """Return OUTLINE_SAMPLES complex points at equal distances along a closed polygon (n, 2)."""
    closed = np.vstack([polygon, polygon[:1]])
    arc_length = np.concatenate([[0.0], np.linalg.norm(np.diff(closed, axis=0), axis=1).cumsum()])
    positions = arc_length[-1] * np.arange(OUTLINE_SAMPLES) / OUTLINE_SAMPLES
    return np.interp(positions, arc_length, closed[:, 0]) + 1j * np.interp(
        positions, arc_length, closed[:, 1]
    )


def _fit_sides(points: Array, corners: Array) -> tuple[Array, Array]:
    """Fit lines to the sides of an outline and intersect them, starting from rough corners (k, 2).

    Returns:
        The corners (n, 2) and their spread (2n, 2n).

    Raises:
        SegmentationError: as in `fit_corners`.
    """
    for _ in range(FIT_ITERATIONS):
        breaks = _find_nearest_indices(points, corners)
        if not 3 <= len(breaks) <= MAX_CORNERS:
            raise SegmentationError(f"the target's outline has {len(breaks)} sides: no polygon")
        corners, lines = _intersect_sides(points, breaks)
    return corners, compute_crossing_spread(lines)


def _find_nearest_indices(points: Array, corners: Array) -> NDArray[np.intp]:
    """Return the indices of the outline points nearest to the corners.

    The indices are in cyclic order, starting with that of the first corner.
    """
    distance = np.linalg.norm(points[None, :, :] - corners[:, None, :], axis=2)
    places = distance.argmin(axis=1)
    order = np.argsort((places - places[0]) % len(points), kind="stable")
    places = places[order]
    return places[np.concatenate([[True], np.diff(places) != 0])]


def _intersect_sides(points: Array, breaks: NDArray[np.intp]) -> tuple[Array, list[FittedLine]]:
    """Intersect the lines of neighbouring sides of an outline.

    The breaks are the indices of the outline points that separate the sides.

    Returns:
        The corners (n, 2), and the lines, each of which starts at its corner.
    """
    ends = np.roll(breaks, -1)
    lines = [_fit_line(points, a, b) for a, b in zip(breaks, ends, strict=True)]
    corners = []
    for before, line, place in zip(lines[-1:] + lines[:-1], lines, breaks, strict=True):
        n0, n1 = before.normal, line.normal
        d0, d1 = float(n0 @ before.middle), float(n1 @ line.middle)
        cross = n0[0] * n1[1] - n0[1] * n1[0]
        if abs(cross) < PARALLEL:  # parallel lines do not intersect
            corners.append(points[place])
            continue
        corners.append([(d0 * n1[1] - d1 * n0[1]) / cross, (n0[0] * d1 - n1[0] * d0) / cross])
    return np.array(corners), lines


def _fit_line(points: Array, first: int, last: int) -> FittedLine:
    """Fit a line to the outline from one corner to the next."""
    count = (last - first) % len(points) or len(points)
    # Near a corner the grey levels mix both sides: leave out two pixels, or a third of a short
    # side.
    cut = min(3, count // 3)
    side = points[(first + np.arange(cut, count - cut + 1)) % len(points)]
    centre = side.mean(axis=0)
    _, sizes, axes = np.linalg.svd(side - centre, full_matrices=False)
    return FittedLine(centre, axes[-1], len(side), sizes[0], sizes[-1] ** 2)
