"""Silhouette of a solid in an image, and the plane that fits its outline best.

The change of a silhouette's moments depends only on those points of the solid that are visible at
the outline of the silhouette (F. Chaumette, IEEE T-RO 20(4), 2004, section III). The interaction
matrix assumes that these points are in a plane, 1/Z = A x + B y + C.
"""

from __future__ import annotations

import cv2
import numpy as np

from .errors import TrackingModelError
from .interaction import Plane
from .polygons import resample

SILHOUETTE_SAMPLES = 360  # number of sample points at equal distances along the outline
# Largest rms deviation of the outline from the plane, as a fraction of the outline's depth.
# Measured in runs with boxes up to 0.24 m high below a camera at a height of 0.25 m: all runs with
# a deviation of up to 0.088 (boxes up to 0.18 m high) converged; with 0.101, three of five runs
# lost the target.
MAX_PLANE_DEVIATION = 0.09


def find_silhouette_points(points: np.ndarray) -> np.ndarray:
    """Return the vertices of a solid that are corners of the convex hull of its image.

    Args:
        points: (m, 3) vertices of the solid in the camera's frame, m.

    Returns:
        (n, 3) vertices, in order along the hull, m.

    Raises:
        TrackingModelError: a vertex is not in front of the camera.
    """
    if not (points[:, 2] > 0.0).all():
        raise TrackingModelError(
            "the solid is completely or partly behind the camera; move the camera until it is in "
            "front"
        )
    image_points = points[:, :2] / points[:, 2:]
    return points[cv2.convexHull(image_points.astype(np.float32), returnPoints=False)[:, 0]]


def fit_rim(points: np.ndarray) -> tuple[Plane, float]:
    """Fit a plane to the outline of a solid, by least squares in 1/Z.

    Args:
        points: (m, 3) vertices of the solid in the camera's frame, m.

    Returns:
        The plane; and the rms distance of the outline from it along the optical axis, as a fraction
        of the depth.

    Raises:
        TrackingModelError: a vertex is not in front of the camera.
    """
    corners = find_silhouette_points(points)
    # Along a straight edge of the outline, 1/Z is linear in the image, so it can be interpolated.
    samples = np.column_stack([corners[:, :2], np.ones(len(corners))]) / corners[:, 2:]
    x, y, inverse_depth = resample(samples, SILHOUETTE_SAMPLES).T
    rays = np.column_stack([x, y, np.ones(SILHOUETTE_SAMPLES)])
    plane = np.linalg.lstsq(rays, inverse_depth, rcond=None)[0]
    deviation = float(np.sqrt(np.mean((rays @ plane / inverse_depth - 1.0) ** 2)))
    return Plane(*plane.tolist()), deviation


def fit_outline_plane(points: np.ndarray, name: str) -> Plane:
    """Fit a plane to the outline of a solid, and check its deviation.

    Args:
        points: (m, 3) vertices of the solid in the camera's frame, m.
        name: name of the solid, for messages.

    Raises:
        TrackingModelError: a vertex is not in front of the camera, or the deviation is above
            MAX_PLANE_DEVIATION.
    """
    plane, deviation = fit_rim(points)
    if deviation > MAX_PLANE_DEVIATION:
        percent, allowed = 100.0 * deviation, 100.0 * MAX_PLANE_DEVIATION
        raise TrackingModelError(
            f"the visible outline of {name} is too far from a plane, which schemes of moments "
            f"need: it deviates by {percent:.0f} % of the distance (rms), must be at most "
            f"{allowed:.0f} %; place the camera farther away or above another side, or use scheme "
            "'model'"
        )
    return plane


class OutlinePlaneFitter:
    """Computes the plane of a solid's outline for any pose of the camera."""

    def __init__(self, vertices: np.ndarray, world_T_solid: np.ndarray, name: str) -> None:
        """Store the solid.

        Args:
            vertices: (n, 3) vertices in the solid's frame, m.
            world_T_solid: (4, 4) pose of the solid.
            name: name of the solid, for messages.
        """
        self._points = vertices @ world_T_solid[:3, :3].T + world_T_solid[:3, 3]
        self._name = name

    def compute_plane(self, world_T_camera: np.ndarray) -> Plane:
        """Compute the plane in the frame of a camera with the pose world_T_camera (4, 4).

        Raises:
            TrackingModelError: a vertex is not in front of the camera, or no plane fits the
                outline.
        """
        points = self._points - world_T_camera[:3, 3]
        return fit_outline_plane(points @ world_T_camera[:3, :3], self._name)
