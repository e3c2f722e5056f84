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


class EdgeFinder:
    """Finds tiles with edges in pictures of one size."""

    def __init__(self, width: int, height: int) -> None:
        self.columns, self.rows = -(-width // TILE), -(-height // TILE)
        self._size = (width, height)
        # Differences are noted at the left or upper pixel; padded to whole tiles.
        shape = (self.rows * TILE, self.columns * TILE)
        self._grey = np.zeros(shape, np.uint8)
        self._edge = np.zeros(shape, np.uint8)

    def find(self, rgba: np.ndarray) -> np.ndarray:
        """(N, 2) first pixels u, v of the tiles with edges in rgba (height, width, 4) uint8.

        Tiles at the far borders are moved inwards where they would stand out of the picture.
        """
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
        words = cv2.threshold(edge, THRESHOLD, 1, cv2.THRESH_BINARY)[1].view(np.uint64)
        words = words.reshape(self.rows, TILE, self.columns)  # a row of a tile is one word
        column = np.bitwise_or.reduce(words, axis=1)
        hit = column != 0
        # A difference noted on the last pixel of a tile concerns the next tile as well.
        hit[:, 1:] |= (column[:, :-1] >> np.uint64(56)) != 0
        hit[1:, :] |= words[:-1, -1] != 0
        return np.minimum(np.argwhere(hit)[:, ::-1] * TILE, [w - TILE, h - TILE])


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
    across = np.arange(TILE)
    rows = factor * across[:, None] + across[None, :]
    for n, (u, v) in enumerate(corners.tolist()):
        row, column = divmod(n, columns)
        image[v:v + TILE, u:u + TILE] = mean[row * size + rows, column * size + rows.T]
