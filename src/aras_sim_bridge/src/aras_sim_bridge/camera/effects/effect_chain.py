"""Noise and exposure of a real image sensor. All effects are off by default."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from aras_visual_servo_base.compiled import jit, jit_inline
from aras_visual_servo_base.settings import check, parameter

from ...errors import CameraError
from .base import EFFECTS, Effect

# Coefficients of an odd polynomial that converts the sum of four uniform random numbers to a
# standard normal random number, fitted by least squares to the quantiles of both distributions. The
# error of the result is below 0.008 for results up to 3, and below 0.025 up to 4; the largest
# result is 4.7. The polynomial needs neither branches nor tables, so the compiler can use SIMD
# instructions.
_C1, _C3, _C5, _C7 = (np.float32(c) for c in (1.65999598, 0.09039413, -0.03567146, 0.01594779))
# Numbers of the independent random sequences of an image: _DROP decides whether the frame is lost,
# _NOISE gives the noise, and there is one for each effect of `Effects.further`, from _FURTHER on.
_DROP, _NOISE, _FURTHER = 0, 1, 16


@dataclass(frozen=True)
class SensorModel:
    """Sensor model of the standard EMVA 1288.

    Grey levels are those of an 8 bit image. Numbers of electrons have the unit e-.

    Attributes:
        gain: gain K, grey levels per electron. Light of g grey levels makes g / K electrons on
            average, with a variance of g / K.
        full_well: largest number of electrons in a pixel, e-. More electrons are lost.
        read_noise: standard deviation of the number of electrons in the dark, e-.
        dark_current: electrons that are generated in the dark per second of exposure, e-/s.

    Reference: EMVA Standard 1288, Standard for characterization of image sensors and cameras,
    release 4.0 linear, 2021.
    """

    gain: float = parameter(unit="grey levels per electron", above=0.0)
    full_well: float = parameter(unit="e-", above=0.0)
    read_noise: float = parameter(0.0, "e-", least=0.0)
    dark_current: float = parameter(0.0, "e-/s", least=0.0)

    def __post_init__(self) -> None:
        check(self, CameraError, "effects.sensor")
        full = self.gain * self.full_well
        if full < 1.0:
            raise CameraError(
                f"effects.sensor: a full_well of {self.full_well:g} e- at a gain of {self.gain:g} "
                f"grey levels per electron is only {full:.2g} grey levels, so that images would be "
                "black; raise full_well or gain"
            )
        if self.read_noise >= self.full_well:
            raise CameraError(
                f"effects.sensor: read_noise {self.read_noise:g} e- is not below the full_well of "
                f"{self.full_well:g} e-; lower read_noise or raise full_well"
            )


@dataclass(frozen=True)
class AutoExposure:
    """Auto exposure: a factor for the light that brings an image's mean grey level to `target`.

    Attributes:
        target: desired mean grey level.
        speed: exponent, above 0 and at most 1. After each image, the factor is multiplied by
            (target / mean grey level) ** speed.
        least, most: smallest and largest factor. The factor of the first image is 1.
    """

    target: float = parameter(160.0, "grey levels", above=0.0, below=255.0)
    speed: float = parameter(0.5, above=0.0, most=1.0)
    least: float = parameter(0.1, above=0.0)
    most: float = parameter(10.0, above=0.0)

    def __post_init__(self) -> None:
        check(self, CameraError, "effects.auto_exposure")
        if not self.least <= 1.0 <= self.most:
            raise CameraError(
                f"effects.auto_exposure: least is {self.least:g} and most is {self.most:g}, but "
                "the exposure starts with the factor 1; set least <= 1 and most >= 1"
            )

    def compute_factor(self, factor: float, mean: float) -> float:
        """Return the factor for the next image, given this image's factor and mean grey level."""
        missing = self.target / max(mean, 1.0)
        return float(np.clip(factor * missing**self.speed, self.least, self.most))


@dataclass(frozen=True)
class Effects:
    """Effects of a camera on its images.

    Attributes:
        noise_mean, noise_stddev: mean and standard deviation of Gaussian noise, in grey levels from
            0 to 255. The noise is independent in every channel.
        shot_noise: variance of the shot noise divided by the grey level. It is 255 / N for a sensor
            with a full-well capacity of N electrons.
        exposure: factor by which the light is multiplied before the sensor.
        gain: factor by which the signal of the sensor and its shot noise are multiplied.
        vignetting: fraction of the light that is lost in the corners of the image, 0..1.
        exposure_time: time for which the shutter is open, s. The stamp is the middle of this time.
        exposure_samples: number of rendered images that are averaged over the exposure time.
        drop_probability: probability that a frame is lost.
        sensor: calibrated model of the sensor, which replaces shot_noise; None for no model.
        auto_exposure: auto exposure; None for a constant exposure.
        row_time: time between the exposures of two successive rows, from top to bottom, s; 0 for a
            global shutter.
        rows_together: number of rows that are rendered for the same instant.
        further: subclasses of Effect that change the light before the exposure, in this order. The
            keys are registered names or 'package.module:Class', and the values are mappings of the
            effects' parameters.
    """

    noise_mean: float = parameter(0.0, least=-255.0, most=255.0)
    noise_stddev: float = parameter(0.0, least=0.0)
    shot_noise: float = parameter(0.0, least=0.0)
    # must be above 0, because all images would be black with 0
    exposure: float = parameter(1.0, above=0.0)
    gain: float = parameter(1.0, above=0.0)
    vignetting: float = parameter(0.0, least=0.0, most=1.0)
    exposure_time: float = parameter(0.0, "s", least=0.0)
    exposure_samples: int = parameter(5, least=1, most=64)
    drop_probability: float = parameter(0.0, "(with 1, no image would "
                                             "arrive)", least=0.0, below=1.0)
    sensor: SensorModel | None = None
    auto_exposure: AutoExposure | None = None
    row_time: float = parameter(0.0, "s", least=0.0)
    rows_together: int = parameter(8, least=1)
    further: Mapping[str, Mapping[str, Any]] = parameter({})

    def __post_init__(self) -> None:
        check(self, CameraError, "effects")
        self.make_further()
        if self.sensor is None:
            return
        if self.shot_noise:
            raise CameraError(
                f"effects.shot_noise is {self.shot_noise:g}, but effects.sensor.gain already "
                "defines the shot noise; remove effects.shot_noise or effects.sensor"
            )
        if self.sensor.dark_current and not self.exposure_time:
            raise CameraError(
                f"effects.sensor.dark_current {self.sensor.dark_current:g} e-/s needs an "
                "exposure_time, which is 0: set one above 0, or remove the dark current"
            )

    def make_further(self) -> list[Effect]:
        """Create the effects that the field `further` names.

        Raises:
            CameraError: the name or a parameter of an effect is wrong.
        """
        return [EFFECTS.create(name, **values) for name, values in self.further.items()]


class EffectChain:
    """Applies the effects to images of one shape, in the order in which they occur in a camera.

    Random numbers depend only on the seed and the stamp. Therefore an image is the same in every
    run, even if earlier images were not rendered.
    """

    def __init__(self, effects: Effects, shape: tuple[int, ...], seed: int) -> None:
        """Prepare for images of `shape` (H, W) or (H, W, 3); `seed` is at least 0."""
        self.effects = e = effects
        self._seed = seed
        self._shade = _compute_vignette(shape, e.vignetting, e.exposure)
        # Properties of the sensor before the gain: shot-noise variance divided by the grey level,
        # and, in grey levels, dark signal, saturation and standard deviation of the read noise.
        self._shot, self._dark, self._full, self._read_noise = e.shot_noise, 0.0, 255.0, 0.0
        if (model := e.sensor) is not None:
            self._shot, self._read_noise = model.gain, model.gain * model.read_noise
            self._dark = model.gain * model.dark_current * e.exposure_time
            self._full = model.gain * model.full_well
        self._curve = self._compute_curve(1.0)
        self._registered_effects = e.make_further()

    def is_lost(self, stamp_ns: int) -> bool:
        """Return whether the frame with this stamp (simulated time, ns) is lost."""
        p = self.effects.drop_probability
        return bool(p) and self._make_generator(stamp_ns, _DROP).random() < p

    def _compute_curve(self, factor: float) -> np.ndarray | None:
        """Return the output level (256,) uint8 of each grey level of the light.

        The light is multiplied by `factor` and by the setting `exposure`, and clipped to 255. The
        result is multiplied by the setting `gain`, and clipped again. Return None if every level
        remains the same.
        """
        exposure, gain = factor * self.effects.exposure, self.effects.gain
        if exposure == gain == 1.0:
            return None
        wells = np.clip(np.arange(256) * exposure, 0.0, 255.0)
        return np.clip(np.round(wells * gain), 0, 255).astype(np.uint8)

    def apply(self, image: np.ndarray, stamp_ns: int, factor: float = 1.0) -> np.ndarray:
        """Return the uint8 image that the sensor delivers; it may be `image` itself.

        The light is multiplied by `factor`, which comes from the auto exposure.
        """
        e = self.effects
        for index, effect in enumerate(self._registered_effects, _FURTHER):
            image = effect.apply(image, self._make_generator(stamp_ns, index))
        if self._shot:
            return self._apply_shot_noise(image, stamp_ns, factor)
        if self._shade is not None:
            # Vignetting and gain are applied in one multiplication, because rounding between two
            # multiplications would cause visible steps in smooth areas.
            image = cv2.multiply(image, self._shade, scale=factor * e.gain, dtype=cv2.CV_8U)
            # The sensor saturates at 255 before the gain, so the largest value after the gain is
            # 255 * gain.
            if e.gain < 1.0:
                image = np.minimum(image, np.uint8(round(255.0 * e.gain)))
        else:
            curve = self._curve if factor == 1.0 else self._compute_curve(factor)
            image = image if curve is None else cv2.LUT(image, curve)
        if e.noise_stddev or e.noise_mean:
            # the image from a user's effect may be a strided view
            image = np.ascontiguousarray(image)
            out = np.empty_like(image)
            # Rounding to grey levels adds a variance of 1/12, so 1/12 is subtracted from the
            # variance of the added noise. At least half the standard deviation remains.
            stddev = math.sqrt(max(e.noise_stddev**2 - 1 / 12, (e.noise_stddev / 2)**2))
            _add_noise(image.reshape(-1), e.noise_mean, stddev, self._derive_key(stamp_ns),
                       out.reshape(-1))
            return out
        return image

    def _apply_shot_noise(self, image: np.ndarray, stamp_ns: int, factor: float) -> np.ndarray:
        """Add shot noise, read noise and Gaussian noise, and clip to 0..255.

        The variance of the whole noise is gain² (shot * light + read²) + noise_stddev², where
        `shot` is the variance of the shot noise divided by the grey level, and `read` is the
        standard deviation of the read noise, in grey levels.
        """
        e = self.effects
        if self._shade is not None:
            light = cv2.multiply(image, self._shade, scale=factor, dtype=cv2.CV_32F)
        else:
            light = image.astype(np.float32) * np.float32(factor * e.exposure)
        if self._dark:
            light = light + np.float32(self._dark)
        light = np.minimum(light, np.float32(self._full))
        spread = cv2.sqrt(light * np.float32(self._shot * e.gain**2)
                          + np.float32((self._read_noise * e.gain) ** 2 + e.noise_stddev**2))
        noise = np.empty(image.shape, np.float32)
        _fill_with_noise(self._derive_key(stamp_ns), noise.reshape(-1))
        out = light * np.float32(e.gain) + cv2.multiply(spread, noise)
        if e.noise_mean:
            out += np.float32(e.noise_mean)
        return cv2.convertScaleAbs(np.maximum(out, np.float32(0.0)))

    def _derive_key(self, stamp_ns: int) -> np.uint64:
        """Return the key from which the random numbers of an image's noise are derived."""
        seeds = np.random.SeedSequence([self._seed, stamp_ns, _NOISE])
        return seeds.generate_state(1, np.uint64)[0]

    def _make_generator(self, stamp_ns: int, use: int) -> np.random.Generator:
        return np.random.default_rng([self._seed, stamp_ns, use])


@jit_inline
def _draw_normal(key, n):
    """Return number n of a sequence of standard normal random numbers, float32.

    `key` (uint64) selects the sequence. The numbers are computed from uniform random numbers of
    splitmix64 (Steele, Lea and Flood 2014).
    """
    z = key + np.uint64(n) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z ^= z >> np.uint64(31)
    low = np.uint64(0xFFFF)
    total = (np.int32(z & low) + np.int32((z >> np.uint64(16)) & low)
             + np.int32((z >> np.uint64(32)) & low) + np.int32(z >> np.uint64(48)))
    s = np.float32(total - 2 * 0xFFFF) * np.float32(1.0 / 0x10000)
    q = s * s
    return s * (_C1 + q * (_C3 + q * (_C5 + q * _C7)))


@jit("u1[::1], f8, f8, u8, u1[::1]")
def _add_noise(image, mean, stddev, key, out):
    scale, half = np.float32(stddev), np.float32(mean + 0.5)
    for i in range(len(image)):
        grey = np.float32(image[i]) + half + scale * _draw_normal(key, i + 1)
        out[i] = np.uint8(min(max(grey, np.float32(0.0)), np.float32(255.0)))


@jit("u8, f4[::1]")
def _fill_with_noise(key, out):
    for i in range(len(out)):
        out[i] = _draw_normal(key, i + 1)


def _compute_vignette(shape: tuple[int, ...], loss: float, exposure: float) -> np.ndarray | None:
    """Return the factor by which exposure and vignetting change the light of each pixel, float32.

    The array has the given `shape`. The factors decrease with the square of the distance from the
    image centre, from `exposure` to (1 - loss) exposure in the corners. Return None if `loss` is 0.
    """
    if not loss:
        return None
    height, width = shape[:2]
    v, u = np.mgrid[:height, :width]
    x, y = u - (width - 1) / 2, v - (height - 1) / 2
    r2 = (x * x + y * y) / max((width / 2) ** 2 + (height / 2) ** 2, 1e-9)
    shade = ((1.0 - loss * r2) * exposure).astype(np.float32)
    return shade if len(shape) == 2 else np.repeat(shade[..., None], shape[2], axis=2)
