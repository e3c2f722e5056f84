"""Shapes of a 3-D drawing for rviz and for the web pages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from aras_visual_servo_camera.camera_model import CameraModel

Rgba = tuple[float, float, float, float]

LINES, STRIP, ARROW, TEXT, FACES = "lines", "strip", "arrow", "text", "faces"
# Largest half angle of view of a drawn camera, rad. For a larger angle, such as that of a fisheye
# lens, the camera could not be drawn as a pyramid.
MAX_VIEW_ANGLE = np.radians(70.0)
# Number of decimals of lengths in m that are sent to the web page with the 3-D view, where a pixel
# is about 1 mm.
DIGITS = 5
# Number of points on each side of the border of an image. There are several, because lens
# distortion can bend the border.
POINTS_PER_SIDE = 8


@dataclass(frozen=True, eq=False)
class DrawingShape:
    """One shape of a drawing.

    Attributes:
        name: identifier of the shape, which does not change from one drawing to the next.
        kind: what the points mean. LINES: two ends of each line. STRIP: points of a curve. ARROW:
            tail and tip. TEXT: position of the text. FACES: three corners of each triangle.
        points: (n, 3) in the frame of the arm's base, m; empty if the shape is not visible.
        colour: red, green, blue and opacity, 0 to 1.
        width: width of lines or of an arrow's shaft, or height of letters, m.
        text: text of a shape of the kind TEXT.
    """

    name: str
    kind: str
    points: np.ndarray
    colour: Rgba
    width: float = 0.004
    text: str = ""

    def to_json(self) -> dict[str, Any]:
        """Return the shape as a JSON object for the script scene.js, which draws it.

        Coordinates are rounded to 10 um.
        """
        return {
            "kind": self.kind, "points": np.round(self.points, DIGITS).ravel().tolist(),
            "colour": list(self.colour), "width": self.width,
        }  # fmt: skip


def transform_points(a_T_b: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Transform points (n, 3) from frame b to frame a."""
    return np.asarray(points, float).reshape(-1, 3) @ a_T_b[:3, :3].T + a_T_b[:3, 3]


def make_axes(
    name: str, base_T_frame: np.ndarray, length: float, opacity: float = 1.0
) -> list[DrawingShape]:
    """Return the axes of a frame as shapes; x is red, y is green, z is blue."""
    shapes = []
    for i, letter in enumerate("xyz"):
        colour = tuple(0.95 if i == j else 0.25 for j in range(3))
        tip = np.zeros((2, 3))
        tip[1, i] = length
        shapes.append(DrawingShape(f"{name} {letter}", LINES, transform_points(base_T_frame, tip),
                                   (*colour, opacity), 0.05 * length))  # fmt: skip
    return shapes


def compute_image_border(camera: CameraModel) -> np.ndarray:
    """Return points (n, 2) on the border of the camera's image, in normalised coordinates.

    Points at a larger angle to the optical axis than MAX_VIEW_ANGLE are replaced by points at this
    angle.
    """
    right, low = camera.width - 0.5, camera.height - 0.5
    corners = np.array([[-0.5, -0.5], [right, -0.5], [right, low], [-0.5, low]])
    along = np.linspace(0.0, 1.0, POINTS_PER_SIDE, endpoint=False)[:, None]
    pixels = np.vstack([
        a + along * (b - a) for a, b in zip(corners, np.roll(corners, -1, 0), strict=True)
    ])  # fmt: skip
    x, y, valid = camera.normalise(*pixels.T)
    middle = pixels - [camera.pinhole.cx, camera.pinhole.cy]
    direction = middle / np.linalg.norm(middle, axis=1, keepdims=True)
    farthest = np.tan(MAX_VIEW_ANGLE)
    within = valid & (np.hypot(x, y) < farthest)
    return np.where(within[:, None], np.stack([x, y], 1), direction * farthest)


def place_on_image_plane(border: np.ndarray, points: np.ndarray, size: float) -> np.ndarray:
    """Place points on the image that is drawn in front of the camera.

    Args:
        border: (m, 2) border of the image, from `compute_image_border`.
        points: (n, 2) points in normalised image coordinates.
        size: distance from the optical centre to the farthest corner of the drawn image, m.

    Returns:
        Points (n, 3) in the camera's frame, m.
    """
    depth = size / float(np.sqrt(1.0 + (border**2).sum(axis=1).max()))
    points = np.asarray(points, float).reshape(-1, 2)
    return depth * np.column_stack([points, np.ones(len(points))])


def make_frustum(
    name: str, base_T_camera: np.ndarray, border: np.ndarray, size: float, colour: Rgba
) -> list[DrawingShape]:
    """Return a camera as shapes: a pyramid whose base is the border of the image.

    Args:
        name: prefix of the shapes' names.
        base_T_camera: (4, 4) pose of the camera.
        border: (n, 2) border of the image, from `compute_image_border`.
        size: distance from the optical centre to the farthest corner of the image, m.
        colour: red, green, blue and opacity, 0 to 1.
    """
    image_border = place_on_image_plane(border, border, size)
    edges = np.zeros((8, 3))
    edges[1::2] = image_border[::POINTS_PER_SIDE]
    closed = np.vstack([image_border, image_border[:1]])
    return [
        DrawingShape(f"{name} edges", LINES, transform_points(base_T_camera, edges), colour, 0.002),
        DrawingShape(
            f"{name} picture", STRIP, transform_points(base_T_camera, closed), colour, 0.003
        ),
    ]
