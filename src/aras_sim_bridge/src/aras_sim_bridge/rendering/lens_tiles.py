"""Tiles of a picture through a lens, each drawn as if through a pinhole of its own.

Within a few pixels almost every lens is straight: a homography fitted to the rays of a tile's
pixels (64 of them) is right to a few hundredths of a pixel where a fisheye bends most. So a tile
with edges is drawn finer straight into the picture, without looking anything up.
"""

from __future__ import annotations

import numpy as np

from .faces import Faces, grid
from .raymap import RayMap
from .refinement import TILE, tile_origins

# Pixels with a ray that a tile needs; at the rim of a lens there are fewer.
FEWEST = 24
# How far a pixel may be beside its ray, px; more than this only where a lens ends at 90 degrees.
MOST_ASIDE = 0.08


_ACROSS = (2 * np.arange(TILE) + 1) / TILE - 1
# Pixel centres of a tile that runs over -1..1, (64, 2), row by row.
PIXELS = np.stack([np.tile(_ACROSS, TILE), np.repeat(_ACROSS, TILE)], axis=1)


class LensTiles:
    """The tiles of one lens, numbered row by row.

    usable: (N,) bool, whether enough pixels of the tile have rays, which its matrix follows.
    home: (N,) the lens's face in which the tile's centre is. low, high: (N, 2), its rectangle
        in the plane of that face, x / z and y / z.
    reach: the lens's faces, each widened to hold all its tiles; for finding out what they show.
    """

    def __init__(self, lens: RayMap, near: float, far: float) -> None:
        self._near, self._far = near, far
        u, v = tile_origins(lens.width, lens.height).T
        across = np.arange(TILE)
        rays = lens.rays[(v[:, None] + across)[:, :, None], (u[:, None] + across)[:, None, :]]
        rays = rays.reshape(len(u), TILE * TILE, 3)
        given = np.isfinite(rays[..., 0])
        self.usable = given.sum(axis=1) >= FEWEST
        rays = np.where(given[..., None], rays, 0.0)
        centre = rays.sum(axis=1)
        centre[~self.usable] = (0.0, 0.0, 1.0)
        centre /= np.linalg.norm(centre, axis=1, keepdims=True)
        given &= self.usable[:, None]
        self._matrix = _homographies(rays, given, centre)
        self.usable &= _aside(self._matrix, rays, given) <= MOST_ASIDE
        axes = np.array([face.rotation for face in lens.faces])
        self.home = (centre @ axes[:, 2].T).argmax(axis=1)
        p = rays @ axes[self.home].transpose(0, 2, 1)
        p = p[..., :2] / np.where(given, p[..., 2], 1.0)[..., None]
        self.low = np.where(given[..., None], p, np.inf).min(axis=1)
        self.high = np.where(given[..., None], p, -np.inf).max(axis=1)
        half_a_pixel = (self.high - self.low) / TILE
        self.low, self.high = self.low - half_a_pixel, self.high + half_a_pixel
        window = np.empty((len(axes), 2, 2))
        for n, face in enumerate(lens.faces):
            (x, y, w, h), f, c = face.rectangle, face.focal, face.centre
            own = self.usable & (self.home == n)
            corner = np.array([[x - c[0], y - c[1]], [x + w - c[0], y + h - c[1]]]) / f
            window[n, 0] = np.minimum(self.low[own].min(axis=0, initial=np.inf), corner[0])
            window[n, 1] = np.maximum(self.high[own].max(axis=0, initial=-np.inf), corner[1])
        size, middle = window[:, 1] - window[:, 0], window.sum(axis=1)
        projection = np.stack([2 / size[:, 0], -middle[:, 0] / size[:, 0],
                               2 / size[:, 1], -middle[:, 1] / size[:, 1]], axis=1)
        self.reach = Faces(axes, projection, np.tile([1.0, 0, 1, 0], (len(axes), 1)), near, far)

    def faces(self, number: np.ndarray, columns: int, rows: int) -> Faces:
        """Tiles (F,) by number, in a columns x rows atlas."""
        return Faces(self._matrix[number], np.tile([1.0, 0, 1, 0], (len(number), 1)),
                     grid(len(number), columns, rows), self._near, self._far)


def _homographies(rays: np.ndarray, given: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """(N, 3, 3) matrices that take rays to a tile's x, y, 1, which runs over -1..1.

    rays (N, P, 3), of which those given (N, P) count; centre (N, 3). The third row is a unit
    vector, so that it measures depth. Least squares of the linear equations, which are as good
    as the true ones where, as here, the denominators hardly differ.
    """
    x = np.cross(np.where(np.abs(centre[:, :1]) < 0.7, [[1.0, 0, 0]], [[0, 1.0, 0]]), centre)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    local = np.stack([x, np.cross(centre, x), centre], axis=1)
    p = rays @ local.transpose(0, 2, 1)
    p /= np.where(given, p[..., 2], 1.0)[..., None]
    size = np.abs(p[..., :2] * given[..., None]).max(axis=(1, 2))
    size[size == 0.0] = 1.0
    p[..., :2] /= size[:, None, None]
    p *= given[..., None]
    goal = PIXELS.T[:, None, :, None]
    rows = np.zeros((2, *p.shape[:2], 9))
    rows[0, ..., 0:3] = rows[1, ..., 3:6] = p
    rows[..., 6:9] = -goal * p
    normal = np.einsum("anpi,anpj->nij", rows, rows)
    H = np.linalg.eigh(normal)[1][:, :, 0].reshape(-1, 3, 3)
    H[:, :, :2] /= size[:, None, None]
    H = H @ local
    scale = np.linalg.norm(H[:, 2], axis=1)
    scale[(H[:, 2] * centre).sum(axis=1) < 0.0] *= -1.0
    scale[~given.any(axis=1)] = 1.0
    return H / scale[:, None, None]


def _aside(matrix: np.ndarray, rays: np.ndarray, given: np.ndarray) -> np.ndarray:
    """(N,) farthest that matrices (N, 3, 3) take given rays beside their pixels, px."""
    at = rays @ matrix.transpose(0, 2, 1)
    at = at[..., :2] / np.where(given, at[..., 2], 1.0)[..., None]
    distance = np.linalg.norm(at - PIXELS, axis=2) * (TILE / 2)
    return np.where(given, distance, 0.0).max(axis=1)
