"""Frame: the data of one exposure of a camera.

A frame contains an image, or the exact outline and corners of the target, or the moments that a
camera node measured.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_camera.moments import Moments

from .observation import CAMERA

NANOSECONDS = 1_000_000_000


def to_seconds(stamp_ns: int) -> float:
    """Convert a stamp from ns to s.

    The result is rounded as in ROS, so that both give the same number.
    """
    return float(stamp_ns // NANOSECONDS) + (stamp_ns % NANOSECONDS) / 1e9


@dataclass(frozen=True, eq=False)
class MeasuredTarget:
    """Target measured by another process, such as the camera node.

    Attributes:
        moments: moments in normalised coordinates; None if they were not measured.
        valid: whether the target was found.
        reason: why it was not found.
        kernel: (20,) kernel features, as on the topic camera/data; None if they were not measured.
        pixel_count: number of pixels of the target.
        touched_borders: borders of the image that the target touches.
    """

    moments: Moments | None
    valid: bool = True
    reason: str = ""
    kernel: np.ndarray | None = None
    pixel_count: int = 0
    touched_borders: tuple[str, ...] = ()


@dataclass(eq=False)
class Frame:
    """One exposure of a camera.

    A frame comes from a renderer, a bag or a topic; `observe` turns it into an `Observation`. If it
    has neither an image nor features, the target is not in view. Pixels are indexed (row, column)
    in arrays. In outlines and points they have coordinates (u, v), to the right and downwards.

    Attributes:
        stamp_ns: time of the exposure, ns of simulated time.
        stamp: the same time, s; computed from `stamp_ns`.
        image: (rows, columns[, channels]) uint8, in the encoding `encoding`; None if there is no
            image.
        depth: (rows, columns) depth along the optical axis, m; None if there is no depth image.
        outline: (n, 2) exact outline of the target, px.
        points: (m, 2) exact corners of the target, px.
        name: name of the camera.
        target_mask: (rows, columns), 255 for the target's pixels of a label image; None if there is
            no label image.
        jitter: standard deviation of the noise in the coordinates of `outline` and `points`, px.
        camera: intrinsics of the camera; None if they are passed to `observe` separately.
        target: target that was measured by another process, instead of an image; or None.
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

    def __post_init__(self) -> None:
        self.stamp = to_seconds(self.stamp_ns)

    @property
    def has_image(self) -> bool:
        """Return whether the frame has an image."""
        return self.image is not None
