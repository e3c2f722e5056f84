"""Kinematics of a free camera: six coordinates without limits, with the interface of an arm."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aras_visual_servo_base.poses import inverse, logarithm, relative_pose
from aras_visual_servo_controller.errors import MeasurementError
from aras_visual_servo_controller.kinematics.algebra import is_finite
from aras_visual_servo_controller.kinematics.chain import Chain, compute_pose_and_jacobian
from aras_visual_servo_controller.kinematics.joint_sample import JointSample

COORDINATE_NAMES = ("x", "y", "z", "rx", "ry", "rz")


class FreeCameraKinematics:
    """Kinematics of a free camera, with the methods and attributes of `Arm`.

    The coordinates q (6,) are the logarithm of the pose of a body relative to an origin. They are
    unique if the rotation from the origin is less than pi. The body is the camera itself, or a
    frame in which the camera has a fixed pose.
    """

    names = COORDINATE_NAMES
    is_free = True
    camera_frame, base_frame, target_frame = "camera_optical_frame", "world", ""

    def __init__(self, origin: np.ndarray, mounting: np.ndarray | None = None) -> None:
        """Set the origin of the coordinates.

        Args:
            origin: world_T_body (4, 4) at q = 0.
            mounting: body_T_camera (4, 4), the fixed pose of the camera in the body; None: the body
                is the camera.
        """
        self.origin, self.mounting = np.array(origin, float), mounting
        self.chain = Chain.from_free_body(self.origin, mounting)
        # Latest argument of `pose_and_jacobian`, and its result.
        self._cache: tuple[bytes, tuple[np.ndarray, np.ndarray]] = (b"", ())
        self.upper = np.full(6, np.inf)
        self.lower = -self.upper
        self.velocity = self.effort = self.upper
        self.is_prismatic = np.array([True] * 3 + [False] * 3)
        # a free camera has no coordinate limits, so every finite coordinate is plausible
        largest = np.full(6, np.finfo(float).max)
        self.plausible_bounds = np.array([-largest, largest, largest])

    def __len__(self) -> int:
        """Return the number of coordinates."""
        return 6

    @property
    def is_compiled(self) -> bool:
        """Return whether compiled code may replace the methods: False for a subclass."""
        return type(self) is FreeCameraKinematics

    def pose(self, q: np.ndarray) -> np.ndarray:
        """Return world_T_camera (4, 4) at coordinates q (6,)."""
        return self.pose_and_jacobian(q)[0]

    def poses(self, positions: np.ndarray) -> np.ndarray:
        """Return world_T_camera (m, 4, 4) at m coordinates (m, 6)."""
        return self.chain.compute_poses(positions)

    def coordinates(self, world_T_camera: np.ndarray) -> np.ndarray:
        """Return the coordinates q (6,) of a camera pose (4, 4)."""
        body = world_T_camera
        if self.mounting is not None:
            body = world_T_camera @ inverse(self.mounting)
        return logarithm(relative_pose(self.origin, body))

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """Return J (6, 6) such that J @ q_dot is the camera's twist, in the camera frame."""
        return self.pose_and_jacobian(q)[1]

    def pose_and_jacobian(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return `pose(q)` and `jacobian(q)`; the arrays are read-only."""
        q = np.asarray(q, float)
        key, (cached_key, found) = q.tobytes(), self._cache
        # the result is cached, because several parts of the loop request it for each image
        if key != cached_key:
            found = np.empty((4, 4)), np.empty((6, 6))
            compute_pose_and_jacobian(*self.chain, q, *found)
            for array in found:
                array.setflags(write=False)
            self._cache = key, found
        return found

    def inverse_kinematics(
        self, world_T_camera: np.ndarray, q0: np.ndarray | None = None, tolerance: float = 0.0
    ) -> np.ndarray:
        """Return the coordinates q (6,) of a camera pose (4, 4).

        `q0` and `tolerance` have no effect."""
        return self.coordinates(world_T_camera)

    def joint_frames(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return origins (6, 3) and axes (6, 3) of six joints that correspond to the coordinates.

        The first three joints are prismatic, the last three are revolute.
        """
        return np.zeros((6, 3)), np.vstack([np.eye(3), np.eye(3)])

    def check(self, q: np.ndarray, velocities: np.ndarray | None = None) -> None:
        """Check that coordinates and velocities are finite.

        Raises:
            MeasurementError: a value is not finite.
        """
        speeds = q if velocities is None else velocities
        if not (is_finite(q) and is_finite(speeds)):
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
