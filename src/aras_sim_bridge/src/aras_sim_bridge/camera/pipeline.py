"""From what a lens projects to what a camera delivers: exposures, their mean, effects, lost frames.

The simulated sensor and the bench's plants without a renderer both use it, so that an effect acts
in the same way whoever draws the images.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .effects import EffectChain, Effects
from .shutter import RowBand


class ExposureMean:
    """Mean of the partial exposures of one image, each of which covers a band of rows."""

    def __init__(self, parts: Sequence[RowBand], height: int) -> None:
        """`parts`: as `shutter.parts` gives them; `height`: rows of the whole image."""
        self._parts, self._height = parts, height
        self._samples = sum(part.first == parts[0].first for part in parts)
        self._sum: np.ndarray | None = None

    def add(self, index: int, image: np.ndarray) -> None:
        """Add the uint8 image of the part of that index: its rows alone."""
        if len(self._parts) == 1:
            self._sum = image
            return
        if self._sum is None:
            self._sum = np.zeros((self._height, *image.shape[1:]), np.uint16)
        part = self._parts[index]
        self._sum[part.first : part.last] += image

    def take(self) -> np.ndarray:
        """Return the uint8 image of all parts, and start the next one."""
        image, self._sum = self._sum, None
        if len(self._parts) == 1:
            return image
        n = self._samples
        return ((image + n // 2) // n).astype(np.uint8)

    def clear(self) -> None:
        """Forget the parts that were added."""
        self._sum = None


class ImagePipeline:
    """What becomes of the images of one camera.

    For each image: `is_lost` tells whether it is dropped; `light.add` takes its partial exposures
    in the order of `parts`, `light.take` gives their mean, and `read_out` the picture as the sensor
    delivers it. The auto exposure follows the images that were read out.

    Attributes:
        parts: the exposures of which an image consists. middle: index of the one nearest to the
            stamp, the last of those that are equally near. light: collects them.
    """

    def __init__(
        self, effects: Effects, shape: tuple[int, ...], seed: int, parts: Sequence[RowBand]
    ) -> None:
        """Prepare for images of `shape` (H, W) or (H, W, 3); `seed`: of all that is random."""
        self.parts = tuple(parts)
        self.middle_part = min(range(len(self.parts)), key=lambda n: (
            abs(self.parts[n].offset_ns), -n))  # fmt: skip
        self.exposure = ExposureMean(self.parts, shape[0])
        self._auto_exposure, self._factor = effects.auto_exposure, 1.0
        self._chain = EffectChain(effects, shape, seed)
        self.is_lost = self._chain.is_lost

    def read_out(self, light: np.ndarray, stamp_ns: int) -> np.ndarray:
        """The image that the sensor makes of `light`, a uint8 array of the pipeline's shape."""
        image = self._chain.apply(light, stamp_ns, self._factor)
        if self._auto_exposure is not None:
            self._factor = self._auto_exposure.compute_factor(self._factor, float(image.mean()))
        return image

    def reset(self, exposure: bool = True) -> None:
        """Start again with the first part of an image, and where `exposure` is true with the auto
        exposure's factor of 1."""
        self.exposure.clear()
        if exposure:
            self._factor = 1.0
