"""Pictures through any lens: pinhole faces around the eye, and where each pixel looks them up."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from ..errors import RenderingError

# face_R_optical of the forward, right, left, lower, upper and backward faces of a cube.
CUBE = np.array([
    [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    [[0, 0, -1], [0, 1, 0], [1, 0, 0]],
    [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
    [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
    [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
    [[-1, 0, 0], [0, 1, 0], [0, 0, -1]],
], dtype=float)
# Up to this angle from the axis one flat face does, rad.
FLAT_LIMIT = np.radians(57.0)
# Face pixels for a picture pixel, where the pixels lie closer together than in this share of
# the face; cube faces are denser towards their edges by nature.
DENSITY = 1.2
CLOSEST = 30  # percent
MARGIN = 2.0  # px around a face, for interpolation
LARGEST = 8192  # px a side of a framebuffer; no driver refuses that


@dataclass(frozen=True)
class Face:
    """One pinhole view: rotation (3, 3) face_R_optical, its rectangle x, y, width, height in the
    atlas, px, and focal length and principal point in atlas coordinates, px."""

    rotation: np.ndarray
    rectangle: tuple[int, int, int, int]
    focal: float
    centre: tuple[float, float]

    def K(self) -> np.ndarray:
        """(3, 3), with the face's own first pixel as origin."""
        x, y = self.rectangle[:2]
        return np.array([[self.focal, 0, self.centre[0] - x], [0, self.focal, self.centre[1] - y],
                         [0, 0, 1.0]])


class RayMap:
    """The lens of a picture, as rays.

    unproject: (N, 2) pixels -> (N, 3) unit rays in the optical frame, NaN outside the lens.
    valid: (height, width) bool. lookup: (height, width, 2) float32, atlas pixels, -1e6 outside.
    """

    def __init__(self, unproject: Callable[[np.ndarray], np.ndarray], width: int, height: int,
                 density: float = DENSITY) -> None:
        self.unproject = unproject
        self.width, self.height = width, height
        v, u = np.mgrid[:height, :width]
        rays = unproject(np.stack([u.ravel(), v.ravel()], axis=1).astype(float))
        self.valid = np.isfinite(rays[:, 0]).reshape(height, width)
        if not self.valid.any():
            raise RenderingError("the lens shows nothing on any pixel of the image")
        self.rays = rays.reshape(height, width, 3)
        self.faces, self.atlas_size, face_of = self._lay_out(density)
        self.lookup = self._lookup(face_of)
        # Depth of the picture for a depth of 1 along the face's axis.
        self._depth: np.ndarray | None = None
        if len(self.faces) > 1:
            axes = np.array([f.rotation[2] for f in self.faces])[face_of]
            forward = self.rays[..., 2]
            with np.errstate(invalid="ignore"):
                depth = forward if (forward[self.valid] > 0.0).all() else 1.0
                self._depth = (depth / (self.rays * axes).sum(axis=2)).astype(np.float32)

    def _lay_out(self, density: float) -> tuple[list[Face], tuple[int, int], np.ndarray]:
        rays = self.rays[self.valid]
        flat = rays[:, 2].min() > np.cos(FLAT_LIMIT)
        directions = CUBE[:1] if flat else CUBE
        face_of = np.full(self.valid.shape, -1)
        face_of[self.valid] = 0 if flat else (rays @ CUBE[:, 2].T).argmax(axis=1)
        faces, boxes = [], []
        for number, rotation in enumerate(directions):
            mine = face_of == number
            if not mine.any():
                continue
            p = self.rays[mine] @ rotation.T
            p = p[:, :2] / p[:, 2:]
            focal = density / self._spacing(rotation, mine)
            low = np.floor(p.min(axis=0) * focal - MARGIN)
            size = np.ceil(p.max(axis=0) * focal + MARGIN) - low + 1
            boxes.append((number, rotation, focal, low, size.astype(int)))
        # Faces stand side by side, the tallest first.
        boxes.sort(key=lambda b: -b[4][1])
        places, (wide, high) = _shelves([size for *_, size in boxes])
        if max(wide, high) > LARGEST:
            raise RenderingError(
                f"the lens needs an intermediate picture of {wide} x {high} pixels; make the "
                "image smaller or the field of view narrower"
            )
        renumber = np.zeros(len(directions), int)
        for (number, rotation, focal, low, size), (x, y) in zip(boxes, places, strict=True):
            renumber[number] = len(faces)
            faces.append(Face(rotation, (x, y, int(size[0]), int(size[1])), focal,
                              (x - low[0], y - low[1])))
        face_of[self.valid] = renumber[face_of[self.valid]]
        return faces, (wide, high), face_of

    def _spacing(self, rotation: np.ndarray, mine: np.ndarray) -> float:
        """How far apart neighbouring pixels are on a face at unit focal length, where close."""
        p = self.rays @ rotation.T
        with np.errstate(invalid="ignore", divide="ignore"):
            p = p[..., :2] / p[..., 2:]
            across = np.hypot(*np.moveaxis(p[:, 1:] - p[:, :-1], 2, 0))[mine[:, 1:] & mine[:, :-1]]
            down = np.hypot(*np.moveaxis(p[1:] - p[:-1], 2, 0))[mine[1:] & mine[:-1]]
        steps = np.concatenate([across, down])
        return float(np.percentile(steps, CLOSEST)) if len(steps) else 0.01

    def _lookup(self, face_of: np.ndarray) -> np.ndarray:
        lookup = np.full((self.height, self.width, 2), -1e6, np.float32)
        for number, face in enumerate(self.faces):
            mine = face_of == number
            p = self.rays[mine] @ face.rotation.T
            lookup[mine] = p[:, :2] / p[:, 2:] * face.focal + face.centre
        return lookup

    def look_up(self, atlas: np.ndarray) -> np.ndarray:
        """(height, width) nearest values of an (atlas height, width) picture; 0 outside."""
        return cv2.remap(atlas, self.lookup, None, cv2.INTER_NEAREST)

    def look_up_depth(self, atlas: np.ndarray) -> np.ndarray:
        """Depth of the picture from depths along the faces' axes, m.

        Along the optical axis (REP 118) through a lens whose pixels all look forwards; where one
        looks sideways or back, so that this depth means little, the distance along the ray.
        """
        depth = self.look_up(atlas)
        if self._depth is None:
            return depth
        return depth * self._depth


def _shelves(sizes: list[np.ndarray]) -> tuple[list[tuple[int, int]], tuple[int, int]]:
    """Places x, y of rectangles (2,) side by side on shelves, and the width and height of all.

    The shelves are as narrow as keeps the height below LARGEST, if any width does.
    """
    limit = max(2048, *(int(size[0]) for size in sizes))
    while True:
        places = []
        x = y = shelf = wide = 0
        for width, height in (map(int, size) for size in sizes):
            if x + width > limit:
                x, y, shelf = 0, y + shelf, 0
            places.append((x, y))
            x, shelf = x + width, max(shelf, height)
            wide = max(wide, x)
        if y + shelf <= LARGEST or limit >= LARGEST:
            return places, (wide, y + shelf)
        limit = min(2 * limit, LARGEST)
