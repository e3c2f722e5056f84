"""Features in the formats of the original ARAS simulator.

The original simulator published kernel features in its version of 2015, and image moments in that
of 2016. Both are computed from a binary image (0 or 255) with the fixed threshold 250. The units
and conventions are those that the controllers of the original simulator need: x increases from row
to row and y from column to column, and m00 is a number of pixels. The orientation alpha of the
target's main axis is multiplied by 0.1.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from .errors import DegenerateFeatureError
from .moments import Pinhole
from .polygons import Array

# Size of a pixel in the original simulator, m: from row to row (x) and from column to column (y).
DELTA_X, DELTA_Y = 0.017, 0.0185
KERNEL_POWER = -2  # exponent p of the weighting functions x^p and y^p


@dataclass(frozen=True, eq=False)
class KernelFeatures:
    """Kernel features and the inverse of their Jacobian.

    Attributes:
        values: (4,) kernel0 ... kernel3, which `compute_kernel_features` defines.
        inverse: (4, 4) inverse of the Jacobian, whose columns belong to the camera's translation
            along x, y, z and its rotation theta about the optical axis.
    """

    values: Array
    inverse: Array

    def to_message_data(self) -> list[float]:
        """Return the 20 numbers of the topic camera/data.

        They are the inverse of the Jacobian row by row (16) and the features (4).
        """
        return [*self.inverse.ravel().tolist(), *self.values.tolist()]


def compute_kernel_features(mask: NDArray[np.uint8]) -> KernelFeatures:
    """Compute the kernel features of the nonzero pixels in a binary image (rows, columns).

    Row i = 1, 2, ... has the coordinate x = i DELTA_X, column j = 1, 2, ... has the coordinate
    y = j DELTA_Y, and dA is the area of a pixel. With p = KERNEL_POWER, the features are

        kernel0 = sum x^p dA,  kernel1 = sum y^p dA,  kernel2 = sum dA,
        kernel3 = 1/2 atan2(2 mu11, mu20 - mu02).

    The sums are over the nonzero pixels. mu_ij are their centred moments in pixels; here, i is the
    power of the column and j is the power of the row.

    Raises:
        DegenerateFeatureError: there is no target, so the Jacobian has no inverse.
    """
    rows, columns = mask.shape
    x = np.arange(1, rows + 1) * DELTA_X
    y = np.arange(1, columns + 1) * DELTA_Y
    is_target = (mask != 0).astype(np.float64)
    per_row, per_column = is_target.sum(axis=1), is_target.sum(axis=0)
    count = float(per_row.sum())
    if count == 0.0:
        raise DegenerateFeatureError(
            "kernel", "there is no target in view, so the Jacobian has no inverse"
        )
    dx, dy = KERNEL_POWER * x ** (KERNEL_POWER - 1), KERNEL_POWER * y ** (KERNEL_POWER - 1)
    area = DELTA_X * DELTA_Y
    central = cv2.moments(mask, binaryImage=True)
    angle = 0.5 * np.arctan2(2.0 * central["mu11"], central["mu20"] - central["mu02"])
    values = np.array(
        [x**KERNEL_POWER @ per_row * area, y**KERNEL_POWER @ per_column * area, count * area, angle]
    )
    jacobian = np.zeros((4, 4))
    jacobian[0, 0] = -dx @ per_row
    jacobian[0, 3] = dx @ is_target @ y
    jacobian[1, 1] = -dy @ per_column
    jacobian[1, 3] = -x @ is_target @ dy
    jacobian[2, 2] = 2.0 * count
    jacobian[3, 3] = -1.0
    return KernelFeatures(values, np.linalg.inv(jacobian))


def compute_outline_kernel_features(
    outline: NDArray[np.float64], camera: Pinhole, width: int, height: int
) -> KernelFeatures:
    """Compute the kernel features of a target with the normalised outline (n, 2).

    The outline is first drawn into an image of width x height pixels. A pixel belongs to the target
    if the target covers more than 2 % of it, because a camera's pixel is then darker than the
    threshold of 250 of the original simulator.

    Raises:
        DegenerateFeatureError: the target is not in the image.
    """
    finer = 16
    pixels = outline * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    fixed = ((pixels + 0.5) * finer - 0.5) * 256.0
    fine = np.zeros((height * finer, width * finer), np.uint8)
    cv2.fillPoly(fine, [np.round(fixed).astype(np.int32)], 255, shift=8)
    coverage = cv2.resize(fine, (width, height), interpolation=cv2.INTER_AREA)
    return compute_kernel_features((coverage > 0.02 * 255).astype(np.uint8) * 255)


def compute_original_moments(mask: NDArray[np.uint8], camera: Pinhole) -> list[float]:
    """Compute the four numbers that the original simulator of 2016 published.

    They are the normalised row and column of the target's centre, the target's number of pixels
    m00, and 0.1 alpha, where alpha = 1/2 atan2(2 mu11, mu20 - mu02), rad.

    Raises:
        DegenerateFeatureError: there is no target. (The original simulator published nan nan 0 0.)
    """
    m = cv2.moments(mask, binaryImage=True)
    if m["m00"] == 0.0:
        raise DegenerateFeatureError("moments", "there is no target")
    alpha = 0.5 * np.arctan2(2.0 * m["mu11"], m["mu20"] - m["mu02"])
    return [
        (m["m01"] / m["m00"] - camera.cy) / camera.fy,
        (m["m10"] / m["m00"] - camera.cx) / camera.fx,
        m["m00"],
        0.1 * float(alpha),
    ]
