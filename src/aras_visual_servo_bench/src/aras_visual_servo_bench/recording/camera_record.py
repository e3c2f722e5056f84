"""Images and poses of one camera during a run."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from aras_visual_servo_camera.camera_model import CameraModel

Film = tuple[tuple[float, bytes], ...]  # film of a run: stamp (s) and JPEG of each frame


@dataclass(frozen=True, eq=False)
class CameraRecord:
    """Images and poses of one camera during a run.

    Attributes:
        model: true intrinsics; None if unknown.
        stamp: (p,) time of exposure of each image, s.
        arrival: (p,) simulated time at which the recorder received each image, s.
        pose: (p, 4, 4) true world_T_camera of each image; empty if unknown.
        images: some of the images, in the order of time: stamp (s) and rgb (rows, columns, 3).
        film: film with more and smaller images, in the order of time: stamp (s) and JPEG; empty: a
            film is made of `images`.
    """

    model: CameraModel | None = None
    stamp: np.ndarray = field(default_factory=lambda: np.zeros(0))
    arrival: np.ndarray = field(default_factory=lambda: np.zeros(0))
    pose: np.ndarray = field(default_factory=lambda: np.zeros((0, 4, 4)))
    images: tuple[tuple[float, np.ndarray], ...] = ()
    film: Film = ()

    def __repr__(self) -> str:
        size = "unknown camera" if self.model is None else f"{self.model.width}x{self.model.height}"
        return (f"CameraRecord({size}, {len(self.stamp)} exposures, {len(self.images)} images "
                f"stored, {len(self.film)} frames of a film)")  # fmt: skip

    def find_nearest_image(self, stamp: float) -> np.ndarray | None:
        """Return the image that is nearest to a stamp (s); None if there are no images."""
        if not self.images:
            return None
        return min(self.images, key=lambda one: abs(one[0] - stamp))[1]
