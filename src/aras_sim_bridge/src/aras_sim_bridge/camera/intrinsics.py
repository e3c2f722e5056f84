"""Intrinsics in CameraInfo, and the projection of the rendered image.

As in OpenCV and ROS, pixel centres have integer coordinates, so the centre of an image that is w
pixels wide is at (w - 1) / 2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .lens import BrownLens, FisheyeLens


@dataclass(frozen=True)
class CameraIntrinsics:
    """Content of sensor_msgs/CameraInfo.

    Attributes:
        width, height: image size, px.
        K: (3, 3) camera matrix, px.
        D: distortion coefficients in ROS's order for `model`.
        model: 'plumb_bob', 'rational_polynomial' or 'equidistant'.
        R: (3, 3) rectification matrix.
        P: (3, 4) projection matrix.
    """

    width: int
    height: int
    K: np.ndarray
    D: tuple[float, ...]
    model: str
    R: np.ndarray
    P: np.ndarray

    def __post_init__(self) -> None:
        for array in (self.K, self.R, self.P):
            array.setflags(write=False)


@dataclass(frozen=True)
class RenderProjection:
    """Projection of the rendered image.

    Attributes:
        K: (3, 3) camera matrix, px.
        lens: lens model at unit focal length.
    """

    K: np.ndarray
    lens: BrownLens | FisheyeLens

    def project(self, points: np.ndarray) -> np.ndarray:
        """Project points (N, 3) in the optical frame (m) to pixels u, v (N, 2)."""
        xy = self.lens.project(np.asarray(points, dtype=float))
        return xy * [self.K[0, 0], self.K[1, 1]] + self.K[:2, 2]

    def unproject(self, pixels: np.ndarray) -> np.ndarray:
        """Return the unit rays (N, 3) of pixels (N, 2), in the optical frame.

        A pixel that no ray reaches, such as one outside a fisheye's image circle, gets NaN.
        """
        pixels = np.asarray(pixels, dtype=float)
        return self.lens.unproject((pixels - self.K[:2, 2]) / [self.K[0, 0], self.K[1, 1]])

    @property
    def is_pinhole(self) -> bool:
        """Whether straight lines remain straight in the image."""
        return isinstance(self.lens, BrownLens) and not any(self.lens.D)


def camera_matrix(fx: float, fy: float, cx: float, cy: float) -> np.ndarray:
    """Return the camera matrix K (3, 3) without skew, px."""
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def projection_matrix(K: np.ndarray, baseline: float) -> np.ndarray:
    """Return CameraInfo's projection matrix P (3, 4) of a camera whose images are not rectified.

    P contains the camera matrix K (3, 3), px, and -fx `baseline` in its last column, where
    `baseline` (m) is the distance from the left to the right camera of a stereo pair.
    """
    P = np.zeros((3, 4))
    P[:, :3] = K
    P[0, 3] = -K[0, 0] * baseline
    return P
