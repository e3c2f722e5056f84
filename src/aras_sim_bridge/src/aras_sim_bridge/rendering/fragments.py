"""Fragments: the visible parts of triangles in pixels with edges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .binning import VisibleTriangles
from .pixel_visibility import PixelSamples
from .tiles import Tiles
from .triangles import Triangles
from .visible_areas import resolve_fragments


@dataclass
class Fragments:
    """Visible parts of triangles (fragments) in the pixels with edges.

    Attributes:
        pixel: (P,) number of each pixel, row * width + column in the image enlarged to whole tiles.
        start: (P + 1,) start of each pixel's fragments in the following arrays.
        member: (F,) triangle of each fragment, as an index in VisibleTriangles. In each pixel,
            opaque triangles come first, then transparent ones from far to near.
        share: (F,) area of the fragment, as a fraction of the pixel's area.
        at: (F, 2) centre of the fragment, px from the first pixel of the pixel's cell (see Tiles).
    """

    pixel: np.ndarray
    start: np.ndarray
    member: np.ndarray
    share: np.ndarray
    at: np.ndarray


class FragmentBuilder:
    """Computes the fragments of images that have the same tiles.

    The arrays of a result are overwritten by the next call.
    """

    def __init__(self, tiles: Tiles) -> None:
        self._tiles = tiles
        self._start = np.empty(1024, np.int64)
        self._allocate_fragments(4096)

    def _allocate_fragments(self, capacity: int) -> None:
        self._member, self._share = np.empty(capacity, np.int64), np.empty(capacity)
        self._at = np.empty((capacity, 2))

    def resolve(
        self,
        triangles: Triangles,
        visible: VisibleTriangles,
        samples: PixelSamples,
        edge_pixels: np.ndarray,
        near: float,
        far: float,
    ) -> Fragments:
        """Return the visible parts of the triangles in the pixels `edge_pixels`."""
        t, pixel_count = self._tiles, len(edge_pixels)
        if pixel_count >= len(self._start):
            self._start = np.empty(2 * pixel_count, np.int64)
        while True:
            count = resolve_fragments(
                edge_pixels, samples.start, samples.member, samples.full, samples.pixel_masks,
                visible.corner, visible.side, visible.cut, visible.opaque, visible.colour,
                visible.triangle, triangles.hull, t.matrices, t.axis, t.cells, t.columns, near, far,
                self._start, self._member, self._share, self._at,
            )  # fmt: skip
            if count <= len(self._member):
                return Fragments(
                    edge_pixels, self._start[: pixel_count + 1], self._member[:count],
                    self._share[:count], self._at[:count],
                )  # fmt: skip
            self._allocate_fragments(2 * count)
