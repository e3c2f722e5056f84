"""Outline and corners of the segmented target, with sub-pixel accuracy, in normalised coordinates.

The outline has one point for each pixel at the target's edge. From the pixel, the edge is searched
along the gradient of the coverage, which is the fraction of each pixel that the target covers.
Corners are the intersections of straight lines that are fitted to the sides of the target. The
lines are fitted in normalised coordinates, in which the sides are straight for any lens.
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

# A side is split in two if it deviates from a line by more than MAX_BEND (as a fraction of the
# outline's length) and by more than MIN_BEND (px). A side shorter than MIN_SIDE (px) is a blunted
# corner. Measured on images of quadrilaterals with noise of up to 5 grey levels: with these limits,
# four corners are found in every image if the quadrilateral is 17 to 40 px wide. With MAX_BEND
# alone, five to eight corners were found in a fifth of these images, and in most images of
# quadrilaterals that were 10 to 17 px wide.
MAX_BEND, MIN_BEND, MIN_SIDE = 0.012, 1.2, 2.0
MAX_CORNERS = 32
# The lines are fitted twice: between the rough corners, then between the corners of the first fit.
FIT_ITERATIONS = 2
OUTLINE_SAMPLES = 128  # number of points at which an outline is compared with a model
# Rms error of a corner, px, in addition to the error that the line fits predict. It was measured on
# 840 quadrilaterals with a width of 12 to 180 px and noise of up to 5 grey levels.
CORNER_ACCURACY = 0.022
# Largest accepted distance of a corner from its place in the fitted model: one pixel plus this
# fraction of the rms distance of the outline's points from their mean.
MAX_CORNER_DISTANCE = 0.1


def extract_outline(grey: NDArray[np.uint8], target: SegmentedTarget, camera: CameraModel) -> Array:
    """Extract the target's outer outline in normalised coordinates.

    Args:
        grey: (rows, columns) image in which the target was segmented.
        target: result of `segment`.
        camera: camera model with which the points are normalised.

    Returns:
        (n, 2), one point for each pixel at the target's edge, in order along the outline.

    Raises:
        SegmentationError: the target has no outline or no contrast, or a part of the outline is
            outside the range of the lens model.
    """
    weights, (left, top), _, _ = compute_coverage(grey, target)
    rows, columns = weights.shape
    mask = np.ascontiguousarray(target.mask[top : top + rows, left : left + columns])
    found, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not found:
        raise SegmentationError("the target has no outline")
    edge = max(found, key=len)[:, 0, :]
    if len(edge) < 8:
        raise SegmentationError(
            f"the target's outline has {len(edge)} pixel(s), must have at least 8: move the camera "
            "closer"
        )
    # For a slope of one per pixel, the result of a Sobel kernel is 8.
    gx = cv2.Sobel(weights, cv2.CV_64F, 1, 0, borderType=cv2.BORDER_REPLICATE) / 8.0
    gy = cv2.Sobel(weights, cv2.CV_64F, 0, 1, borderType=cv2.BORDER_REPLICATE) / 8.0
    u, v = edge[:, 0], edge[:, 1]
    slope = np.hypot(gx[v, u], gy[v, u])
    steep = slope > 0.05
    if steep.sum() < 8:
        raise SegmentationError(
            "the target's outline is too blurred: focus the camera, or light the target evenly"
        )
    u, v, slope = u[steep], v[steep], slope[steep]
    nx, ny = -gx[v, u] / slope, -gy[v, u] / slope  # outward normal
    out = _locate_edge(weights, u, v, nx, ny)
    x, y, valid = camera.normalise(left + u + out * nx, top + v + out * ny)
    if not valid.all():
        raise SegmentationError(
            "the target extends beyond the range of the lens model; move it towards the middle of "
            "the image"
        )
    return np.stack([x, y], axis=1)


def _locate_edge(weights: Array, u: Array, v: Array, nx: Array, ny: Array) -> Array:
    """Measure the distance from each pixel to the target's edge, along the outward normal.

    The coverage is integrated along the normal, from two pixels inside the target, where it is one,
    to two pixels outside, where it is zero. The integral is the length of the covered part, and
    therefore gives the position of the edge. It is exact even if the edge is blurred by a symmetric
    kernel.

    Args:
        weights: (rows, columns) coverage.
        u, v: (n,) column and row of each pixel.
        nx, ny: (n,) unit normal of the edge at each pixel.

    Returns:
        (n,) distances, px.
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
    """Return the corners (n, 2) of a polygon, as `fit_corners` computes them from its outline."""
    return fit_corners(outline, max_bend)[0]


def fit_corners(outline: Array, max_bend: float = MAX_BEND) -> tuple[Array, Array]:
    """Compute the corners of a polygon, and their uncertainty, from its outline.

    The sides are found by the Douglas-Peucker algorithm. A line is fitted to each side by total
    least squares, without the points next to its ends. The corners are the intersections of
    neighbouring lines. The fit is then repeated between these corners.

    Args:
        outline: (m, 2) closed outline, as `extract_outline` returns it.
        max_bend: largest deviation of a side from a line, as a fraction of the outline's length. A
            smaller value than MIN_BEND pixels has no effect. A side shorter than MIN_SIDE pixels
            is replaced by one corner in its middle.

    Returns:
        The corners (n, 2), in the direction from the x axis to the y axis; and their uncertainty
        (2n, 2n), which `compute_crossing_spread` computes from the scatter of the outline about
        the lines.

    Raises:
        SegmentationError: the outline has fewer than three or more than 32 sides.
    """
    points, middle = _centre_polygon(outline)
    steps = _compute_side_lengths(points)
    pixel = float(np.median(steps))
    width = max(max_bend * float(steps.sum()), MIN_BEND * pixel)
    # approxPolyDP uses float32, so coordinates relative to the middle lose fewer digits.
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
    """Find the corners of a polygon in its outline with the help of a model of the polygon.

    If the outline is only a few pixels long, its sides cannot be found without a model. The model
    is aligned with the outline by the similarity transformation that fits best. For this fit, both
    are sampled at points with equal distances. The corners of the aligned model then separate the
    sides of the outline.

    Args:
        outline: (m, 2) closed outline, as `extract_outline` returns it.
        model: (n, 2) corners of the same target in another view of the same side.

    Returns:
        The corners (n, 2), in the order of the model's corners.

    Raises:
        SegmentationError: two corners are at the same point of the outline, or the outline does
            not show the model.
    """
    points, middle = _centre_polygon(outline)
    model_points, _ = _centre_polygon(model)
    outline_samples, model_samples = _resample(points), _resample(model_points)
    origin = model_samples.mean()
    model_samples = model_samples - origin
    # Circular correlation of the two outlines by the correlation theorem. Entry k belongs to a
    # shift of the start point by k samples.
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
            f"the target is too small to separate its {len(model_points)} corners: move the camera "
            "closer"
        )
    # Two views of a plane are related approximately by an affine map.
    homogeneous = np.column_stack([model_points, np.ones(len(model_points))])
    deviation = corners - homogeneous @ np.linalg.lstsq(homogeneous, corners, rcond=None)[0]
    pixel = float(np.median(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    radius = float(np.sqrt(points.var(axis=0).sum()))
    if np.linalg.norm(deviation, axis=1).max() > pixel + MAX_CORNER_DISTANCE * radius:
        raise SegmentationError(
            f"the outline does not match the {len(model_points)} corners of the goal's target: "
            "show the same side of the same target, completely and without occlusion"
        )
    return (corners[::-1] if signed_area(np.asarray(model, float)) < 0.0 else corners) + middle


def _centre_polygon(polygon: Array) -> tuple[Array, Array]:
    """Return the points (n, 2) relative to their mean, and their mean (2,).

    The order of the points is reversed if necessary, so that the polygon turns from the x axis to
    the y axis.
    """
    points = np.asarray(polygon, dtype=float)
    middle = points.mean(axis=0)
    points = points - middle
    return (points[::-1] if signed_area(points) < 0.0 else points), middle


def _compute_side_lengths(points: Array) -> Array:
    """Compute the lengths (n,) of a polygon's sides, from each point (n, 2) to the next."""
    return np.linalg.norm(next_vertices(points) - points, axis=1)


def _resample(polygon: Array) -> Array:
    """Sample a closed polygon (n, 2) at OUTLINE_SAMPLES points with equal distances.

    Returns:
        (OUTLINE_SAMPLES,) complex numbers x + i y.
    """
    closed = np.vstack([polygon, polygon[:1]])
    arc_length = np.concatenate([[0.0], np.linalg.norm(np.diff(closed, axis=0), axis=1).cumsum()])
    positions = arc_length[-1] * np.arange(OUTLINE_SAMPLES) / OUTLINE_SAMPLES
    return np.interp(positions, arc_length, closed[:, 0]) + 1j * np.interp(
        positions, arc_length, closed[:, 1]
    )


def _fit_sides(points: Array, corners: Array) -> tuple[Array, Array]:
    """Fit lines to the sides of an outline and intersect them.

    Args:
        points: (m, 2) points of the closed outline.
        corners: (k, 2) rough corners.

    Returns:
        The corners (n, 2) and their uncertainty (2n, 2n), as in `fit_corners`.

    Raises:
        SegmentationError: the outline has fewer than three or more than 32 sides.
    """
    for _ in range(FIT_ITERATIONS):
        breaks = _find_nearest_indices(points, corners)
        if not 3 <= len(breaks) <= MAX_CORNERS:
            raise SegmentationError(
                f"the number of sides of the target's outline is {len(breaks)}, must be 3 to "
                f"{MAX_CORNERS}: use a polygon as the target, or move the camera closer"
            )
        corners, lines = _intersect_sides(points, breaks)
    return corners, compute_crossing_spread(lines)


def _find_nearest_indices(points: Array, corners: Array) -> NDArray[np.intp]:
    """Return the index of the outline point that is nearest to each corner, without duplicates.

    The indices are in order along the outline, starting at the first corner.
    """
    distance = np.linalg.norm(points[None, :, :] - corners[:, None, :], axis=2)
    places = distance.argmin(axis=1)
    order = np.argsort((places - places[0]) % len(points), kind="stable")
    places = places[order]
    return places[np.concatenate([[True], np.diff(places) != 0])]


def _intersect_sides(points: Array, breaks: NDArray[np.intp]) -> tuple[Array, list[FittedLine]]:
    """Fit a line to each side of an outline and intersect neighbouring lines.

    Args:
        points: (m, 2) points of the closed outline.
        breaks: (n,) indices of the points that separate the sides.

    Returns:
        The corners (n, 2), and n lines; line k leads from corner k to the next corner.
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
    """Fit a line to the points of an outline from index `first` to index `last`."""
    count = (last - first) % len(points) or len(points)
    # The grey levels near a corner depend on both sides that meet there. Therefore three points
    # are omitted at each end, or a third of the points if there are fewer than nine.
    cut = min(3, count // 3)
    side = points[(first + np.arange(cut, count - cut + 1)) % len(points)]
    centre = side.mean(axis=0)
    _, sizes, axes = np.linalg.svd(side - centre, full_matrices=False)
    return FittedLine(centre, axes[-1], len(side), sizes[0], sizes[-1] ** 2)
