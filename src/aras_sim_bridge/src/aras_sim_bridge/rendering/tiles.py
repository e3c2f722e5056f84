"""Division of an image into tiles, each with its own pinhole model.

For a pinhole camera the models are exact. For any other lens, the model of a tile is the projective
map through the rays of its four corners, shifted by its mean error over the tile. If an error is
still larger than LARGEST_MISFIT pixels, all tiles are divided into 2 x 2, 4 x 4 or 8 x 8 cells, and
each cell gets its own model.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import cached_property

import numpy as np

from aras_visual_servo_base.memory import ByteLimitedCache

from ..errors import RenderingError

TILE = 8  # side of a tile, px
# Values that a tile or pixel has instead of the index of one triangle.
BACKGROUND, NOTHING, SEVERAL = -1, -2, -3
# Largest distance between the approximated and the exact position of a pixel, px. The errors at the
# centre and at the corners of a cell have opposite signs, so that they largely cancel in a mean
# over many pixels (measured in tests/benchmarks/render.py).
LARGEST_MISFIT = 0.05
# Largest focal length, px. Also the largest ratio of a pixel's distance from the principal point to
# the focal length. Within these limits, the rays of neighbouring pixels differ by far more than the
# rounding error.
FARTHEST = 1e8
# If all rays are within this angle of the optical axis, rad, depth is measured along the optical
# axis; otherwise each tile has its own axis.
SIDEWAYS_ANGLE = np.radians(89.9)

Unproject = Callable[[np.ndarray], np.ndarray]
# Size of the cache for tiles, bytes, and largest image whose tiles are cached, px. The cache is
# worthwhile because a study renders thousands of images with the same camera.
CACHE_BYTES, LARGEST_CACHED_IMAGE = 3 << 21, 640 * 480


class Tiles:
    """Rays of the pixels of an image that is divided into tiles.

    The tiles are the leaves of a tree, in which each other node has up to 4 x 4 children.

    Attributes:
        width, height: size of the image, px.
        is_uniform: whether the rays of all tiles differ only by a shift, as for a pinhole camera.
        columns, rows: numbers of columns and rows of tiles.
        cells: number of cells along each side of a tile.
        matrices: (rows * columns * cells**2, 3, 3) pinhole model of each cell. A pixel that is x
            columns and y rows away from the cell's first pixel has the ray matrix @ (x, y, 1), of
            any length. Tiles are stored row by row, as are the cells of a tile.
        inverse: (rows * columns, 3, 3) map from rays to pixels, one matrix per tile. A ray is
            mapped to a positive multiple of (x, y, 1), where x and y count from the tile's first
            pixel.
        spread: (rows * columns,) largest error of the pixels from `inverse`, px; inf if unknown.
        axis: (rows * columns, 3) axis along which near, far and depth are measured in each tile.
        forward: whether `axis` is the optical axis in all tiles.
        valid: (rows * TILE, columns * TILE) bool, whether a pixel is in the image and in the lens.
        whole: (rows * columns,) bool, whether a tile has only valid pixels.
        nodes: (M, 5) for each node of the tree, the cone around its rays: axis, cosine and sine of
            the half angle. A cosine of 2 marks a node without valid pixels. The tiles are the first
            nodes.
        levels: (L, 4) for each level of the tree, starting with the tiles: index of its first node
            in `nodes`, its numbers of rows and columns, and index of its first node in `children`.
        children: (M - tiles, 5, 16) for each node above the tiles, the cones of its children.
        widest: 1 / cosine of the widest angle between a ray and the axis of its tile.
    """

    def __init__(self, width: int, height: int, matrices: np.ndarray, cells: int,
                 valid: np.ndarray, unproject: Unproject | None = None) -> None:
        self._unproject = unproject
        self.is_uniform = unproject is None
        self.width, self.height, self.cells = width, height, cells
        self.rows, self.columns = valid.shape[0] // TILE, valid.shape[1] // TILE
        self.matrices, self.valid = matrices, valid
        blocks = valid.reshape(self.rows, TILE, self.columns, TILE)
        has_valid = blocks.any(axis=(1, 3)).reshape(-1)
        self.whole = blocks.all(axis=(1, 3)).reshape(-1)
        # Compute the unit rays `around` of the four corners of each cell. The corners are half a
        # pixel outside the centres of the outer pixels.
        end = TILE // cells - 0.5
        square = np.array([[-0.5, end, -0.5, end], [-0.5, -0.5, end, end], np.ones(4)])
        around = (matrices @ square).reshape(-1, cells, cells, 3, 4).transpose(1, 2, 4, 0, 3)
        around = around / np.maximum(np.linalg.norm(around, axis=-1, keepdims=True), 1e-300)
        outer = around[0, 0, 0], around[0, -1, 1], around[-1, 0, 2], around[-1, -1, 3]
        around = around.reshape(4 * cells * cells, -1, 3)
        middle = np.sum(outer, axis=0)
        middle[~has_valid] = (0.0, 0.0, 1.0)
        middle /= np.linalg.norm(middle, axis=1, keepdims=True)
        cosine = np.clip((around * middle).sum(axis=2).min(axis=0), -1.0, 1.0)
        self.forward = bool((around[:, has_valid, 2] > np.cos(SIDEWAYS_ANGLE)).all())
        self.axis = np.tile([0.0, 0.0, 1.0], (len(middle), 1)) if self.forward else middle
        self.widest = 1.0 / float((around * self.axis).sum(axis=2)[:, has_valid].min())
        self.inverse, self.spread = self._fit_one_cell(np.stack(outer))
        self.nodes, self.levels, self.children = _build_tree(
            middle, np.arccos(cosine), has_valid, self.rows, self.columns
        )

    @classmethod
    def of_pinhole(cls, width: int, height: int, K: np.ndarray) -> Tiles:
        """Return the tiles of a pinhole image with the camera matrix K (3, 3), which has no skew.

        Raises:
            RenderingError: the focal lengths are too large, or the principal point is too far away.
        """
        fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
        if not (max(fx, fy) <= FARTHEST and max(abs(cx), abs(cy), width, height)
                <= FARTHEST * min(fx, fy)):
            raise RenderingError(
                f"a pinhole camera with fx={fx:g} fy={fy:g} cx={cx:g} cy={cy:g} px cannot be "
                f"drawn: fx and fy must be at most {FARTHEST:g} px, and cx, cy and the image size "
                f"at most {FARTHEST:g} times fx and fy")
        columns, rows = -(-width // TILE), -(-height // TILE)
        u, v = np.arange(columns) * TILE - K[0, 2], np.arange(rows) * TILE - K[1, 2]
        matrices = np.zeros((rows, columns, 3, 3))
        matrices[..., 0, 0], matrices[..., 1, 1] = 1 / K[0, 0], 1 / K[1, 1]
        matrices[..., 0, 2], matrices[..., 1, 2] = u / K[0, 0], v[:, None] / K[1, 1]
        matrices[..., 2, 2] = 1.0
        return cls(width, height, matrices.reshape(-1, 3, 3), 1,
                   _mark_inside(width, height, rows, columns))

    @classmethod
    def of_lens(cls, width: int, height: int, unproject: Unproject) -> Tiles:
        """Return the tiles of an image through a lens.

        Args:
            width, height: size of the image, px.
            unproject: function that returns the unit rays (N, 3) of pixels (N, 2) in the optical
                frame, NaN outside the lens.

        Raises:
            RenderingError: no pixel is inside the lens.
        """
        columns, rows = -(-width // TILE), -(-height // TILE)
        valid = _mark_inside(width, height, rows, columns)
        u, v = (np.append(np.arange(0, n - 1, TILE), n - 1) for n in (width, height))
        coarse = np.stack(np.meshgrid(u, v), axis=2).reshape(-1, 2).astype(float)
        forward = np.nan_to_num(unproject(coarse)[:, 2], nan=-2.0)
        best, centre = forward.max(), coarse[forward.argmax()]
        # -2 marks a tile corner outside the image circle. The circle is a disc, so if all corners
        # of a tile are inside, all its pixels are inside, too.
        if forward.min() == -2.0:
            best = -2.0
            for row in range(height):  # one row at a time, to limit the memory for large images
                pixels = np.stack([np.arange(width), np.full(width, row)], axis=1).astype(float)
                forward = np.nan_to_num(unproject(pixels)[:, 2], nan=-2.0)
                valid[row, :width] = forward > -2.0
                if forward.max() > best:
                    best, centre = forward.max(), pixels[forward.argmax()]
        if best == -2.0:
            raise RenderingError("the lens model gives no ray for any pixel of the image; correct "
                                 "the camera matrix or the distortion")
        lens = ExtrapolatedLens(unproject, centre)
        for cells in (1, 2, 4, 8):
            size = TILE // cells
            # Compute the models of all cells of a tile that has a valid pixel, because the cone
            # around the tile's rays must contain all its cells.
            tiles = valid.reshape(rows, TILE, columns, TILE).any(axis=(1, 3))
            corners = lens.corner_rays(np.kron(tiles, np.ones((cells, cells))) > 0, size)
            a, b, c, d = corners[:-1, :-1], corners[:-1, 1:], corners[1:, :-1], corners[1:, 1:]
            matrices = _fit_matrices(a, b, c, d, size)
            # Measure the error only in cells that are completely inside the lens, because the
            # corners of other cells are extrapolated.
            inner = valid.reshape(rows * cells, size, columns * cells, size).all(axis=(1, 3))
            at = np.linalg.solve(matrices[inner], lens.centre_rays(inner, size)[..., None])[..., 0]
            errors = at[:, :2] / at[:, 2:] - (size - 1) / 2
            # Shift each cell by its mean error. This is two thirds of the error at the cell's
            # centre, because the error grows quadratically from 0 at the corners.
            matrices[inner, :, 2] += (matrices[inner, :, :2] @ (errors[..., None] * 2 / 3))[..., 0]
            if (
                cells == 8
                or 2 / 3 * np.linalg.norm(errors, axis=1).max(initial=0.0) <= LARGEST_MISFIT
            ):
                break
        matrices = matrices.reshape(rows, cells, columns, cells, 3, 3).swapaxes(1, 2)
        return cls(width, height, np.ascontiguousarray(matrices).reshape(-1, 3, 3), cells, valid,
                   unproject)

    @cached_property
    def exact(self) -> np.ndarray:
        """Exact unit rays (height, width, 3) of the pixel centres, float32; NaN outside the lens.

        They are computed with the lens model. For a pinhole camera the array is empty, because the
        rays of `compute_rays` are already exact.
        """
        if self._unproject is None:
            return np.empty((0, self.width, 3), np.float32)
        out = np.empty((self.height, self.width, 3), np.float32)
        u = np.arange(self.width, dtype=float)
        for v in range(self.height):  # one row at a time, to limit the memory for large images
            out[v] = self._unproject(np.column_stack([u, np.full(self.width, float(v))]))
        return out

    def compute_rays(self) -> np.ndarray:
        """Return the unit rays (height, width, 3) of the pixel centres; NaN outside the lens.

        They are computed with the pinhole models of the cells.
        """
        n, size = self.cells, TILE // self.cells
        x, y = np.meshgrid(np.arange(size), np.arange(size))
        pixels = np.stack([x, y, np.ones_like(x)], axis=2).astype(float)
        cells = self.matrices.reshape(self.rows, self.columns, n, n, 3, 3)
        rays = np.einsum("rcijkl,yxl->riycjxk", cells, pixels)
        rays = rays.reshape(self.rows * TILE, self.columns * TILE, 3)
        rays /= np.linalg.norm(rays, axis=2, keepdims=True)
        rays[~self.valid] = np.nan
        return rays[:self.height, :self.width]

    def _fit_one_cell(self, outer: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute the map from rays to pixels of each tile, and the largest error of this map.

        Args:
            outer: (4, tiles, 3) unit rays of the tiles' corners.

        Returns:
            The attributes `inverse` (tiles, 3, 3) and `spread` (tiles,), px.
        """
        n, size = self.cells, TILE // self.cells
        one = self.matrices if n == 1 else _fit_matrices(*outer, TILE)
        flat = np.abs(np.linalg.det(one)) < 1e-18
        inverse = np.linalg.inv(np.where(flat[:, None, None], np.eye(3), one))
        spread = np.where(flat, np.inf, 0.0)
        if n > 1:
            cells = self.matrices.reshape(-1, n, n, 3, 3)
            at = np.arange(n) * size
            for x in (-0.5, (size - 1) / 2, size - 0.5):
                for y in (-0.5, (size - 1) / 2, size - 0.5):
                    mapped = np.einsum("tij,tvujk,k->tvui", inverse, cells, [x, y, 1.0])
                    with np.errstate(all="ignore"):
                        errors = np.hypot(mapped[..., 0] / mapped[..., 2] - at - x,
                                         mapped[..., 1] / mapped[..., 2] - at[:, None] - y)
                    errors[~((mapped[..., 2] > 0.0) & np.isfinite(errors))] = np.inf
                    spread = np.maximum(spread, errors.max(axis=(1, 2)))
        # The errors were tested at nine points of each cell; the factor 1.5 allows for larger
        # errors between these points.
        return inverse, 1.5 * spread + 1e-6

    @property
    def nbytes(self) -> int:
        """Memory that the arrays of this object use, bytes."""
        return sum(one.nbytes for one in (self.matrices, self.axis, self.inverse, self.valid,
                                         self.nodes, self.children))


class ExtrapolatedLens:
    """Rays of a lens, extrapolated linearly for pixels outside the image circle.

    `centre` (2,) is a pixel inside the image circle. Every straight line from this pixel leaves the
    circle once and does not enter it again.
    """

    def __init__(self, unproject: Unproject, centre: np.ndarray) -> None:
        self._unproject, self._centre = unproject, centre

    def corner_rays(self, visible: np.ndarray, size: int) -> np.ndarray:
        """Return unit rays (rows + 1, columns + 1, 3) of the corners of cells of `size` px.

        Corners are computed only for the cells where `visible` (rows, columns) is True; the other
        corners get the ray (0, 0, 1).
        """
        needed = np.zeros((visible.shape[0] + 1, visible.shape[1] + 1), bool)
        for down, across in ((0, 0), (0, 1), (1, 0), (1, 1)):
            needed[down:down + visible.shape[0], across:across + visible.shape[1]] |= visible
        out = np.tile([0.0, 0.0, 1.0], (*needed.shape, 1))
        out[needed] = self.compute_rays(np.argwhere(needed)[:, ::-1] * float(size) - 0.5)
        return out

    def centre_rays(self, visible: np.ndarray, size: int) -> np.ndarray:
        """Return unit rays (N, 3) of the centres of cells of `size` px.

        `visible` (rows, columns) is True for the N cells whose rays are returned.
        """
        return self.compute_rays((np.argwhere(visible)[:, ::-1] + 0.5) * size - 0.5)

    def compute_rays(self, points: np.ndarray) -> np.ndarray:
        """Return unit rays (N, 3) of pixels (N, 2), extrapolated outside the image circle."""
        rays = self._unproject(points)
        beyond = ~np.isfinite(rays[:, 0])
        if not beyond.any():
            return rays
        direction = points[beyond] - self._centre
        near, far = np.zeros(len(direction)), np.ones(len(direction))
        for _ in range(30):
            share = (near + far) / 2
            is_inside = np.isfinite(
                self._unproject(self._centre + share[:, None] * direction)[:, 0]
            )
            near, far = np.where(is_inside, share, near), np.where(is_inside, far, share)
        length = np.linalg.norm(direction, axis=1)
        back = np.maximum(near - 0.01 / np.maximum(length, 1e-9), 0.0)
        rim, inner = (self._unproject(self._centre + share[:, None] * direction)
                      for share in (near, back))
        rate = (rim - inner) / np.maximum(near - back, 1e-12)[:, None]
        # Do not extrapolate farther than two tiles beyond the image circle: a tile with a more
        # distant corner has no pixel inside the circle.
        share = np.minimum(1.0 - near, 2 * TILE / np.maximum(length, 1e-9))
        extrapolated = rim + share[:, None] * rate
        rays[beyond] = extrapolated / np.linalg.norm(extrapolated, axis=1, keepdims=True)
        return rays


def get_shared_tiles(width: int, height: int, key: Hashable, make: Callable[[], Tiles]) -> Tiles:
    """Return the tiles of an image of this size, from a cache that all renderers share.

    If the cache does not contain them, `make` creates them. Images with the same `key` and size
    have the same rays.
    """
    if width * height > LARGEST_CACHED_IMAGE:
        return make()
    return _cache.get((width, height, key), make)


_cache: ByteLimitedCache[Hashable, Tiles] = ByteLimitedCache(CACHE_BYTES)


def _mark_inside(width: int, height: int, rows: int, columns: int) -> np.ndarray:
    valid = np.zeros((rows * TILE, columns * TILE), bool)
    valid[:height, :width] = True
    return valid


def _fit_matrices(
    a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray, size: int
) -> np.ndarray:
    """Return the pinhole models (..., 3, 3) of cells of `size` px from the rays of their corners.

    A model maps a pixel (x, y, 1) of the cell to its ray.

    Args:
        a, b, c, d: (..., 3) rays of the upper left, upper right, lower left and lower right corner.
        size: side of a cell, px.
    """
    sides = np.stack([-a, b, c], axis=-1)
    # A cell without valid pixels may have coinciding corner rays, from which no model follows.
    flat = np.abs(np.linalg.det(sides)) < 1e-18
    sides[flat] = np.eye(3)
    weight = np.linalg.solve(sides, d[..., None])[..., 0]
    weight[flat] = 1.0
    first, right, down = (weight[..., k, None] * ray for k, ray in enumerate((a, b, c)))
    x, y = (right - first) / size, (down - first) / size
    return np.stack([x, y, first + (x + y) / 2], axis=-1)


def _build_tree(axis: np.ndarray, angle: np.ndarray, visible: np.ndarray, rows: int, columns: int
          ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Build the tree of an image with rows x columns tiles.

    Args:
        axis: (tiles, 3) axis of the cone around the rays of each tile.
        angle: (tiles,) half angle of this cone, rad.
        visible: (tiles,) bool, whether a tile has a valid pixel.
        rows, columns: numbers of rows and columns of tiles.

    Returns:
        The attributes `nodes`, `levels` and `children` of Tiles.
    """
    nodes, levels, children = [], [], [np.zeros((0, 5, 16))]
    first = joined = 0
    axis, angle = axis.reshape(rows, columns, 3), angle.reshape(rows, columns)
    visible = visible.reshape(rows, columns)
    # `tile`, `wide` and `shown` are the axes, half angles and validity of the tiles; `axis`,
    # `angle` and `visible` are those of the nodes of the present level. A node spans `span` x
    # `span` tiles.
    tile, wide, shown, span = axis * visible[..., None], angle, visible, 1
    while True:
        limit = np.minimum(angle + 1e-9, np.pi)
        cones = np.concatenate([axis, np.cos(limit)[..., None], np.sin(limit)[..., None]], axis=2)
        cones[~visible] = (0.0, 0.0, 1.0, 2.0, 0.0)
        nodes.append(cones.reshape(-1, 5))
        levels.append((first, rows, columns, joined))
        if levels[1:] and rows == columns == 1:
            return np.concatenate(nodes), np.array(levels), np.concatenate(children)
        first += rows * columns
        joined += rows * columns if levels[1:] else 0
        rows, columns = -(-rows // 4), -(-columns // 4)
        cones, some = (_group_by_fours(x, rows, columns) for x in (cones, visible))
        cones[~some] = (0.0, 0.0, 1.0, 2.0, 0.0)
        children.append(cones.reshape(-1, 16, 5).swapaxes(1, 2))
        visible, span = some.any(axis=2), 4 * span
        v, u = (np.arange(0, n, span) for n in shown.shape)
        axis = np.add.reduceat(np.add.reduceat(tile, v, axis=0), u, axis=1)
        norm = np.linalg.norm(axis, axis=2, keepdims=True)
        axis = np.where(norm > 1e-6, axis / np.maximum(norm, 1e-6), [0.0, 0.0, 1.0])
        own = axis.repeat(span, axis=0)[:len(tile)].repeat(span, axis=1)[:, :tile.shape[1]]
        apart = np.arccos(np.clip((tile * own).sum(axis=2), -1.0, 1.0))
        angle = np.where(shown, apart + wide, 0.0)
        angle = np.maximum.reduceat(np.maximum.reduceat(angle, v, axis=0), u, axis=1)


def _group_by_fours(x: np.ndarray, rows: int, columns: int) -> np.ndarray:
    """Return x (a, b, ...) in groups of 4 x 4 as (rows, columns, 16, ...), padded with zeros."""
    pad = [(0, 4 * rows - x.shape[0]), (0, 4 * columns - x.shape[1])]
    x = np.pad(x, pad + [(0, 0)] * (x.ndim - 2)).reshape(rows, 4, columns, 4, *x.shape[2:])
    return x.swapaxes(1, 2).reshape(rows, columns, 16, *x.shape[4:])
