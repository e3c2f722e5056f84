"""The kernel features of the laboratory's controller of 2015, with a corrected derivative.

The camera node publishes the four features

    k0 = sum x^-2 I dx dy,  k1 = sum y^-2 I dx dy,  k2 = sum I dx dy,
    k3 = 1/2 atan2(2 mu11, mu20 - mu02)

where x = i dx along the rows and y = j dy along the columns of the image (i, j from 1; dx = 0.017
and dy = 0.0185 per pixel), and I = 1 on the target, 0 elsewhere. k3 is the angle of the target,
with columns as x. The node also publishes the inverse of a 4x4 matrix J, which is meant to be the
derivative of k for camera motions along the rows, along the columns, along the optical axis
(relative to the distance) and about the optical axis (from rows to columns).

J contains the following errors, which this module corrects. The README describes their effects on
the closed loop.

- Rows 0 to 2 of J lack the factor dx dy of k0 to k2. Therefore the coupling of k0 to k2 with the
  rotation is 1 / (dx dy) = 3180 times too strong.
- The rotation is about the first pixel instead of the principal point.
- The sign of row 3 is wrong: k3 is measured from columns to rows, but the rotation from rows to
  columns.
- J lacks the effect of an approach on k0 and k1: the target's image becomes larger and moves away
  from the principal point (xc, yc). The effect is xc J00 on k0 and yc J11 on k1.
- Depth and focal length are missing. Here they convert kernel units to metres, so that the gain is
  a rate in 1/s.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from aras_visual_servo_camera.kernel import DELTA_X, DELTA_Y

from ..errors import ConfigurationError, MeasurementError
from ..goals.goal import Goal, GoalKernel
from ..observation.observation import Need, Observation
from .base import FEATURES, Feature, FeatureMeasurement, compare_cameras, wrap
from .moments import LEVEL_CAMERA


@FEATURES.register("kernel")
class Kernel(Feature):
    """Kernel features: kernel_0 and kernel_1 (position), kernel_2 (area), kernel_3 (angle).

    The errors of kernel_0 to kernel_2 are relative to the desired values; kernel_3 is in rad.

    Attributes:
        ratio: factors on the gain of each feature. The factor of kernel_3 is smaller, because a
            change of a single row of pixels changes the angle of a nearly square target by 0.03
            rad. At the full gain, this noise would shake the camera.
        max_pixel_ratio: largest accepted ratio of the pixels that the kernels count to the pixels
            of the segmented target. The kernels count every pixel that is not white (grey level
            below 250).
    """

    needs = frozenset((Need.KERNEL,))
    names = ("kernel_0", "kernel_1", "kernel_2", "kernel_3")
    # Half a pixel changes kernel_0 or kernel_1 by 1 %. A change of the distance by 1 % changes
    # kernel_2 by 2 %.
    tolerances = (0.01, 0.01, 0.02, 0.04)
    units = ("", "", "", "rad")
    directions = LEVEL_CAMERA
    ratio: ClassVar[tuple[float, ...]] = (1.0, 1.0, 1.0, 0.3)
    max_pixel_ratio: ClassVar[float] = 2.0

    def check(self, goal: Goal) -> None:
        """Refuse a goal that this feature cannot servo to."""
        if goal.kernel is None:
            raise ConfigurationError(
                f"{goal.name} holds no kernel features: teach them (rosrun "
                "aras_visual_servo_controller teach --scheme kernel)"
            )
        if not (goal.kernel.features[:3] > 0.0).all():
            raise ConfigurationError(f"{goal.name}: kernel features 0 to 2 must be above 0")
        goal.check_depth()

    def measure(self, observation: Observation, goal: Goal) -> FeatureMeasurement:
        """Measure s, s*, the error and L in one image."""
        kernel = goal.kernel
        self._check_camera(observation, goal)
        data = observation.kernel
        if data is None or data.shape != (20,):
            size = "none" if data is None else str(data.size)
            raise MeasurementError(
                f"expected the 20 numbers of camera/kernel, got {size}: use a camera node that "
                "publishes the kernel features"
            )
        k = data[16:]
        if not np.isfinite(data).all() or k[2] <= 0.0:
            raise MeasurementError("the target is not visible: the kernel features are empty")
        counted = round(k[2] / (DELTA_X * DELTA_Y))
        if 0 < self.max_pixel_ratio * observation.pixel_count < counted:
            raise MeasurementError(
                f"the topic camera/kernel counts {counted} pixels of the target, but it has "
                f"{observation.pixel_count} pixels: the background is noisy or not white; lower "
                "the camera node's ~original_threshold"
            )
        try:
            J = np.linalg.inv(data[:16].reshape(4, 4))
        except np.linalg.LinAlgError as error:
            raise MeasurementError(
                "camera/kernel: the kernel features' Jacobian is singular; check the camera node"
            ) from error
        depth = goal.depth * np.sqrt(kernel.features[2] / k[2])
        L = _compute_interaction(J, np.reshape(observation.camera.K, (3, 3)), depth)
        scale = np.append(kernel.features[:3], 1.0)
        error = (k - kernel.features) / scale
        error[3] = wrap(error[3], np.pi)
        return FeatureMeasurement(k, kernel.features, error, L / scale[:, None], ambiguity="180°")

    def accuracy(self, observation: Observation, goal: Goal) -> np.ndarray | None:
        """Return the accuracy of s.

        The tolerances are used, because an error of one row of pixels changes a feature by about
        its tolerance.
        """
        return np.diag(self.tolerances)

    @staticmethod
    def _check_camera(observation: Observation, goal: Goal) -> None:
        kernel: GoalKernel = goal.kernel
        if difference := compare_cameras(
            kernel.width, kernel.height, kernel.K, observation.camera
        ):
            raise MeasurementError(
                f"the kernel features of {goal.name} were taught with another camera "
                f"({difference}): teach them again (rosrun aras_visual_servo_controller teach)"
            )


def _compute_interaction(J: np.ndarray, K: np.ndarray, depth: float) -> np.ndarray:
    """Compute L (4, 6) with dk/dt = L v from the published J (4, 4); see the module docstring."""
    area = DELTA_X * DELTA_Y
    fx, fy = K[0, 0], K[1, 1]
    # The kernels count pixels from 1, the camera matrix K counts pixels from 0.
    row_centre, column_centre = (K[1, 2] + 1.0) * DELTA_X, (K[0, 2] + 1.0) * DELTA_Y
    # Along the kernel's x and y, a pixel measures DELTA_X and DELTA_Y in kernel units, and 1 / fy
    # and 1 / fx in normalised coordinates. `across` is the scale factor of x divided by that of y.
    across = (fy * DELTA_X) / (fx * DELTA_Y)
    L = np.zeros((4, 6))
    # The kernel's x axis is along the optical y axis, and its y axis along the optical x axis. A
    # rotation from x to y is therefore negative about the optical z axis.
    L[1, 0] = area * J[1, 1] * fx * DELTA_Y / depth
    L[0, 1] = area * J[0, 0] * fy * DELTA_X / depth
    L[:3, 2] = np.array([row_centre * J[0, 0], column_centre * J[1, 1], J[2, 2]]) * area / depth
    L[0, 5] = -area * (J[0, 3] + column_centre * J[0, 0]) * across
    L[1, 5] = -area * (J[1, 3] - row_centre * J[1, 1]) / across
    L[3, 5] = J[3, 3]
    return L
