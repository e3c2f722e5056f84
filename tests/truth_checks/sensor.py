"""What a camera's sensor adds to its pictures: calibrated noise, motion blur, a rolling shutter."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from aras_sim_bridge.camera import CameraConfig, CameraSensor
from aras_sim_bridge.rendering import create_renderer

from .check import Row, check
from .robots import SOURCES

sys.path.append(str(SOURCES.parent / "tests" / "unit" / "camera"))

from scenes import Bench, link_pose, looking  # noqa: E402

_EYE = looking((0.0, 0.0, 0.6), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0))


@dataclass(frozen=True)
class _Figures:
    """Of a sensor, as an EMVA 1288 data sheet states them."""

    gain: float  # grey levels an electron
    full_well: float  # e-
    read_noise: float  # e-
    dark_current: float  # e-/s
    exposure_time: float  # s


_SENSORS = {
    "large pixels": _Figures(0.007, 32_000.0, 90.0, 30_000.0, 0.01),
    "small pixels": _Figures(0.09, 2_500.0, 12.0, 4_000.0, 0.02),
}


def _pairs(figures: _Figures, exposures: np.ndarray) -> Iterator[tuple[float, float]]:
    """Mean, and variance in time, of two pictures of a grey wall at each exposure."""
    bench = Bench()
    try:
        bench.box([5.0, 5.0, 0.05], [0, 0, -0.05], "Gazebo/Grey")
        renderer = create_renderer("exact", bench.world)
        for exposure in exposures:
            sensor = CameraSensor(CameraConfig.from_mapping({
                "width": 480, "height": 360, "format": "mono8", "seed": 3,
                "effects": {
                    "exposure": float(exposure), "exposure_samples": 1,
                    "exposure_time": figures.exposure_time, "noise_mean": 8.0,
                    "sensor": {key: getattr(figures, key) for key in (
                        "gain", "full_well", "read_noise", "dark_current")},
                }}), renderer)  # fmt: skip
            one, other = (sensor.capture(link_pose(_EYE), sensor.due_ns).image.astype(float)
                          for _ in range(2))  # fmt: skip
            yield (one + other).mean() / 2.0 - 8.0, (one - other).var() / 2.0
    finally:
        bench.close()


@check("EMVA 1288's photon transfer", quick=True)
def sensor_noise() -> Iterator[Row]:
    """The figures of two sensors, worked out from pairs of their pictures as the standard does."""
    for name, figures in _SENSORS.items():
        dark = figures.gain * figures.dark_current * figures.exposure_time
        lit = np.array(list(_pairs(figures, np.linspace(0.02, 1.3, 24))))
        mean, variance = lit.T
        slope, at_zero = np.polyfit(mean, variance - 1.0 / 12.0, 1)
        read = np.sqrt(at_zero) / slope
        ((shaded, _),) = _pairs(figures, np.array([1e-9]))
        ((brightest, _),) = _pairs(figures, np.array([50.0]))
        yield Row(f"{name}, gain", f"{figures.gain:g} grey levels/e-",
                  abs(slope / figures.gain - 1.0), 0.02)  # fmt: skip
        yield Row(f"{name}, read noise", f"{figures.read_noise:g} e-",
                  abs(read / figures.read_noise - 1.0), 0.05)  # fmt: skip
        yield Row(f"{name}, dark signal", f"{dark:.3g} grey levels", abs(shaded - dark), 0.05,
                  "grey levels")  # fmt: skip
        yield Row(f"{name}, full well", f"{figures.full_well:g} e-",
                  abs(brightest / figures.gain / figures.full_well - 1.0), 0.005)  # fmt: skip
