"""One lens: its faces, and how a picture is looked up in the atlas in which they are drawn."""

from __future__ import annotations

import cv2
import numpy as np

from .faces import around
from .lens_tiles import LensTiles
from .raymap import RayMap
from .refinement import TILE

# A jump of more atlas pixels than this leads to another face and says nothing about pixel sizes.
JUMP = 8.0


class LensView:
    """A lens with its clip distances, m.

    faces: what is drawn into the atlas. tiles: the picture in tiles, or None where it is smaller
    than one. Pictures are continued beyond the rim of the lens, so that no edge is found there;
    `blacken` ends that.
    """

    def __init__(self, lens: RayMap, near: float, far: float) -> None:
        self.lens = lens
        self.faces = around(lens, near, far)
        self.tiles = LensTiles(lens, near, far) if min(lens.width, lens.height) >= TILE else None
        self._outside = None if lens.valid.all() else ~lens.valid
        self._lookup = _extended(lens)
        self._places: dict[tuple, np.ndarray] = {}

    def pick(self, atlas: np.ndarray) -> np.ndarray:
        """Picture (height, width, 4) of the nearest pixels of an atlas of `atlas_size`."""
        return cv2.remap(atlas, self._lookup, None, cv2.INTER_NEAREST)

    def look_up(self, atlas: np.ndarray, places: int) -> np.ndarray:
        """Picture (height, width, 4), interpolated in an atlas of any size.

        places: how many places of a pixel are looked up along each of its sides, 1 or 2.
        """
        key = (*atlas.shape[:2], places)
        if key not in self._places:
            scale = np.array(atlas.shape[1::-1], np.float32) / np.float32(self.lens.atlas_size)
            self._places[key] = (self._within_pixels(places) + 0.5) * scale - np.float32(0.5)
        out = cv2.remap(atlas, self._places[key], None, cv2.INTER_LINEAR)
        if places == 1:
            return out
        size = (self.lens.width, self.lens.height)
        return cv2.resize(out, size, interpolation=cv2.INTER_AREA)

    def _within_pixels(self, places: int) -> np.ndarray:
        """Lookup (places height, places width, 2) for places x places in every pixel."""
        if places == 1:
            return self._lookup
        down, across = (np.where((np.abs(step) < JUMP).all(axis=2, keepdims=True), step / 4, 0)
                        for step in np.gradient(self._lookup, axis=(0, 1)))
        height, width = self._lookup.shape[:2]
        out = np.empty((2 * height, 2 * width, 2), np.float32)
        for row, sign_down in enumerate((-1, 1)):
            for column, sign_across in enumerate((-1, 1)):
                out[row::2, column::2] = self._lookup + sign_down * down + sign_across * across
        return out

    def blacken(self, rgba: np.ndarray) -> None:
        """Make what the lens does not show black."""
        if self._outside is not None:
            rgba[self._outside] = (0, 0, 0, 255)


def _extended(lens: RayMap) -> np.ndarray:
    """The lookup, with that of the nearest pixel where the lens shows nothing."""
    if lens.valid.all():
        return lens.lookup
    _, label = cv2.distanceTransformWithLabels(
        (~lens.valid).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    of_label = np.zeros((label.max() + 1, 2), np.float32)
    of_label[label[lens.valid]] = lens.lookup[lens.valid]
    return of_label[label]
