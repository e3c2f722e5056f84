"""Frame: the data of one exposure, which are an image, exact features, or a camera node's moments.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aras_visual_servo_camera.moments import Moments
from aras_visual_servo_camera.undistortion import CameraModel

from .observation import CAMERA

NANOSECONDS = 1_000_000_000


def to_seconds(stamp_ns: int) -> float:
    """Convert a stamp to s, rounded as in ROS, so that both give the same number."""
    return float(stamp_ns // NANOSECONDS) + (stamp_ns % NANOSECONDS) / 1e9


@dataclass(frozen=True, eq=False)
class MeasuredTarget:
    """Target measured by another process, such as the camera node.

    Attributes:
        moments: in normalised coordinates; None: not measured.
        valid, reason: whether the target was found, and why not.
        kernel: (20,) camera/data of the original package; None: not measured.
        pixel_count: number of pixels of the target.
        touched_borders: borders of the image that the target touches.
    """

    moments: Moments | None
    valid: bool = True
    reason: str = ""
    kernel: np.ndarray | None = None
    pixel_count: int = 0
    touched_borders: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Frame:
    """One exposure of a camera; without an image and features, the target is not in view.

    A frame comes from a renderer, a bag or a topic; `observe` turns it into an `Observation`.
    Pixels are (row, column) in arrays and (u, v), right and down, in outlines and points.

    Attributes:
        stamp_ns: time of the exposure, ns of simulated time.
        image: (rows, columns[, channels]) uint8, in the encoding `encoding`; None: no image.
        depth: (rows, columns), m along the optical axis; None: no depth image.
        outline, points: (n, 2) and (m, 2) exact outline and corners of the target, px.
        name: of the camera.
        target_mask: (rows, columns), 255 for the target's pixels of a label image; None: no label
            image.
        jitter: standard deviation of the noise in outline and points, px.
        camera: intrinsics of the camera; None: the reader knows them.
        target: moments instead of an image, or None.
    """

    stamp_ns: int
    image: np.ndarray | None = None
    encoding: str = ""
    depth: np.ndarray | None = None
    outline: np.ndarray | None = None
    points: np.ndarray | None = None
    name: str = CAMERA
    target_mask: np.ndarray | None = None
    jitter: float = 0.0
    camera: CameraModel | None = None
    target: MeasuredTarget | None = None

    @property
    def stamp(self) -> float:
        """Return `stamp_ns` in s."""
        return to_seconds(self.stamp_ns)

    @property
    def has_image(self) -> bool:
        """Return whether the frame has an image."""
        return self.image is not None
