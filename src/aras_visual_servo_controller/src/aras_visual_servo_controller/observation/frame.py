"""What a camera delivers of one exposure: an image, exact features, or a camera node's moments."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aras_visual_servo_camera.moments import Moments
from aras_visual_servo_camera.undistortion import CameraModel

from .observation import CAMERA

NANOSECONDS = 1_000_000_000


def to_seconds(stamp_ns: int) -> float:
    """A stamp in s, rounded as ROS rounds it, so that it is the same number on a graph."""
    return float(stamp_ns // NANOSECONDS) + (stamp_ns % NANOSECONDS) / 1e9


@dataclass(frozen=True, eq=False)
class MeasuredTarget:
    """Target in an image that another process segmented.

    Attributes:
        moments: normalised coordinates; None: not measured.
        valid, reason: whether the target was found, and why not.
        kernel: (20,) the original's camera/data; None: not measured.
        pixel_count: pixels of the target.
        touches: borders of the image that it touches.
    """

    moments: Moments | None
    valid: bool = True
    reason: str = ""
    kernel: np.ndarray | None = None
    pixel_count: int = 0
    touched_borders: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Frame:
    """One exposure of a camera; with neither an image nor features the target is not in view.

    Comes from a renderer, a bag or a topic; `observe` makes an `Observation` of it. Pixels are
    (row, column) in arrays and (u, v), right and down, in outlines and points.

    Attributes:
        stamp_ns: of the exposure, ns of simulated time.
        image: (rows, columns[, channels]) uint8, in the encoding `encoding`; None: no image.
        depth: (rows, columns), m along the optical axis; None: no depth image.
        outline, points: (n, 2) and (m, 2) exact outline and corners of the target, px.
        name: of the camera.
        labelled: (rows, columns), 255 where a label image has the target; None: no label image.
        jitter: standard deviation of the noise in outline and points, px.
        camera: intrinsics of the camera that made it; None: the reader knows them.
        target: moments in place of an image; None: there are none.
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
        """`stamp_ns` in s."""
        return to_seconds(self.stamp_ns)

    @property
    def has_image(self) -> bool:
        """Whether it has an image."""
        return self.image is not None
