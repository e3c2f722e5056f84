"""What pixels with edges consist of: found, and resolved into what their triangles show of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .binning import Seen
from .edges import resolved
from .finding import found_edges
from .sampling import Samples
from .tiles import Tiles


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
    """Finds and resolves the edges of pictures through the same tiles."""

    def __init__(self, tiles: Tiles) -> None:
        self._tiles = tiles
        self._room = 4096

    def fragments(self, seen: Seen, samples: Samples, words: np.ndarray,
                  plain: np.ndarray, part: np.ndarray, near: float, far: float) -> Fragments:
        """Fragments of the pixels with edges; words: the picture with one sample a pixel."""
        t = self._tiles
        found = found_edges(t, seen, samples, words, plain, part)
        while True:
            room = self._room
            pixel, start = np.empty(len(found), np.int64), np.empty(len(found) + 1, np.int64)
            member, share, at = np.empty(room, np.int64), np.empty(room), np.empty((room, 2))
            pixels, count = resolved(
                found, samples.start, samples.member, samples.full, samples.touched,
                seen.side, seen.cut, seen.opaque, plain, t.matrices, t.axis, t.cells, t.columns,
                near, far, pixel, start, member, share, at)
            if count <= room:
                return Fragments(pixel[:pixels], start[:pixels + 1], member[:count],
                                 share[:count], at[:count])
            self._room = 2 * count
