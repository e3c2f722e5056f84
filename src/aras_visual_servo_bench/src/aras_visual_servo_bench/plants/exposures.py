"""Times at which the cameras of a plant without a renderer expose their images."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aras_sim_bridge.camera.vibration import Vibration
from aras_visual_servo_controller.observation.frame import NANOSECONDS, Frame

from .imaging import ImagingSettings, capture


class ExposureSchedule:
    """Exposure times and frames of one camera.

    Attributes:
        due_ns: simulated time of the next exposure, ns; `expose` has to be called at this time.
    """

    def __init__(
        self, imaging: ImagingSettings, random: np.random.Generator, first: int = 1
    ) -> None:
        """Schedule the exposures of a camera.

        Args:
            imaging: settings of the camera.
            random: random generator of the noise of exact features.
            first: index of the first image; image k has the stamp k / rate.
        """
        self._imaging, self._random, self._count = imaging, random, first
        self._period = NANOSECONDS / imaging.rate
        self._pipeline = imaging.make_pipeline()
        self._poses: list[np.ndarray] = []
        self._stamp_ns = round(self._count * self._period)
        self.due_ns = self._stamp_ns + imaging.exposure_bands[0].offset_ns

    def expose(self, pose: np.ndarray) -> Frame | None:
        """Make the exposure that is due; if it completes an image, return the frame of this image.

        Return None if the image is not complete, or if it is dropped.

        pose: world_T_camera (4, 4) of the control camera, without vibration.
        """
        stamp_ns, poses, bands = self._stamp_ns, [*self._poses, pose], self._imaging.exposure_bands
        is_complete = len(poses) == len(bands)
        self._poses, self._count = [] if is_complete else poses, self._count + is_complete
        self._stamp_ns = round(self._count * self._period)
        self.due_ns = self._stamp_ns + bands[len(self._poses)].offset_ns
        if not is_complete or self._pipeline.is_lost(stamp_ns):
            return None
        return capture(self._imaging, poses, stamp_ns, self._random, self._pipeline)


def make_exposure_schedules(
    imaging: ImagingSettings,
    other_imaging: Sequence[ImagingSettings],
    random: np.random.Generator,
    seed: int,
) -> list[ExposureSchedule]:
    """Make the exposure schedules of all cameras, the control camera first.

    Args:
        imaging: settings of the control camera.
        other_imaging: settings of the other cameras.
        random: random generator of the control camera's noise.
        seed: seed from which the random generators of the other cameras are made.
    """
    # The seeds of the other cameras start at (seed, 1), because (seed, 0) gives the random numbers
    # of `seed`, which the control camera uses.
    return [ExposureSchedule(imaging, random)] + [
        ExposureSchedule(other, np.random.default_rng((seed, i)))
        for i, other in enumerate(other_imaging, 1)
    ]


def collect_vibrations(*settings: ImagingSettings) -> dict[str, Vibration]:
    """Return the vibration of each camera that shakes, by the name of the camera."""
    return {one.name: one.vibration for one in settings if one.vibration is not None}
