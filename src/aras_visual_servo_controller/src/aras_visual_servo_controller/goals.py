"""The laboratory's two goals, and what an exact camera sees of the demo's target there."""

import cv2
import numpy as np

from aras_visual_servo_camera.kernel import kernel_features
from aras_visual_servo_camera.moments import Moments

from .desired import Desired, DesiredKernel
from .kinematics import Kinematics
from .target import desired_view

# Desired poses by year: gantry (m), J1, J2, J3, J5, J6 (rad).
DESIRED_JOINTS = {
    "2015": (0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    "2016": (0.05, 0.0, -0.09, 0.045, 0.045, 0.0),
}
ORIGINAL_SIZE, ORIGINAL_FOV = (320, 240), 2.0  # pixels, rad: the camera of 2015
ORDER = 3  # the paper's features with their interaction matrix need no more


def from_geometry(joints: np.ndarray, name: str, kinematics: Kinematics | None = None) -> Desired:
    """What a perfect camera sees of the demo's target at these joints (6,).

    The kernel features are those of the original camera, 320 x 240 pixels.

    Raises:
        ServoError: the target is not before the camera.
    """
    joints = np.asarray(joints, float)
    kinematics = kinematics if kinematics is not None else Kinematics()
    view, depth = desired_view(joints, kinematics)
    moments = Moments.from_polygon(view, ORDER)
    m, mu, kernel = moments.m_array, moments.mu_array, _kernel_of(view)
    return Desired(name, joints, depth, ORDER, m, mu, kernel, kinematics.mounting)


def _kernel_of(view: np.ndarray) -> DesiredKernel:
    """Kernel features of an outline (n, 2) as the original's threshold of 250 makes it black.

    A white pixel that the target covers by more than 2 % is darker than 250.
    """
    width, height = ORIGINAL_SIZE
    focal = 0.5 * width / np.tan(0.5 * ORIGINAL_FOV)
    K = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
    finer = 16
    pixels = ((view * focal + K[:2, 2] + 0.5) * finer - 0.5) * 256.0
    fine = np.zeros((height * finer, width * finer), np.uint8)
    cv2.fillPoly(fine, [np.round(pixels).astype(np.int32)], 255, shift=8)
    coverage = cv2.resize(fine, (width, height), interpolation=cv2.INTER_AREA)
    mask = (coverage > 0.02 * 255).astype(np.uint8) * 255
    return DesiredKernel(width, height, K, kernel_features(mask).values)
