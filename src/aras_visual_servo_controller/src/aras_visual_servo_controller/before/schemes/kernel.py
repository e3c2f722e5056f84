"""The 2015 scheme: kernel-based features of the binary image, law mended.

The camera node sends, with x = i dx along the rows and y = j dy along the columns of the image
(i, j from 1; dx = 0.017, dy = 0.0185 a pixel; I = 1 on the target),

    k0 = sum x^-2 I dx dy,  k1 = sum y^-2 I dx dy,  k2 = sum I dx dy,
    k3 = 1/2 atan2(2 mu11, mu20 - mu02)

k3 with columns as x, as OpenCV's moments have it, and the inverse of a 4x4 Jacobian J for
motions of the camera along the rows, along the columns, along its axis (relative to the
distance) and about its axis (from rows to columns).

What is wrong with that J as a derivative of k, and put right here (see the README for what each
one does to the closed loop):

- rows 0 to 2 lack the factor dx dy that k0 to k2 have: the coupling with the rotation, in the
  same rows, is thereby 3180 times too strong;
- the rotation is about the first pixel, that of a camera is about its principal point;
- row 3 turns the other way: k3 is measured from columns to rows, the rotation from rows to columns;
- approaching enlarges and spreads the target, which changes k0 and k1 as well; with the exponent
  -2 the two effects add up to xc J00 and yc J11 exactly;
- kernel units are scaled to metres by the depth and the focal length, so that the gain is a rate
  in 1/s; the original integrated over 0.01 s whatever time had passed, with gains of 200 and
  0.01 that make its time constants 5 s in translation and minutes in rotation.
"""

from typing import ClassVar

import numpy as np

from ...desired import Desired
from ...errors import ConfigurationError, MeasurementError
from ..laws import Law
from .base import Measurement, Scheme, SchemeResult, wrap

ROW_STEP = 0.017
COLUMN_STEP = 0.0185


class KernelScheme(Scheme):
    """Kernel features with their exact Jacobian, from the 20 numbers of camera/data.

    Features: kernel_0, kernel_1 (position along rows and columns), kernel_2 (area), kernel_3
    (orientation, rad). The errors are given relative to their desired values, the angle in rad.
    """

    source: ClassVar[str] = "kernel"
    feature_names: ClassVar[tuple[str, ...]] = ("kernel_0", "kernel_1", "kernel_2", "kernel_3")
    # 1 % of kernel 0 and 1 is half a pixel, 2 % of kernel 2 is 1 % of the distance.
    thresholds: ClassVar[tuple[float, ...]] = (0.01, 0.01, 0.02, 0.04)
    # One row of pixels turns the angle of a near-square by 0.03 rad from one image to the next;
    # at full gain the camera would tremble after it.
    angle_gain: ClassVar[float] = 0.3
    # The original's threshold of 250 takes a rim of pixels for target, of what is not white all.
    too_many: ClassVar[float] = 2.0

    def __init__(self, desired: Desired, law: Law) -> None:
        super().__init__(desired, law)
        if desired.kernel is None:
            raise ConfigurationError(
                f"{desired.name} holds no kernel features: teach them with the camera node's "
                "layout 'kernel' (rosrun aras_visual_servo_controller teach)"
            )
        if not (desired.kernel.features[:3] > 0.0).all():
            raise ConfigurationError(f"{desired.name}: kernel features 0 to 2 must be above 0")

    def compute(self, measurement: Measurement, elapsed: float) -> SchemeResult:
        """See Scheme.compute."""
        kernel = self.desired.kernel
        self._check_camera(measurement)
        data = measurement.kernel
        if data is None or np.shape(data) != (20,):
            size = "none" if data is None else str(np.size(data))
            raise MeasurementError(
                f"expected the 20 numbers of the kernel layout, got {size}: set the camera node's "
                "~layout to kernel"
            )
        data = np.asarray(data, float)
        k = data[16:]
        if not np.isfinite(data).all() or k[2] <= 0.0:
            raise MeasurementError("the target is not visible: the kernel features are empty")
        counted = round(k[2] / (ROW_STEP * COLUMN_STEP))
        if 0 < self.too_many * measurement.pixel_count < counted:
            raise MeasurementError(
                f"camera/data counts {counted} pixels as target, which has "
                f"{measurement.pixel_count}: the ground is noisy or not white; lower the camera "
                "node's ~original_threshold"
            )
        try:
            J = np.linalg.inv(data[:16].reshape(4, 4))
        except np.linalg.LinAlgError as error:
            raise MeasurementError("the kernel features' Jacobian is singular") from error

        e = k - kernel.features
        e[3] = wrap(e[3], np.pi)
        J_metric = self._metric_jacobian(J, measurement.K, k)
        weights = np.append(kernel.features[:3], 1.0)
        error = self.smoothed(e / weights, measurement.stamp)
        calmed = error * (1.0, 1.0, 1.0, self.angle_gain)
        v = self.law.velocity(J_metric / weights[:, None], calmed, elapsed)
        # Along the rows is the optical y, along the columns x; rows to columns turns against z.
        twist = np.array([v[1], v[0], v[2], 0.0, 0.0, -v[3]])
        return SchemeResult(self.feature_names, k, kernel.features, error, twist)

    def _metric_jacobian(self, J: np.ndarray, K: np.ndarray, k: np.ndarray) -> np.ndarray:
        """dk/dt per m/s along rows, columns and axis, and rad/s from rows to columns, (4, 4)."""
        area = ROW_STEP * COLUMN_STEP
        fx, fy = K[0, 0], K[1, 1]
        # Pixels are counted from 1 in the kernels, from 0 in K.
        row_centre, column_centre = (K[1, 2] + 1.0) * ROW_STEP, (K[0, 2] + 1.0) * COLUMN_STEP
        depth = self.desired.depth * np.sqrt(self.desired.kernel.features[2] / k[2])
        exact = np.zeros((4, 4))
        exact[0, 0] = area * J[0, 0] * fy * ROW_STEP / depth
        exact[1, 1] = area * J[1, 1] * fx * COLUMN_STEP / depth
        exact[:3, 2] = (
            np.array([row_centre * J[0, 0], column_centre * J[1, 1], J[2, 2]]) * area / depth
        )
        # A pixel is as wide as it is high in angle only if its steps say so: hence the ratios.
        across = (fy * ROW_STEP) / (fx * COLUMN_STEP)
        exact[0, 3] = area * (J[0, 3] + column_centre * J[0, 0]) * across
        exact[1, 3] = area * (J[1, 3] - row_centre * J[1, 1]) / across
        exact[3, 3] = -J[3, 3]
        return exact

    def _check_camera(self, measurement: Measurement) -> None:
        kernel = self.desired.kernel
        same_size = (measurement.width, measurement.height) == (kernel.width, kernel.height)
        if not (same_size and np.allclose(measurement.K, kernel.K, rtol=1e-3, atol=0.6)):
            raise MeasurementError(
                f"the kernel features of {self.desired.name} were taught with another camera "
                f"({kernel.width}x{kernel.height}, fx {kernel.K[0, 0]:.2f}; this one is "
                f"{measurement.width}x{measurement.height}, fx {measurement.K[0, 0]:.2f}): teach "
                "them anew (rosrun aras_visual_servo_controller teach)"
            )
