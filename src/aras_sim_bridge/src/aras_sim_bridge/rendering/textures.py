"""Texture images, each with all its halves, in one array that compiled loops read."""

from __future__ import annotations

import cv2
import numpy as np

SIZE = 512  # px a side, a power of two; what is larger or smaller is brought to it


class Textures:
    """texels: (N, 3) uint8 rgb; layer after layer of SIZE x SIZE, SIZE/2 x SIZE/2, ..., 1 x 1,
    each row by row from v = 0 upwards, as OBJ counts."""

    def __init__(self, files: set[str]) -> None:
        self._layers = {file: n for n, file in enumerate(sorted(files))}
        texels = [np.zeros((0, 3), np.uint8)]
        for file in self._layers:
            bgr = cv2.imread(file, cv2.IMREAD_COLOR)
            if bgr is None:
                bgr = np.full((1, 1, 3), 255, np.uint8)
            image = cv2.resize(bgr, (SIZE, SIZE), interpolation=cv2.INTER_AREA)[::-1, :, ::-1]
            while True:
                texels.append(image.reshape(-1, 3))
                if len(image) == 1:
                    break
                image = image.reshape(len(image) // 2, 2, len(image) // 2, 2, 3)
                image = np.rint(image.mean(axis=(1, 3))).astype(np.uint8)
        self.texels = np.concatenate(texels)

    def layer(self, file: str) -> int:
        """Number of a file's texture."""
        return self._layers[file]
