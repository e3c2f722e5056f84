"""Division of an image into tiles, each with its own pinhole model.

For a pinhole camera the tiles are exact. For any other lens, the model of a tile is the projective
map through the rays of its four corners. The map is then shifted by its mean error. If the
remaining error exceeds LARGEST_MISFIT, the tile is divided into cells, and each cell gets a model
of this kind.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import cached_property

import numpy as np

from aras_visual_servo_base.memory import ByteLimitedCache

from ..errors import RenderingError

TILE = 8  # side of a tile, px
# Largest distance between a pixel's approximated and correct positions, px. The errors at the
# centre and at the corners of a cell have opposite signs. Therefore the mean error over the image
# of a target is far smaller: see tests/benchmarks/render.py.
LARGEST_MISFIT = 0.05
# Largest focal length (px), and largest distance of a pixel from the optical axis (focal lengths).
# Within these limits, the rays of neighbouring pixels differ by far more than the rounding error.
FARTHEST = 1e8
# Largest angle between a ray and the optical axis at which depth is measured along this axis in all
# tiles, rad.
SIDEWAYS_ANGLE = np.radians(89.9)

Unproject = Callable[[np.ndarray], np.ndarray]
# Size of the cache for tiles (bytes), and largest image whose tiles are cached (px). A study
# renders ten thousand images with the same camera.
CACHE_BYTES, LARGEST_CACHED_IMAGE = 3 << 21, 640 * 480


class Tiles:
    """Rays of the pixels of an image that is divided into tiles.

    The tiles form a tree: each node above the tiles joins 4 x 4 nodes of the level below.

    Attributes:
        width, height: size of the image, px.
        is_uniform: whether the rays of all tiles differ only by a shift, as for a pinhole camera.
        columns, rows: numbers of columns and rows of tiles.
        cells: number of cells along each side of a tile.
        matrices: (rows * columns * cells**2, 3, 3) pinhole model of each cell. The ray of the pixel
            x, y is matrix @ (x, y, 1), where x and y are relative to the centre of the cell's first
            pixel. The ray has an arbitrary length. Tiles are stored row by row, as are the cells of
            a tile.
        inverse: (rows * columns, 3, 3) inverse pinhole model of each whole tile. It maps a ray to a
            positive multiple of (x, y, 1), where x and y are relative to the tile's first pixel.
        spread: (rows * columns,) largest error of `inverse`, px; inf if it is unknown.
        axis: (rows * columns, 3) axis along which near, far and depth are measured in each tile.
        forward: whether `axis` is the optical axis in all tiles.
        valid: (rows * TILE, columns * TILE) bool, whether a pixel is in the image and in the lens.
        whole: (rows * columns,) bool, whether a tile has only valid pixels.
        nodes: (M, 5) for each node of the tree, the cone around its rays: axis, cosine and sine of
            the angle. A cosine of 2 marks a node without valid pixels. The first nodes are the
            tiles.
        levels: (L, 4) for each level of the tree: index of its first node, its numbers of rows and
            columns, and its first index in `children`. Level 0 consists of the tiles.
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
        # Compute the rays of the four corners of each cell.
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
            RenderingError: the focal lengths or the principal point exceed FARTHEST.
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
        # The image circle is a disc, so a tile can contain pixels outside the circle only if a
        # corner of the tile is outside.
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
        lens = _ExtrapolatedLens(unproject, centre)
        for cells in (1, 2, 4, 8):
            size = TILE // cells
            # Fit all cells of each tile that has a valid pixel, because the tile's cone must
            # contain all its cells.
            tiles = valid.reshape(rows, TILE, columns, TILE).any(axis=(1, 3))
            corners = lens.corner_rays(np.kron(tiles, np.ones((cells, cells))) > 0, size)
            a, b, c, d = corners[:-1, :-1], corners[:-1, 1:], corners[1:, :-1], corners[1:, 1:]
            matrices = _fit_matrices(a, b, c, d, size)
            # Measure the error only in cells inside the lens: cells at the rim of the lens have
            # corners outside.
            inner = valid.reshape(rows * cells, size, columns * cells, size).all(axis=(1, 3))
            at = np.linalg.solve(matrices[inner], lens.centre_rays(inner, size)[..., None])[..., 0]
            errors = at[:, :2] / at[:, 2:] - (size - 1) / 2
            # Shift each cell by its mean error: two thirds of the error at the cell's centre.
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

        They are computed with the lens model, not with the cells. The array is empty for a pinhole,
        because its cells are exact.
        """
        if self._unproject is None:
            return np.empty((0, self.width, 3), np.float32)
        out = np.empty((self.height, self.width, 3), np.float32)
        u = np.arange(self.width, dtype=float)
        for v in range(self.height):  # one row at a time, to limit the memory for large images
            out[v] = self._unproject(np.column_stack([u, np.full(self.width, float(v))]))
        return out

    def compute_rays(self) -> np.ndarray:
        """Return the unit rays (height, width, 3) of the pixel centres; NaN outside the lens."""
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
        """Return the attributes `inverse` and `spread` of all tiles.

        `outer` (4, tiles, 3) are unit rays of the tiles' corners.
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
        """Memory of the arrays, bytes."""
        return sum(one.nbytes for one in (self.matrices, self.axis, self.inverse, self.valid,
                                         self.nodes, self.children))


class _ExtrapolatedLens:
    """Rays of a lens, extrapolated linearly beyond its rim.

    `centre` (2,) is a pixel inside the lens; every straight line from it crosses the rim only once.
    """

    def __init__(self, unproject: Unproject, centre: np.ndarray) -> None:
        self._unproject, self._centre = unproject, centre

    def corner_rays(self, visible: np.ndarray, size: int) -> np.ndarray:
        """Return unit rays (rows + 1, columns + 1, 3) of the corners of cells of `size` px.

        Only corners of the cells that `visible` (rows, columns) selects are computed; the others
        get the ray (0, 0, 1).
        """
        needed = np.zeros((visible.shape[0] + 1, visible.shape[1] + 1), bool)
        for down, across in ((0, 0), (0, 1), (1, 0), (1, 1)):
            needed[down:down + visible.shape[0], across:across + visible.shape[1]] |= visible
        out = np.tile([0.0, 0.0, 1.0], (*needed.shape, 1))
        out[needed] = self.compute_rays(np.argwhere(needed)[:, ::-1] * float(size) - 0.5)
        return out

    def centre_rays(self, visible: np.ndarray, size: int) -> np.ndarray:
        """Return unit rays (N, 3) of the centres of the cells that `visible` selects."""
        return self.compute_rays((np.argwhere(visible)[:, ::-1] + 0.5) * size - 0.5)

    def compute_rays(self, points: np.ndarray) -> np.ndarray:
        """Return unit rays (N, 3) of pixels (N, 2)."""
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
        # Do not extrapolate beyond two tiles from the rim: if a corner is farther from the rim, its
        # tile has no pixel inside the lens.
        share = np.minimum(1.0 - near, 2 * TILE / np.maximum(length, 1e-9))
        extrapolated = rim + share[:, None] * rate
        rays[beyond] = extrapolated / np.linalg.norm(extrapolated, axis=1, keepdims=True)
        return rays


def get_shared_tiles(width: int, height: int, key: Hashable, make: Callable[[], Tiles]) -> Tiles:
    """Return tiles from a cache that all renderers of the process share.

    If they are not in the cache, `make` creates them. `key` identifies the rays of the image.
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
    """Return the matrices (..., 3, 3) of cells of `size` px from the rays of their corners.

    a, b, c and d (..., 3) are the rays of the upper left, upper right, lower left and lower right
    corner. The function scales them such that d = b + c - a.
    """
    sides = np.stack([-a, b, c], axis=-1)
    # The corners of a cell that has no valid pixel may coincide.
    flat = np.abs(np.linalg.det(sides)) < 1e-18
    sides[flat] = np.eye(3)
    weight = np.linalg.solve(sides, d[..., None])[..., 0]
    weight[flat] = 1.0
    first, right, down = (weight[..., k, None] * ray for k, ray in enumerate((a, b, c)))
    x, y = (right - first) / size, (down - first) / size
    return np.stack([x, y, first + (x + y) / 2], axis=-1)


def _build_tree(axis: np.ndarray, angle: np.ndarray, visible: np.ndarray, rows: int, columns: int
          ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return nodes, levels and children of Tiles from the axes and angles of the tiles' cones."""
    nodes, levels, children = [], [], [np.zeros((0, 5, 16))]
    first = joined = 0
    axis, angle = axis.reshape(rows, columns, 3), angle.reshape(rows, columns)
    visible = visible.reshape(rows, columns)
    # `tile`, `wide` and `shown` are the axes, angles and validity of the tiles. The axis of a tile
    # without valid pixels is 0. `span` is the number of tiles along a side of a node.
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
    """Return x in groups of 4 x 4, (rows, columns, 16, ...), padded with zeros."""
    pad = [(0, 4 * rows - x.shape[0]), (0, 4 * columns - x.shape[1])]
    x = np.pad(x, pad + [(0, 0)] * (x.ndim - 2)).reshape(rows, 4, columns, 4, *x.shape[2:])
    return x.swapaxes(1, 2).reshape(rows, columns, 16, *x.shape[4:])
