"""The parts of a picture that show more than its background, drawn beside each other.

Over a table the servo's camera sees a target of some thousand pixels. Whatever lies outside the
rectangles around outlines has the colour of the background: it need not be drawn, read back, and
searched for edges.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from .compiled import compiled
from .faces import Faces, rectangles
from .outlines import Outlines
from .raymap import LARGEST
from .refinement import TILE
from .view import View

# Rectangles are made of blocks of this many pixels a side, whole tiles.
BLOCK = 4 * TILE
# The framebuffer has multiples of this, so that few sizes are made.
STEP = 2 * BLOCK
# Where more than this share of the picture would be drawn, the whole picture costs less.
MOST = 0.5


@dataclass(frozen=True)
class Regions:
    """Rectangles stacked in an atlas.

    origins, sizes: (R, 2) u, v in the picture. rows: (R,) first rows in the atlas, all in
        column 0. atlas_size: width, height; what no rectangle covers is background.
    """

    origins: np.ndarray
    sizes: np.ndarray
    rows: np.ndarray
    atlas_size: tuple[int, int]

    @classmethod
    def around(cls, outlines: Outlines, view: View) -> Regions | None:
        """Those around all outlines, apart by a pixel or more; None where they save too little."""
        w, h = view.width, view.height
        if w % TILE or h % TILE:
            return None
        boxes = _boxes(_touched(outlines.bounds, view.K, w, h)) * BLOCK
        if not len(boxes):
            return cls(boxes[:, :2], boxes[:, 2:], boxes[:, 0], (0, 0))
        sizes = np.minimum(boxes[:, 2:], [w, h] - boxes[:, :2])
        rows = np.cumsum(sizes[:, 1]) - sizes[:, 1]
        wide, high = (-(-int(n) // STEP) * STEP for n in (sizes[:, 0].max(), sizes[:, 1].sum()))
        if wide * high > MOST * w * h or high > LARGEST:
            return None
        return cls(boxes[:, :2], sizes, rows, (wide, high))

    def faces(self, view: View) -> Faces:
        """The rectangles as faces that fill their places in the atlas."""
        place = np.stack([np.zeros(len(self.rows), int), self.rows], axis=1)
        return rectangles(view, self.origins, self.sizes, place, self.atlas_size)

    def overlapping(self, outlines: Outlines, view: View) -> tuple[np.ndarray, np.ndarray]:
        """Pairs (rectangle, triangle), rectangle by rectangle, that may overlap."""
        return outlines.overlapping(*view.in_plane(self.origins, self.sizes))

    def in_picture(self, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """For pixels (N, 2) of the atlas: which (M,) lie in rectangles, and (M, 2) where."""
        region = np.searchsorted(self.rows, corners[:, 1], side="right") - 1
        inside = corners.copy()
        inside[:, 1] -= self.rows[region]
        some = np.flatnonzero((inside < self.sizes[region]).all(axis=1))
        return some, inside[some] + self.origins[region[some]]

    def paste(self, atlas: np.ndarray, image: np.ndarray) -> None:
        """Put the rectangles from the atlas (rgba) into image (height, width, 3)."""
        for (u, v), (w, h), row in zip(self.origins, self.sizes, self.rows, strict=True):
            cv2.cvtColor(atlas[row:row + h, :w], cv2.COLOR_RGBA2RGB, dst=image[v:v + h, u:u + w])


@compiled("f8[:,::1], f8[:,::1], i8, i8")
def _touched(bounds, K, width, height):
    """(rows, columns) uint8, 1 in the blocks that outlines with bounds (N, 4) may colour."""
    touched = np.zeros((-(-height // BLOCK), -(-width // BLOCK)), np.uint8)
    for n in range(len(bounds)):
        # And in those of the next pixels, so that edges lie inside.
        u = max(0.0, bounds[n, 0] * K[0, 0] + K[0, 2] - 1.0)
        v = max(0.0, bounds[n, 1] * K[1, 1] + K[1, 2] - 1.0)
        u_end = min(width - 1.0, bounds[n, 2] * K[0, 0] + K[0, 2] + 2.0)
        v_end = min(height - 1.0, bounds[n, 3] * K[1, 1] + K[1, 2] + 2.0)
        touched[int(v) // BLOCK:int(v_end) // BLOCK + 1,
                int(u) // BLOCK:int(u_end) // BLOCK + 1] = 1
    return touched


def _boxes(touched: np.ndarray) -> np.ndarray:
    """(R, 4) column, row, width, height of disjoint rectangles around what is not 0."""
    while True:
        _, _, stats, _ = cv2.connectedComponentsWithStats(touched, connectivity=8)
        boxes = stats[1:, :4].astype(int)
        if boxes[:, 2].dot(boxes[:, 3]) == np.count_nonzero(touched):
            return boxes
        # Rectangles filled up may touch each other: look again.
        for u, v, w, h in boxes:
            touched[v:v + h, u:u + w] = 1
