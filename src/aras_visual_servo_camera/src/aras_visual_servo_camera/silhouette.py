"""The outline of a solid in a view, and the plane in which it lies about.

Moments of a silhouette move as those of a flat target would whose points lie where the outline
touches the solid: what is behind it has no part (F. Chaumette, IEEE T-RO 20(4), 2004, III). Their
interaction matrix takes that outline as lying in a plane, 1/Z = A x + B y + C.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from .errors import ModelError
from .interaction import Plane

SILHOUETTE_SAMPLES = 360  # along the outline, at equal parts of its length
# rms part of its distance by which the outline may be off the plane. Of boxes up to 0.24 m high,
# seen from 0.25 m above and up to 0.12 m beside them, all runs of those with up to 0.088 and a
# height of up to 0.18 m converged, with 0.101 three of five lost the target.
MAX_PLANE_DEVIATION = 0.09


class Rim(NamedTuple):
    """Where the outline touches the solid.

    plane: that fits it best, least squares in 1/Z. deviation: rms of its distance along the optical
    axis from that plane, a part of the distance.
    """

    plane: Plane
    deviation: float


def find_silhouette_points(points: np.ndarray) -> np.ndarray:
    """Those (n, 3) of a solid's vertices (m, 3), m, in the camera's frame, that bound its view:
    the corners of its convex outline in order.

    Raises:
        ModelError: a point is not before the camera.
    """
    if not (points[:, 2] > 0.0).all():
        raise ModelError("the solid is behind the camera, or around it")
    seen = points[:, :2] / points[:, 2:]
    return points[cv2.convexHull(seen.astype(np.float32), returnPoints=False)[:, 0]]


def fit_rim(points: np.ndarray) -> Rim:
    """The plane of a solid's outline, of its vertices (m, 3), m, in the camera's frame.

    Raises:
        ModelError: as `find_silhouette_points`.
    """
    corners = find_silhouette_points(points)
    # Along a straight edge 1/Z is linear in the picture.
    ring = np.column_stack([corners[:, :2], np.ones(len(corners))]) / corners[:, 2:]
    steps = np.linalg.norm(np.diff(ring[:, :2], axis=0, append=ring[:1, :2]), axis=1)
    way = np.concatenate([[0.0], steps.cumsum()])
    closed, at = (
        np.vstack([ring, ring[:1]]),
        way[-1] * np.arange(SILHOUETTE_SAMPLES) / SILHOUETTE_SAMPLES,
    )
    x, y, nearness = (np.interp(at, way, column) for column in closed.T)
    rays = np.column_stack([x, y, np.ones(SILHOUETTE_SAMPLES)])
    plane = np.linalg.lstsq(rays, nearness, rcond=None)[0]
    deviation = float(np.sqrt(np.mean((rays @ plane / nearness - 1.0) ** 2)))
    return Rim(Plane(*plane.tolist()), deviation)


def fit_outline_plane(points: np.ndarray, name: str) -> Plane:
    """The plane of `fit_rim`; `name`: of the solid, for messages.

    Raises:
        ModelError: as `find_silhouette_points`, or no plane fits the outline.
    """
    plane, deviation = fit_rim(points)
    if deviation > MAX_PLANE_DEVIATION:
        off, most = 100.0 * deviation, 100.0 * MAX_PLANE_DEVIATION
        raise ModelError(
            f"no plane fits the outline of {name}, and moments need one: its depth is off by "
            f"{off:.0f} % of the distance (rms; {most:.0f} % are allowed): look from farther away, "
            "or along another of its sides, or take scheme 'model'"
        )
    return plane


class OutlinePlane:
    """The plane of a solid's outline, from wherever it is seen."""

    def __init__(self, vertices: np.ndarray, world_T_solid: np.ndarray, name: str) -> None:
        """`vertices`: (n, 3) m, in its frame. `world_T_solid`: (4, 4). `name`: for messages."""
        self._points = vertices @ world_T_solid[:3, :3].T + world_T_solid[:3, 3]
        self._name = name

    def compute_plane(self, world_T_camera: np.ndarray) -> Plane:
        """In the frame of a camera there (4, 4); ModelError as `fit_outline_plane`."""
        ahead = self._points - world_T_camera[:3, 3]
        return fit_outline_plane(ahead @ world_T_camera[:3, :3], self._name)
