"""Image pipeline of a camera: mean of the partial exposures, effects, and lost frames.

This pipeline is used both for rendered images and for images that a test bench computes without a
renderer, so that an effect changes both in the same way.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .effects import EffectChain, Effects
from .shutter import RowBand


class ExposureAccumulator:
    """Mean of the partial exposures of one image.

    A partial exposure is a band of rows, rendered for one instant of the exposure time.
    """

    def __init__(self, parts: Sequence[RowBand], height: int) -> None:
        """Prepare for images of `height` rows. `parts` is the result of shutter.make_row_bands."""
        self._parts, self._height = parts, height
        self._samples = sum(part.first == parts[0].first for part in parts)
        self._sum: np.ndarray | None = None

    def add(self, index: int, image: np.ndarray) -> None:
        """Add the partial exposure with this index: the uint8 image of the rows of its RowBand."""
        if len(self._parts) == 1:
            self._sum = image
            return
        if self._sum is None:
            self._sum = np.zeros((self._height, *image.shape[1:]), np.uint16)
        part = self._parts[index]
        self._sum[part.first : part.last] += image

    def take(self) -> np.ndarray:
        """Return the uint8 mean of the partial exposures that were added, and discard them."""
        image, self._sum = self._sum, None
        if len(self._parts) == 1:
            return image
        n = self._samples
        return ((image + n // 2) // n).astype(np.uint8)

    def clear(self) -> None:
        """Discard the partial exposures that were added."""
        self._sum = None


class ImagePipeline:
    """Effects and exposures of the images of one camera.

    A partial exposure is a band of rows, rendered for one instant of the exposure time. An image is
    made in these steps: if `is_lost`, skip it; add its partial exposures with `exposure.add`; get
    their mean with `exposure.take`; convert the mean with `read_out`, which also adapts the auto
    exposure.

    Attributes:
        parts: rows and time of each partial exposure.
        middle_part: index of the partial exposure that is nearest to the stamp; the last one if
            several are equally near.
        exposure: mean of the partial exposures.
    """

    def __init__(
        self, effects: Effects, shape: tuple[int, ...], seed: int, parts: Sequence[RowBand]
    ) -> None:
        """Prepare for images of `shape` (H, W) or (H, W, 3). `seed` is used by random effects."""
        self.parts = tuple(parts)
        self.middle_part = min(range(len(self.parts)), key=lambda n: (
            abs(self.parts[n].offset_ns), -n))  # fmt: skip
        self.exposure = ExposureAccumulator(self.parts, shape[0])
        self._auto_exposure, self._factor = effects.auto_exposure, 1.0
        self._chain = EffectChain(effects, shape, seed)
        self.is_lost = self._chain.is_lost

    def read_out(self, light: np.ndarray, stamp_ns: int) -> np.ndarray:
        """Return the image that the sensor delivers at this stamp for a uint8 array of light."""
        image = self._chain.apply(light, stamp_ns, self._factor)
        if self._auto_exposure is not None:
            self._factor = self._auto_exposure.compute_factor(self._factor, float(image.mean()))
        return image

    def reset(self, exposure: bool = True) -> None:
        """Discard the partial exposures of an unfinished image.

        If `exposure` is True, the factor of the auto exposure is set to 1, too.
        """
        self.exposure.clear()
        if exposure:
            self._factor = 1.0
