"""Ideal plant: a free camera that executes the scheme's twist exactly until the next image.

Like simulations in papers and tutorials, it has no arm, no joint limits and no delay. The motion
of the camera is the exponential of the twist.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aras_visual_servo_base.poses import exponential, inverse
from aras_visual_servo_controller.kinematics.differential_ik import DifferentialIK
from aras_visual_servo_controller.kinematics.ik_solution import IKSolution
from aras_visual_servo_controller.kinematics.task import Task
from aras_visual_servo_controller.observation.frame import NANOSECONDS

from .base import JointReading, Reading
from .exposures import ExposureSchedule
from .free_camera_kinematics import FreeCameraKinematics
from .imaging import ImagingSettings
from .kinematic import FreeCamera

ZERO_TWIST = np.zeros(6)


class IdealCamera(FreeCamera):
    """Free camera that is commanded by its twist (6,), in the camera frame.

    If the controller's calibration is wrong, the twist is that of the camera at its calibrated
    pose. The first image is taken at 0 s.
    """

    outputs = frozenset(("twist",))
    has_exact_plane = True

    def __init__(
        self,
        arm: FreeCameraKinematics,
        calibrated_body: FreeCameraKinematics,
        q: np.ndarray,
        imaging: ImagingSettings,
        seed: int = 0,
    ) -> None:
        """Place the camera at coordinates q (6,).

        Args:
            arm: true kinematics of the camera.
            calibrated_body: kinematics that the controller assumes.
            q: initial coordinates (6,).
            imaging: settings of the camera.
            seed: seed of the noise.
        """
        super().__init__(arm, q, imaging, seed=seed)
        self._pose = arm.pose(q)
        self._calibrated_body, self._twist = calibrated_body, ZERO_TWIST
        self._exposures = [ExposureSchedule(imaging, self._random, first=0)]

    def advance(self, until_ns: int) -> list[Reading]:
        """Advance to the next image, or to `until_ns` if that is earlier; see Plant.advance."""
        (exposure,) = self._exposures
        image_ns = exposure.due_ns
        time_ns = min(image_ns, until_ns)
        if self._twist is not ZERO_TWIST:
            mounting = self._calibrated_body.mounting
            motion = exponential(self._twist * ((time_ns - self.time_ns) / NANOSECONDS))
            self._pose = self._pose @ mounting @ motion @ inverse(mounting)
        self.time_ns = time_ns
        if image_ns > time_ns:
            return []
        q, speed = self.read_joints()
        image = exposure.expose(self.read_rest_pose())
        return [
            JointReading(time_ns, self.joint_names, q.tolist(), speed.tolist()),
            *([] if image is None else [image]),
        ]

    def read_rest_pose(self) -> np.ndarray:
        """Return world_T_camera (4, 4) of the camera, without vibration."""
        return self._pose.copy()

    def read_joints(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the coordinates (6,) and their rates (6,)."""
        q = self.arm.coordinates(self._pose)
        return q, np.linalg.solve(self._calibrated_body.jacobian(q), self._twist)

    def _set_command(self, kind: str, values: np.ndarray) -> None:
        self._twist = values if values.any() else ZERO_TWIST


class IdealCameraIK(DifferentialIK):
    """Inverse kinematics of the ideal camera.

    The twist of the task is scaled down to respect the speed limits. The velocities of the
    coordinates are constant and lead to the pose that the camera has at the next image.
    """

    def __init__(
        self, body: FreeCameraKinematics, rate: float, max_speed: Sequence[float] | None = None
    ) -> None:
        """Set the limits.

        Args:
            body: kinematics that the controller assumes.
            rate: number of images per second.
            max_speed: maximum absolute value of each translational (m/s) and of each rotational
                (rad/s) component of the twist; None: no limits.
        """
        super().__init__(body)
        self._period = 1.0 / rate
        self._max_speed = np.full(6, np.inf) if max_speed is None else np.repeat(max_speed, 3)

    def solve(
        self, q: np.ndarray, task: Task, dt: float, previous: np.ndarray | None = None
    ) -> IKSolution:
        """Return the scaled twist of the task, and the velocities of the coordinates.

        `dt` and `previous` have no effect. See DifferentialIK.solve.
        """
        twist = task.twist / max(1.0, float((np.abs(task.twist) / self._max_speed).max()))
        moved = self.arm.pose(q) @ exponential(twist * self._period)
        velocities = (self.arm.coordinates(moved) - q) / self._period
        return IKSolution(
            velocities, velocities, twist, twist, ZERO_TWIST, 1.0, np.full(6, np.inf), (), "", (),
            task.L, self.arm.jacobian(q), task.modelled, np.inf,
        )  # fmt: skip
