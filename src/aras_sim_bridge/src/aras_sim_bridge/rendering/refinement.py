"""Where a picture drawn with one sample a pixel needs more: the tiles with edges in them.

An edge that crosses a pixel separates two neighbouring pixel centres. Tiles in which no two
neighbours differ look the same with one sample as with many, so only the others are drawn again.
"""

from __future__ import annotations

import cv2
import numpy as np

TILE = 8
# Grey levels: below it an edge is as smooth as shading.
THRESHOLD = 6


def tile_origins(width: int, height: int) -> np.ndarray:
    """(N, 2) first pixels u, v of all tiles of a picture, row by row.

    Tiles at the far borders are moved inwards where they would stand out of the picture.
    """
    u = np.minimum(np.arange(0, width, TILE), width - TILE)
    v = np.minimum(np.arange(0, height, TILE), height - TILE)
    return np.stack([np.tile(u, len(v)), np.repeat(v, len(u))], axis=1)


class EdgeFinder:
    """Finds tiles with edges in pictures of one size."""

    def __init__(self, width: int, height: int) -> None:
        self.columns, self.rows = -(-width // TILE), -(-height // TILE)
        self.origins = tile_origins(width, height)
        self._size = (width, height)
        # Differences are noted at the left or upper pixel; padded to whole tiles.
        shape = (self.rows * TILE, self.columns * TILE)
        self._grey = np.zeros(shape, np.uint8)
        self._edge = np.zeros(shape, np.uint8)

    def find(self, rgba: np.ndarray, threshold: int = THRESHOLD) -> np.ndarray:
        """(N,) numbers of the tiles in which neighbours in rgba (height, width, 4) uint8 differ
        by more than `threshold` grey levels."""
        w, h = self._size
        grey = self._grey
        grey[:h, :w] = cv2.cvtColor(rgba, cv2.COLOR_RGBA2GRAY)
        stride = grey.shape[1]
        flat = grey.reshape(1, -1)
        edge = self._edge.reshape(1, -1)
        edge[:, :-1] = cv2.absdiff(flat[:, 1:], flat[:, :-1])
        down = cv2.absdiff(flat[:, stride:], flat[:, :-stride])
        edge[:, :-stride] = cv2.max(edge[:, :-stride], down)
        edge = self._edge
        edge[:, w - 1] = 0  # nothing to the right of the last column, nothing below the last row
        edge[h - 1:] = 0
        # The two borders dropped: they are compared along themselves.
        edge[:h - 1, w - 1] = cv2.absdiff(grey[1:h, w - 1], grey[:h - 1, w - 1]).reshape(-1)
        edge[h - 1, :w - 1] = cv2.absdiff(grey[h - 1, 1:w], grey[h - 1, :w - 1]).reshape(-1)
        words = cv2.threshold(edge, threshold, 1, cv2.THRESH_BINARY)[1].view(np.uint64)
        words = words.reshape(self.rows, TILE, self.columns)  # a row of a tile is one word
        column = np.bitwise_or.reduce(words, axis=1)
        hit = column != 0
        # A difference noted on the last pixel of a tile concerns the next tile as well.
        hit[:, 1:] |= (column[:, :-1] >> np.uint64(56)) != 0
        hit[1:, :] |= words[:-1, -1] != 0
        return np.flatnonzero(hit)


def lattice(factor: int) -> tuple[float, float]:
    """The shader's shear that puts the samples of a tile on a lattice.

    factor x factor samples in a square grid tell an upright edge only factor places in a pixel.
    Sheared by one sample a pixel along both axes, X' = X + Y / factor - 1/2 and likewise Y', all
    of them stand in different columns and rows: factor^2 places, for the same price. A pixel is
    still a square block of samples, moved by one sample for every pixel across.
    """
    x = 1.0 / (factor + 1)
    return x, x / TILE


def paste_sheared(image: np.ndarray, atlas: np.ndarray, corners: np.ndarray, factor: int) -> None:
    """Mean of every pixel's samples from the sheared atlas into image (height, width, 4)."""
    mean = cv2.boxFilter(atlas, -1, (factor, factor), anchor=(0, 0),
                         borderType=cv2.BORDER_REPLICATE)
    size = TILE * (factor + 1)
    columns = atlas.shape[1] // size
    row, column = np.divmod(np.arange(len(corners)), columns)
    across = np.arange(TILE)
    # Pixels are words, and words are found by their number.
    step = factor * across[:, None] + across
    source = (row * mean.shape[1] + column)[:, None, None] * size + step * mean.shape[1] + step.T
    u, v = corners.T
    goal = (v * image.shape[1] + u)[:, None, None] + across[:, None] * image.shape[1] + across
    image.view(np.uint32).reshape(-1)[goal] = mean.view(np.uint32).reshape(-1)[source]
