"""Vibration of a camera on its mounting. The visual-servo controller does not know of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aras_visual_servo_base.poses import inverse, matrix_from_xyz_rpy, optical_pose
from aras_visual_servo_base.settings import check, parameter

from ..errors import CameraError

SINE_COUNT = 16  # number of sines that approximate noise within a band
# part of the seed, so that the random numbers of vibrations differ from those of the camera's
# effects
SEED_SEQUENCE = 3
LINK_T_OPTICAL = optical_pose(np.eye(4))


@dataclass(frozen=True)
class Shake:
    """Settings of a vibration along and about the sensor's axes (x forward, y left, z up).

    The motion along and about each axis is a sine with a random phase, which depends on the seed of
    the camera.

    Attributes:
        frequency: frequency of the sines, Hz.
        xyz, rpy: amplitudes along and about the axes, m and rad.
        bandwidth: if it is not 0, each sine is replaced by noise of the same power in a band of
            this width around `frequency`, Hz.
    """

    frequency: float = parameter(unit="Hz", above=0.0)
    xyz: tuple[float, float, float] = parameter((0.0, 0.0, 0.0), "m", least=0.0, most=0.1)
    rpy: tuple[float, float, float] = parameter((0.0, 0.0, 0.0), "rad", least=0.0, most=0.5)
    bandwidth: float = parameter(0.0, "Hz", least=0.0)

    def __post_init__(self) -> None:
        check(self, CameraError, "shake")
        if self.bandwidth > 2.0 * self.frequency:
            raise CameraError(
                f"shake: a bandwidth of {self.bandwidth:g} Hz around {self.frequency:g} Hz would "
                "extend below 0 Hz; reduce the bandwidth"
            )

    def __str__(self) -> str:
        along, about = 1e3 * max(self.xyz), np.degrees(max(self.rpy))
        return f"by up to {along:.3g} mm and {about:.3g}° of amplitude at {self.frequency:g} Hz"


class Vibration:
    """Motion of a camera that vibrates. It can be computed for any time.

    Attributes:
        shake: settings of the vibration.
    """

    def __init__(self, shake: Shake, seed: int) -> None:
        self.shake = shake
        random = np.random.default_rng((seed, SEED_SEQUENCE))
        count = SINE_COUNT if shake.bandwidth else 1
        # Divide the band into `count` parts and draw one frequency in each, so that no part of the
        # band is empty.
        share = (np.arange(count) + random.random((6, count))) / count - 0.5
        self._rates = 2.0 * np.pi * (shake.frequency + shake.bandwidth * share)
        self._phases = random.uniform(0.0, 2.0 * np.pi, (6, count))
        self._amplitudes = np.array([*shake.xyz, *shake.rpy]) / np.sqrt(count)

    def compute_pose(self, time_ns: int) -> np.ndarray:
        """Return the pose (4, 4) of the optical frame at `time_ns`, relative to its rest pose."""
        sines = np.sin(self._rates * (time_ns / 1e9) + self._phases)
        displacement = self._amplitudes * sines.sum(axis=1)
        return (
            inverse(LINK_T_OPTICAL)
            @ matrix_from_xyz_rpy(displacement[:3], displacement[3:])
            @ LINK_T_OPTICAL
        )
