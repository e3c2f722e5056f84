"""What pixels with edges consist of: what their triangles show of each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .binning import Seen
from .edges import resolved
from .sampling import Samples
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


class Edges:
    """Resolves the edges of pictures through the same tiles."""

    def __init__(self, tiles: Tiles) -> None:
        self._tiles = tiles
        self._room = 4096

    def fragments(self, triangles: Triangles, seen: Seen, samples: Samples, found: np.ndarray,
                  plain: np.ndarray, near: float, far: float) -> Fragments:
        """What the pixels found consist of; plain: (N,) words of the triangles that have one
        colour."""
        t = self._tiles
        while True:
            room = self._room
            start = np.empty(len(found) + 1, np.int64)
            member, share, at = np.empty(room, np.int64), np.empty(room), np.empty((room, 2))
            count = resolved(
                found, samples.start, samples.member, samples.full, samples.touched,
                seen.corner, seen.side, seen.cut, seen.opaque, plain, seen.triangle, triangles.hull,
                t.matrices, t.axis, t.cells, t.columns, near, far, start, member, share, at)
            if count <= room:
                return Fragments(found, start, member[:count], share[:count], at[:count])
            self._room = 2 * count
