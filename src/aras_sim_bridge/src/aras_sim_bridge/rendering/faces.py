"""Sub-views drawn together: the whole picture, tiles of it, or the faces around a wide lens."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .raymap import RayMap
from .view import View

SHARED = np.eye(3)[None]


@dataclass(frozen=True)
class Faces:
    """F pinhole views from one eye, each filling a rectangle of one framebuffer.

    rotation: (F, 3, 3), optical frame to face frame, or None where all faces share it. May be
        any other matrix whose third row is a unit vector, along which depth is then measured.
    projection: (F, 4) a, b, c, d: a point is at (a x / z + b, c y / z + d) of its face,
        both within -1..1.
    placement: (F, 4) s, o, t, p: the face's point (x, y) is at (s x + o, t y + p) of the
        framebuffer, again within -1..1.
    """

    rotation: np.ndarray | None
    projection: np.ndarray
    placement: np.ndarray
    near: float
    far: float

    def __len__(self) -> int:
        return len(self.projection)

    @property
    def rotations(self) -> np.ndarray:
        """`rotation`, or (1, 3, 3) where all faces share the optical frame."""
        return SHARED if self.rotation is None else self.rotation

    @cached_property
    def normals(self) -> np.ndarray:
        """(F, 5, 3) in the optical frame: inward unit normals of the sides, and the axis."""
        a, b, c, d = self.projection.T
        n = np.zeros((len(a), 5, 3))
        n[:, 0, 0], n[:, 0, 2] = a, 1 + b
        n[:, 1, 0], n[:, 1, 2] = -a, 1 - b
        n[:, 2, 1], n[:, 2, 2] = c, 1 + d
        n[:, 3, 1], n[:, 3, 2] = -c, 1 - d
        n[:, 4, 2] = 1.0
        n /= np.sqrt((n * n).sum(axis=2, keepdims=True))
        return n if self.rotation is None else n @ self.rotation

    def window(self, face: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Low and high corners (2,) of a face in its plane, x / z and y / z."""
        a, b, c, d = self.projection[face]
        return np.array([(-1 - b) / a, (-1 - d) / c]), np.array([(1 - b) / a, (1 - d) / c])


WHOLE = np.array([[1.0, 0.0, 1.0, 0.0]])


def whole(view: View) -> Faces:
    """The view as one face that fills the framebuffer."""
    return Faces(None, _window(view.K, np.array([[0, 0]]), view.width, view.height), WHOLE,
                 view.near, view.far)


def tiles(view: View, origins: np.ndarray, size: int, columns: int, rows: int) -> Faces:
    """Square tiles of `size` px with corners `origins` (F, 2) u, v, in a columns x rows atlas."""
    return Faces(None, _window(view.K, origins, size, size),
                 grid(len(origins), columns, rows), view.near, view.far)


def rectangles(view: View, origins: np.ndarray, sizes: np.ndarray, places: np.ndarray,
               atlas_size: tuple[int, int]) -> Faces:
    """Rectangles of the view at `origins`, of `sizes`, at `places` of an atlas; (F, 2) px each."""
    return Faces(None, _window(view.K, origins, *sizes.T), _placement(*places.T, *sizes.T,
                                                                      atlas_size),
                 view.near, view.far)


def grid(count: int, columns: int, rows: int) -> np.ndarray:
    """Placements (count, 4) of equal squares, row by row."""
    n = np.arange(count)
    column, row = n % columns, n // columns
    return np.stack([np.full(count, 1 / columns), (2 * column + 1) / columns - 1,
                     np.full(count, 1 / rows), (2 * row + 1) / rows - 1], axis=1)


def _placement(x: np.ndarray, y: np.ndarray, width: np.ndarray, height: np.ndarray,
               atlas_size: tuple[int, int]) -> np.ndarray:
    """Placements (F, 4) of rectangles (F,) in an atlas, px."""
    w, h = atlas_size
    return np.stack([width / w, (2 * x + width) / w - 1,
                     height / h, (2 * y + height) / h - 1], axis=1)


def _window(K: np.ndarray, origins: np.ndarray, width: int | np.ndarray,
            height: int | np.ndarray) -> np.ndarray:
    """Projections (F, 4) of the pixel rectangles at `origins`; pixel edges are at -0.5."""
    out = np.empty((len(origins), 4))
    out[:, 0] = 2 * K[0, 0] / width
    out[:, 1] = (2 * (K[0, 2] - origins[:, 0]) + 1) / width - 1
    out[:, 2] = 2 * K[1, 1] / height
    out[:, 3] = (2 * (K[1, 2] - origins[:, 1]) + 1) / height - 1
    return out


def around(lens: RayMap, near: float, far: float) -> Faces:
    """The faces of a lens in its atlas."""
    projection = np.concatenate([
        _window(face.K(), np.zeros((1, 2)), *face.rectangle[2:]) for face in lens.faces
    ])
    rectangle = np.array([face.rectangle for face in lens.faces], float).T
    placement = _placement(*rectangle, lens.atlas_size)
    return Faces(np.array([f.rotation for f in lens.faces]), projection, placement, near, far)
