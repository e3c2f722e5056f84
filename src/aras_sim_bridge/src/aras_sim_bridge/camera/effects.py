"""What a real sensor adds to the picture; everything is off by default, and seeded."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import cv2
import numpy as np

from ..errors import CameraError

# Noise is cut out of a table of this many values at a random place. Consecutive frames share
# no pattern that a vision algorithm could see, and no normal deviate is drawn while running.
_TABLE = 1 << 21


@dataclass(frozen=True)
class Effects:
    """noise_stddev: Gaussian noise, grey levels. shot_noise: variance a grey level; a sensor of
    full-well capacity N electrons has 255 / N. exposure: factor on the light before the sensor.
    gain: factor after the shot noise, which it amplifies. vignetting: light lost in the corner,
    0..1. exposure_time: s; the shutter is open that long around the stamp, with
    exposure_samples pictures averaged. drop_probability: share of frames that are never sent.
    """

    noise_stddev: float = 0.0
    shot_noise: float = 0.0
    exposure: float = 1.0
    gain: float = 1.0
    vignetting: float = 0.0
    exposure_time: float = 0.0
    exposure_samples: int = 5
    drop_probability: float = 0.0

    def __post_init__(self) -> None:
        limits = {"noise_stddev": (0, math.inf), "shot_noise": (0, math.inf),
                  "exposure": (0, math.inf), "gain": (0, math.inf), "vignetting": (0, 1),
                  "exposure_time": (0, math.inf), "drop_probability": (0, 1)}
        for name, (low, high) in limits.items():
            value = getattr(self, name)
            if not isinstance(value, int | float) or not low <= value <= high \
                    or not math.isfinite(value):
                raise CameraError(f"effects: {name} {value!r} has to be a number in {low}..{high}")
        if not isinstance(self.exposure_samples, int) or not 1 <= self.exposure_samples <= 64:
            raise CameraError(
                f"effects: exposure_samples {self.exposure_samples!r} has to be 1..64, whole"
            )

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> Effects:
        """Effects from a preset's keys. Raises CameraError for a key that is not there."""
        known = [f.name for f in fields(cls)]
        for key in values:
            if key not in known:
                raise CameraError(f"effects: unknown key '{key}'; there are {', '.join(known)}")
        return cls(**values)


class EffectChain:
    """Applies the effects to pictures of one size, in the order light meets them."""

    def __init__(self, effects: Effects, width: int, height: int, seed: int) -> None:
        self.effects = effects
        self._seed = seed
        self._shade = _vignette(width, height, effects.vignetting, effects.exposure)
        levels = np.arange(256) * effects.exposure
        signal = np.clip(levels, 0.0, 255.0)
        self._curve = None
        if effects.exposure != 1.0 or effects.gain != 1.0:
            self._curve = np.clip(np.round(signal * effects.gain), 0, 255).astype(np.uint8)
        self._table: np.ndarray | None = None
        self.reset()

    def reset(self) -> None:
        """Start the random sequence anew."""
        self._random = np.random.default_rng(self._seed)
        e = self.effects
        if (e.noise_stddev or e.shot_noise) and self._table is None:
            table = np.random.default_rng([self._seed, 1]).standard_normal(_TABLE, np.float32)
            self._unit = None
            if e.shot_noise:
                self._unit = table
            else:
                self._table = np.clip(np.round(e.noise_stddev * table), -255, 255).astype(np.int16)

    def dropped(self) -> bool:
        """Whether this frame is lost; one draw a frame."""
        p = self.effects.drop_probability
        return bool(p) and self._random.random() < p

    def apply(self, image: np.ndarray) -> np.ndarray:
        """The (H, W, 3) uint8 picture as the sensor reads it out, in a new array or unchanged."""
        e = self.effects
        if e.shot_noise:
            return self._with_shot_noise(image)
        if self._shade is not None:
            image = cv2.multiply(image, self._shade, dtype=cv2.CV_8U)
            if e.gain != 1.0:
                image = cv2.convertScaleAbs(image, alpha=e.gain)
        elif self._curve is not None:
            image = cv2.LUT(image, self._curve)
        if self._table is not None:
            noise = self._cut(self._table, image.size).reshape(image.shape)
            image = cv2.add(image, noise, dtype=cv2.CV_8U)
        return image

    def _with_shot_noise(self, image: np.ndarray) -> np.ndarray:
        """Variance = gain^2 (shot_noise * light) + noise_stddev^2; full wells stay full."""
        e = self.effects
        if self._shade is not None:
            light = cv2.multiply(image, self._shade, dtype=cv2.CV_32F)
        else:
            light = image.astype(np.float32) * np.float32(e.exposure)
        light = np.minimum(light, np.float32(255.0))
        spread = cv2.sqrt(light * np.float32(e.shot_noise * e.gain**2)
                          + np.float32(e.noise_stddev**2))
        noise = self._cut(self._unit, image.size).reshape(image.shape)
        out = light * np.float32(e.gain) + cv2.multiply(spread, noise)
        return cv2.convertScaleAbs(np.maximum(out, np.float32(0.0)))

    def _cut(self, table: np.ndarray, size: int) -> np.ndarray:
        if size > len(table):
            table = np.resize(table, 2 * size)
        start = int(self._random.integers(len(table) - size + 1))
        return table[start:start + size]


def _vignette(width: int, height: int, loss: float, exposure: float) -> np.ndarray | None:
    """(H, W, 3) float32 factors falling with the square of the distance from the centre."""
    if not loss:
        return None
    v, u = np.mgrid[:height, :width]
    x, y = u - (width - 1) / 2, v - (height - 1) / 2
    r2 = (x * x + y * y) / max((width / 2) ** 2 + (height / 2) ** 2, 1e-9)
    return np.repeat(((1.0 - loss * r2) * exposure).astype(np.float32)[..., None], 3, axis=2)
