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
    """Computes the fragments of images that have the same tiles."""

    def __init__(self, tiles: Tiles) -> None:
        self._tiles = tiles
        self._capacity = 4096

    def resolve(
        self,
        triangles: Triangles,
        visible: VisibleTriangles,
        samples: PixelSamples,
        edge_pixels: np.ndarray,
        uniform: np.ndarray,
        near: float,
        far: float,
    ) -> Fragments:
        """Return the visible parts of the triangles in the pixels `edge_pixels`.

        `uniform` is described in triangle_edge_pixels.find_edges.
        """
        t = self._tiles
        while True:
            room = self._capacity
            start = np.empty(len(edge_pixels) + 1, np.int64)
            member, share, at = np.empty(room, np.int64), np.empty(room), np.empty((room, 2))
            count = resolve_fragments(
                edge_pixels,
                samples.start,
                samples.member,
                samples.full,
                samples.pixel_masks,
                visible.corner,
                visible.side,
                visible.cut,
                visible.opaque,
                uniform,
                visible.triangle,
                triangles.hull,
                t.matrices,
                t.axis,
                t.cells,
                t.columns,
                near,
                far,
                start,
                member,
                share,
                at,
            )
            if count <= room:
                return Fragments(edge_pixels, start, member[:count], share[:count], at[:count])
            self._capacity = 2 * count
