"""What pixels with edges consist of: what their triangles show of each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .binning import VisibleTriangles
from .edges import resolve_fragments
from .sampling import PixelSamples
from .tiles import Tiles
from .triangles import Triangles


@dataclass(frozen=True)
class Fragments:
    """What pixels with edges consist of.

    pixel: (P,) row * width + column, of the padded picture. start: (P + 1,), the stretch of each
        in the lists that follow.
    member: (F,) number in Seen. share: (F,) of the pixel's area. at: (F, 2) the middle of the
        fragment, x, y in its cell, px. Opaque ones first, then the others from far to near.
    """

    pixel: np.ndarray
    start: np.ndarray
    member: np.ndarray
    share: np.ndarray
    at: np.ndarray


class EdgeResolver:
    """Resolves the edges of pictures through the same tiles."""

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
        """What the pixels found consist of; plain: (N,) words of the triangles that have one
        colour."""
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
