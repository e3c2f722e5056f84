"""Silhouette of a solid in a view, and the plane that fits its outline best.

When the camera moves, the moments of a silhouette change as those of a flat target whose points are
where the outline touches the solid; the rest of the solid has no effect (F. Chaumette, IEEE T-RO
20(4), 2004, section III). The interaction matrix assumes that this outline lies in a plane,
1/Z = A x + B y + C.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from .errors import ModelError
from .interaction import Plane

SILHOUETTE_SAMPLES = 360  # at equal distances along the outline
# Largest rms deviation of the outline from the plane, relative to its distance. Measured on boxes
# up to 0.24 m high, seen from 0.25 m above and up to 0.12 m to the side: all runs with a deviation
# of up to 0.088 and a height of up to 0.18 m converged; with 0.101, three of five lost the target.
MAX_PLANE_DEVIATION = 0.09


class Rim(NamedTuple):
    """Best-fitting plane of the points where the outline touches the solid.

    plane: plane fitted by least squares in 1/Z.
    deviation: rms distance of the outline from the plane along the optical axis, relative to the
    depth.
    """

    plane: Plane
    deviation: float


def find_silhouette_points(points: np.ndarray) -> np.ndarray:
    """Return the corners (n, 3) of a solid's convex outline in a view, in order.

    Args:
        points: vertices (m, 3) of the solid in the camera's frame, m.

    Raises:
        ModelError: a point is not in front of the camera.
    """
    if not (points[:, 2] > 0.0).all():
        raise ModelError("the solid is behind the camera, or reaches behind it")
    image_points = points[:, :2] / points[:, 2:]
    return points[cv2.convexHull(image_points.astype(np.float32), returnPoints=False)[:, 0]]


def fit_rim(points: np.ndarray) -> Rim:
    """Fit a plane to the outline of a solid.

    Args:
        points: vertices (m, 3) of the solid in the camera's frame, m.

    Raises:
        ModelError: as in `find_silhouette_points`.
    """
    corners = find_silhouette_points(points)
    # Along a straight edge 1/Z is linear in the image.
    samples = np.column_stack([corners[:, :2], np.ones(len(corners))]) / corners[:, 2:]
    steps = np.linalg.norm(np.diff(samples[:, :2], axis=0, append=samples[:1, :2]), axis=1)
    arc_length = np.concatenate([[0.0], steps.cumsum()])
    closed, positions = (
        np.vstack([samples, samples[:1]]),
        arc_length[-1] * np.arange(SILHOUETTE_SAMPLES) / SILHOUETTE_SAMPLES,
    )
    x, y, inverse_depth = (np.interp(positions, arc_length, column) for column in closed.T)
    rays = np.column_stack([x, y, np.ones(SILHOUETTE_SAMPLES)])
    plane = np.linalg.lstsq(rays, inverse_depth, rcond=None)[0]
    deviation = float(np.sqrt(np.mean((rays @ plane / inverse_depth - 1.0) ** 2)))
    return Rim(Plane(*plane.tolist()), deviation)


def fit_outline_plane(points: np.ndarray, name: str) -> Plane:
    """Fit a plane to the outline of a solid, and check that it fits.

    Args:
        points: vertices (m, 3) of the solid in the camera's frame, m.
        name: name of the solid, for messages.

    Raises:
        ModelError: a point is not in front of the camera, or no plane fits the outline.
    """
    plane, deviation = fit_rim(points)
    if deviation > MAX_PLANE_DEVIATION:
        percent, allowed = 100.0 * deviation, 100.0 * MAX_PLANE_DEVIATION
        raise ModelError(
            f"no plane fits the outline of {name}, and moments need one: its depth is off by "
            f"{percent:.0f} % of the distance (rms; {allowed:.0f} % are allowed): look from "
            "farther away, or along another of its sides, or take scheme 'model'"
        )
    return plane


class OutlinePlane:
    """Plane of a solid's outline for any camera pose."""

    def __init__(self, vertices: np.ndarray, world_T_solid: np.ndarray, name: str) -> None:
        """Store the vertices in the world.

        Args:
            vertices: (n, 3) m, in the solid's frame.
            world_T_solid: (4, 4) pose of the solid.
            name: name of the solid, for messages.
        """
        self._points = vertices @ world_T_solid[:3, :3].T + world_T_solid[:3, 3]
        self._name = name

    def compute_plane(self, world_T_camera: np.ndarray) -> Plane:
        """Compute the plane in the frame of a camera with the pose (4, 4).

        Raises:
            ModelError: as in `fit_outline_plane`.
        """
        points = self._points - world_T_camera[:3, 3]
        return fit_outline_plane(points @ world_T_camera[:3, :3], self._name)
