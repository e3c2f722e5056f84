"""Defocus: a lens that is not focused on the target."""

from __future__ import annotations

import cv2
import numpy as np

from aras_visual_servo_base.settings import parameter

from .base import EFFECTS, Effect


@EFFECTS.register("defocus")
class Defocus(Effect):
    """Gaussian blur of the whole image, as from a lens that is out of focus at every depth."""

    stddev: float = parameter(1.0, "px", above=0.0, most=50.0, help="standard deviation")

    def apply(self, light: np.ndarray, random: np.random.Generator) -> np.ndarray:
        """Return the blurred light, see Effect.apply."""
        return cv2.GaussianBlur(light, (0, 0), self.stddev, borderType=cv2.BORDER_REPLICATE)
