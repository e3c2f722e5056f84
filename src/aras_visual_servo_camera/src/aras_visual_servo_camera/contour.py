"""Outline and corners of the segmented target, with sub-pixel accuracy, in normalised coordinates.

The coverage of a pixel is the fraction of it that the target covers. The outline has one point for
each pixel at the target's edge. The point is found with sub-pixel accuracy along the gradient of
the coverage at this pixel. Corners are the intersections of straight lines that are fitted to the
sides of the target. The lines are fitted in normalised coordinates, in which the sides are straight
for any lens.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from .camera_model import CameraModel
from .compiled_contour import MAX_CORNERS, centre_polygon, fit_sides, locate_edge, merge_corners
from .errors import SegmentationError
from .intersection_accuracy import propagate_line_errors
from .pixel_coverage import compute_coverage
from .polygons import Array, resample, signed_area
from .segmented_target import SegmentedTarget

# A side is split in two if it deviates from a straight line by more than both limits: MAX_BEND
# (fraction of the outline's length) and MIN_BEND (px). A side shorter than MIN_SIDE (px) is
# replaced by one corner. Measured on noisy images of quadrilaterals 17 to 40 px wide: with these
# limits, four corners are found in every image; without MIN_BEND, five to eight are found in a
# fifth of the images.
MAX_BEND, MIN_BEND, MIN_SIDE = 0.012, 1.2, 2.0
# Number of times that lines are fitted to the sides: first between the rough corners, then between
# the corners of the first fit.
FIT_ITERATIONS = 2
OUTLINE_SAMPLES = 128  # number of points at which an outline is compared with a model
# Rms error of a corner, px, in addition to the error predicted by the line fits. It was measured on
# 840 quadrilaterals with a width of 12 to 180 px and noise of up to 5 grey levels.
CORNER_ACCURACY = 0.022
# Largest accepted distance between a corner of the outline and the corresponding corner of the
# fitted model: one pixel plus this fraction of the outline's radius (rms distance of its points
# from their mean).
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
    weights, (left, top) = compute_coverage(grey, target)
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
    outline = np.empty((len(edge), 2))
    count = locate_edge(weights, edge, outline)
    if count < 8:
        raise SegmentationError(
            "the target's outline is too blurred: focus the camera, or light the target evenly"
        )
    outline = outline[:count]
    outline += (left, top)
    outline[:, 0], outline[:, 1], valid = camera.normalise(outline[:, 0], outline[:, 1])
    if camera.is_distorted and not valid.all():
        raise SegmentationError(
            "the target extends beyond the range of the lens model; move it towards the middle of "
            "the image"
        )
    return outline


def find_corners(outline: Array, max_bend: float = MAX_BEND) -> Array:
    """Return the corners (n, 2) that `fit_corners` computes from the outline of a polygon."""
    return fit_corners(outline, max_bend)[0]


def fit_corners(outline: Array, max_bend: float = MAX_BEND) -> tuple[Array, Array]:
    """Compute the corners of a polygon, and their uncertainty, from its outline.

    The Douglas-Peucker algorithm divides the outline into sides. Each side shorter than MIN_SIDE
    pixels is then replaced by one corner in its middle. A line is fitted to each remaining side by
    total least squares, without the points next to the corners. The intersections of neighbouring
    lines are the new corners. The lines are then fitted again, to the points between the new
    corners.

    Args:
        outline: (m, 2) closed outline, as `extract_outline` returns it.
        max_bend: largest deviation of a side from a line, as a fraction of the outline's length.
            The limit is at least MIN_BEND pixels.

    Returns:
        The corners (n, 2), clockwise in the image (y is down); and an array S (2n, 2n), where S S^T
        is the covariance of the corners' coordinates (x_0, y_0, x_1, ...).

    Raises:
        SegmentationError: the outline has fewer than three or more than 32 sides.
    """
    points, middle, pixel, length = _centre_polygon(outline)
    width = max(max_bend * length, MIN_BEND * pixel)
    # approxPolyDP uses float32. Coordinates relative to the middle of the outline lose fewer
    # digits.
    rough = cv2.approxPolyDP(points.astype(np.float32)[:, None], width, True)
    corners = rough[:, 0].astype(float)
    corners, lines = _fit_sides(points, corners[: merge_corners(corners, MIN_SIDE * pixel)])
    spread = np.empty((2 * len(lines), 2 * len(lines)))
    propagate_line_errors(lines, spread)
    return corners + middle, spread


def match_corners(outline: Array, model: Array) -> Array:
    """Find the corners of a polygon in its outline with the help of a model of the polygon.

    If the outline is only a few pixels long, its sides cannot be found without a model. The model
    is aligned with the outline by the similarity transformation that fits best. For this fit, both
    are sampled at points with equal distances. The corners of the aligned model then separate the
    sides of the outline.

    Args:
        outline: (m, 2) closed outline, as `extract_outline` returns it.
        model: (n, 2) corners of the same target in another image, which must not show its back.

    Returns:
        The corners (n, 2), in the order of the model's corners.

    Raises:
        SegmentationError: two corners are at the same point of the outline, or the outline does not
            show the model.
    """
    points, middle, _, _ = _centre_polygon(outline)
    model_points, _, _, _ = _centre_polygon(model)
    outline_samples, model_samples = (
        resample(polygon, OUTLINE_SAMPLES) @ (1.0, 1.0j) for polygon in (points, model_points)
    )
    origin = model_samples.mean()
    model_samples = model_samples - origin
    # Circular correlation of the outline with the model's outline, by the correlation theorem.
    # Entry k is for a shift of the start point by k samples.
    correlation = np.fft.ifft(np.fft.fft(outline_samples) * np.conj(np.fft.fft(model_samples)))
    best = correlation[int(np.abs(correlation).argmax())]
    similarity = best / np.vdot(model_samples, model_samples).real
    aligned = (model_points @ (1.0, 1.0j) - origin) * similarity + outline_samples.mean()
    corners, _ = _fit_sides(points, np.stack([aligned.real, aligned.imag], axis=1))
    if len(corners) != len(model_points):
        raise SegmentationError(
            f"the target is too small in the image to separate its {len(model_points)} corners: "
            "move the camera closer"
        )
    # Two views of a plane are related approximately by an affine map, which is fitted here.
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


def _centre_polygon(polygon: Array) -> tuple[Array, tuple[float, float], float, float]:
    """Return a polygon (n, 2) relative to its middle, clockwise in the image (y is down).

    Returns:
        The points (n, 2); the polygon's middle; the median length of its sides; its perimeter.
    """
    polygon = np.asarray(polygon, dtype=float)
    points = np.empty(polygon.shape)
    x, y, side, length = centre_polygon(polygon, points)
    return points, (x, y), side, length


def _fit_sides(points: Array, corners: Array) -> tuple[Array, Array]:
    """Fit lines to the sides of an outline and intersect them.

    Args:
        points: (m, 2) points of the closed outline.
        corners: (k, 2) rough corners.

    Returns:
        The corners (n, 2), and the lines (n, 7), whose columns `propagate_line_errors` describes.

    Raises:
        SegmentationError: the outline has fewer than three or more than 32 sides.
    """
    fitted, lines = np.empty((MAX_CORNERS, 2)), np.empty((MAX_CORNERS, 7))
    count = fit_sides(points, corners, FIT_ITERATIONS, fitted, lines)
    if not 3 <= count <= MAX_CORNERS:
        raise SegmentationError(
            f"the number of sides of the target's outline is {count}, must be 3 to "
            f"{MAX_CORNERS}: use a polygon as the target, or move the camera closer"
        )
    return fitted[:count], lines[:count]
