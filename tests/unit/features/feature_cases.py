"""Shapes, poses, a moving camera, and moments in exact arithmetic."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import comb

import cv2
import numpy as np

from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.moments import Moments, Pinhole

L_SHAPE = np.array([[-1, -1.2], [0, -1.2], [0, 0.4], [1, 0.4], [1, 1.2], [-1, 1.2]]) * 0.1
SQUARE = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * 0.1
RECTANGLE = SQUARE * [1.0, 0.6]
# The target of the robot: a square with a patch that breaks its symmetry
TARGET = np.array(
    [[-25, -25], [25, -25], [25, -7.5], [37.5, -7.5], [37.5, 17.5], [25, 17.5], [25, 25], [-25, 25]]
) / 1000.0  # fmt: skip


def rotation(axis_angle: np.ndarray) -> np.ndarray:
    return cv2.Rodrigues(np.asarray(axis_angle, dtype=float))[0]


@dataclass(frozen=True, eq=False)
class View:
    """Planar shape (n, 2), m, in its own frame, viewed with P_camera = R p + t."""

    shape: np.ndarray
    R: np.ndarray
    t: np.ndarray

    @property
    def points(self) -> np.ndarray:
        """Points (n, 3) in the camera frame, m."""
        return self.shape @ self.R[:, :2].T + self.t

    @property
    def image(self) -> np.ndarray:
        """Points (n, 2) in normalised image coordinates."""
        return self.points[:, :2] / self.points[:, 2:]

    @property
    def plane(self) -> Plane:
        return Plane.from_pose(self.R, self.t)

    def moved(self, twist: np.ndarray) -> View:
        """Return the view after the camera has moved by exp(twist): P' = R_c^T (P - t_c)."""
        turn = rotation(twist[3:])
        v, w = twist[:3], twist[3:]
        angle = np.linalg.norm(w)
        if angle > 0.0:
            S = np.cross(np.eye(3), w).T  # S @ p = w x p
            V = np.eye(3) + (1 - np.cos(angle)) / angle**2 * S
            V += (angle - np.sin(angle)) / angle**3 * S @ S
            v = V @ v
        return View(self.shape, turn.T @ self.R, turn.T @ (self.t - v))


def random_view(seed: int) -> View:
    """Return a random view of a star-shaped polygon of 4 to 9 corners, tilted up to 35 degrees."""
    random = np.random.default_rng(seed)
    n = int(random.integers(4, 10))
    angle = 2 * np.pi * (np.arange(n) + random.uniform(0, 0.6, n)) / n
    radius = random.uniform(0.04, 0.13, n)
    shape = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    tilt = random.uniform(-1, 1, 2) * np.deg2rad(35) / np.sqrt(2)
    R = rotation([tilt[0], tilt[1], 0]) @ rotation([0, 0, random.uniform(-np.pi, np.pi)])
    t = np.array([*random.uniform(-0.15, 0.15, 2), random.uniform(0.35, 0.9)])
    return View(shape, R, t)


def exact_moment(vertices: list[tuple[Fraction, Fraction]], p: int, q: int) -> Fraction:
    """Return m_pq of a polygon in rational numbers, by Steger's double sum (no quadrature)."""
    total = Fraction(0)
    for (x0, y0), (x1, y1) in zip(vertices, vertices[1:] + vertices[:1], strict=True):
        inner = sum(comb(k + m, m) * comb(p + q - k - m, q - m)
                    * x1**k * x0 ** (p - k) * y1**m * y0 ** (q - m)
                    for k in range(p + 1)
                    for m in range(q + 1))  # fmt: skip
        total += (x0 * y1 - x1 * y0) * inner
    return total / ((p + q + 2) * (p + q + 1) * comb(p + q, p))


def coverage_image(outline: np.ndarray, camera: Pinhole, size: tuple[int, int]) -> np.ndarray:
    """Return the fraction of each pixel (rows, columns) that the polygon covers, to 1/256."""
    finer = 16
    pixels = outline * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    first = np.maximum(np.floor(pixels.min(axis=0)).astype(int) - 1, 0)
    last = np.minimum(np.ceil(pixels.max(axis=0)).astype(int) + 2, size[::-1])
    columns, rows = last - first
    x = first[0] + (np.arange(columns * finer) + 0.5) / finer - 0.5
    y = first[1] + (np.arange(rows * finer) + 0.5) / finer - 0.5
    inside = _scan(pixels, x, y).reshape(rows, finer, columns, finer)
    result = np.zeros(size)
    result[first[1] : last[1], first[0] : last[0]] = inside.mean(axis=(1, 3))
    return result


def grey_image(outline: np.ndarray, camera: Pinhole, size=(240, 320), fg=0, bg=255) -> np.ndarray:
    """Return an 8-bit image of the polygon, with grey level `fg` on a background of `bg`."""
    return np.round(bg + (fg - bg) * coverage_image(outline, camera, size)).astype(np.uint8)


def finite_differences(function, view: View, step: float = 3e-4) -> np.ndarray:
    """Return d(function)/d(twist), (k, 6), by central differences of order six."""
    columns = []
    for axis in range(6):
        twist = np.zeros(6)
        total = 0.0
        for n, weight in ((1, 45 / 60), (2, -9 / 60), (3, 1 / 60)):
            twist[axis] = n * step
            total = total + weight * (function(view.moved(twist)) - function(view.moved(-twist)))
        columns.append(total / step)
    return np.stack(columns, axis=1)


def polygon_moments(view: View, order: int = 6) -> Moments:
    return Moments.from_polygon(view.image, order)


def point_moments(view: View, order: int = 6) -> Moments:
    return Moments.from_points(view.image, order)


def pixels_inside(outline: np.ndarray, camera: Pinhole, size: tuple[int, int]) -> np.ndarray:
    """Return a mask (rows, columns), uint8, of pixels whose centre is in the polygon (even-odd)."""
    rows, columns = size
    y, x = np.arange(rows), np.arange(columns)
    return _scan(outline * [camera.fx, camera.fy] + [camera.cx, camera.cy], x, y)


def _scan(polygon: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Apply the even-odd rule to a grid of points: each edge inverts all points on its right."""
    flips = np.zeros((len(y), len(x) + 1), dtype=np.uint8)
    for (px, py), (qx, qy) in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        lines = np.nonzero((py > y) != (qy > y))[0]
        cross = px + (y[lines] - py) / (qy - py) * (qx - px)
        np.bitwise_xor.at(flips, (lines, np.searchsorted(x, cross)), 1)
    return np.bitwise_xor.accumulate(flips[:, :-1], axis=1)
