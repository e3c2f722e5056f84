"""Kinematics of a free camera with the interface of an arm: six coordinates without limits."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aras_visual_servo_base.compiled import jit
from aras_visual_servo_base.poses import exponential, inverse, logarithm, relative_pose, skew
from aras_visual_servo_controller.errors import MeasurementError
from aras_visual_servo_controller.kinematics.joint_sample import JointSample

COORDINATE_NAMES = ("x", "y", "z", "rx", "ry", "rz")


class FreeBody:
    """Kinematics of a free camera, with the interface of `Arm`.

    The coordinates q (6,) are the logarithm of the pose of a body relative to an origin. They are
    unique if the rotation from the origin is less than pi. The body is the camera itself, or a
    frame to which a camera with a calibration error is fixed.

    The attributes are those of `Arm`.
    """

    names = COORDINATE_NAMES
    is_free = True
    camera_frame, base_frame, target_frame = "camera_optical_frame", "world", ""

    def __init__(self, origin: np.ndarray, mounting: np.ndarray | None = None) -> None:
        """Set the origin of the coordinates.

        Args:
            origin: world_T_body (4, 4) at q = 0.
            mounting: body_T_camera (4, 4) of a camera with a calibration error; None: the body is
                the camera.
        """
        self.origin, self.mounting = np.array(origin, float), mounting
        self.upper = np.full(6, np.inf)
        self.lower = -self.upper
        self.velocity = self.effort = self.upper
        self.is_prismatic = np.array([True] * 3 + [False] * 3)

    def __len__(self) -> int:
        """Return the number of coordinates."""
        return 6

    def pose(self, q: np.ndarray) -> np.ndarray:
        """Return world_T_camera (4, 4) at coordinates q (6,)."""
        body = self.origin @ exponential(q)
        return body if self.mounting is None else body @ self.mounting

    def coordinates(self, world_T_camera: np.ndarray) -> np.ndarray:
        """Return the coordinates q (6,) of a camera pose (4, 4)."""
        body = world_T_camera
        if self.mounting is not None:
            body = world_T_camera @ inverse(self.mounting)
        return logarithm(relative_pose(self.origin, body))

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """Return J (6, 6) such that J @ q_dot is the camera's twist, in the camera frame."""
        rates = _compute_right_jacobian(np.asarray(q, float))
        if self.mounting is None:
            return rates
        camera_R_body, position = self.mounting[:3, :3].T, self.mounting[:3, 3]
        rates[:3] -= skew(position) @ rates[3:]
        return np.vstack([camera_R_body @ rates[:3], camera_R_body @ rates[3:]])

    def pose_and_jacobian(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return `pose(q)` and `jacobian(q)`."""
        return self.pose(q), self.jacobian(q)

    def inverse_kinematics(
        self, world_T_camera: np.ndarray, q0: np.ndarray | None = None, tolerance: float = 0.0
    ) -> np.ndarray:
        """Return the coordinates q (6,) of a camera pose (4, 4).

        `q0` and `tolerance` have no effect."""
        return self.coordinates(world_T_camera)

    def joint_frames(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the origins (6, 3) and axes (6, 3) of the coordinates as joints.

        The first three joints are prismatic, the last three are revolute."""
        return np.zeros((6, 3)), np.vstack([np.eye(3), np.eye(3)])

    def check(self, q: np.ndarray, velocities: np.ndarray | None = None) -> None:
        """Check that coordinates and velocities are finite.

        Raises:
            MeasurementError: a value is not finite.
        """
        for values in (q, velocities):
            if values is not None and not np.isfinite(values).all():
                raise MeasurementError("a coordinate of the free camera is not finite")

    def read_joints(
        self,
        names: Sequence[str],
        positions: Sequence[float],
        velocities: Sequence[float] = (),
        stamp: float = 0.0,
    ) -> JointSample:
        """Return the coordinates as a JointSample with the coordinate names of this class."""
        q = np.array(positions, float)
        speed = np.array(velocities, float) if len(velocities) else np.zeros(6)
        self.check(q, speed)
        return JointSample(stamp, self.names, q, speed)


@jit("f8[:]")
def _compute_right_jacobian(twist):
    """Compute the right Jacobian J (6, 6) of the exponential map of SE(3).

    If a_T_b = exponential(twist), then J @ d(twist)/dt is the twist of b, in the frame of b. J is
    the sum of (-ad(twist))^k / (k + 1)! over k >= 0, to machine precision.
    """
    vx, vy, vz, x, y, z = twist
    turn, move = np.zeros((3, 3)), np.zeros((3, 3))
    turn[0, 1], turn[0, 2], turn[1, 0], turn[1, 2], turn[2, 0], turn[2, 1] = -z, y, z, -x, -y, x
    move[0, 1], move[0, 2], move[1, 0], move[1, 2], move[2, 0], move[2, 1] = (
        -vz, vy, vz, -vx, -vy, vx
    )  # fmt: skip
    # Only the upper three rows of J are summed. Its lower right block equals its upper left block,
    # and its lower left block is zero.
    rate, term, following, k = np.zeros((3, 6)), np.zeros((3, 6)), np.empty((3, 6)), 1
    for i in range(3):
        rate[i, i] = term[i, i] = 1.0
    largest = 1.0
    while largest > 1e-17:
        k, largest = k + 1, 0.0
        for i in range(3):
            for j in range(6):
                total = 0.0
                for m in range(3):
                    total -= turn[i, m] * term[m, j]
                    if j > 2:
                        total -= move[i, m] * term[m, j - 3]
                following[i, j] = total / k
                largest = max(largest, abs(following[i, j]))
        term, following = following, term
        for i in range(3):
            for j in range(6):
                rate[i, j] += term[i, j]
    whole = np.zeros((6, 6))
    for i in range(3):
        for j in range(3):
            whole[i, j] = whole[3 + i, 3 + j] = rate[i, j]
            whole[i, 3 + j] = rate[i, 3 + j]
    return whole
