"""The ideal plant: a camera that flies as the scheme's twist says, one exact motion an image.

What papers and tutorials compute: no arm, no limits of joints, no delay; the twist of one image
moves the camera by its exponential until the next.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aras_visual_servo_base.poses import exponential, inverse
from aras_visual_servo_controller.kinematics.differential_ik import DifferentialIK
from aras_visual_servo_controller.kinematics.ik_solution import IKSolution
from aras_visual_servo_controller.kinematics.task import Task

from .base import JointReading, Reading
from .free_body import FreeBody
from .imaging import NS, ExposureSchedule, ImagingSettings
from .kinematic import FreeCamera

ZERO_TWIST = np.zeros(6)


class IdealCamera(FreeCamera):
    """Takes the twist (6,) of the believed camera; the first image is at 0 s."""

    outputs = frozenset(("twist",))
    has_exact_plane = True

    def __init__(
        self,
        arm: FreeBody,
        calibrated_body: FreeBody,
        q: np.ndarray,
        imaging: ImagingSettings,
        seed: int = 0,
    ) -> None:
        """Stand at coordinates q (6,); `calibrated_body`: the same body with the camera as
        believed.
        """
        super().__init__(arm, q, imaging, seed=seed)
        self._calibrated_body, self._twist = calibrated_body, ZERO_TWIST
        self._exposures = [ExposureSchedule(imaging, self._random, first=0)]

    def advance(self, until_ns: int) -> list[Reading]:
        """Go to the next image, or to `until_ns` if it does not come before."""
        (exposure,) = self._exposures
        image_ns = exposure.due_ns
        time_ns = min(image_ns, until_ns)
        if self._twist is not ZERO_TWIST:
            mounting = self._calibrated_body.mounting
            motion = exponential(self._twist * ((time_ns - self.time_ns) / NS))
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

    def read_joints(self) -> tuple[np.ndarray, np.ndarray]:
        """Coordinates and their rates now."""
        q = self.arm.coordinates(self._pose)
        return q, np.linalg.solve(self._calibrated_body.jacobian(q), self._twist)

    def _set_command(self, kind: str, values: np.ndarray) -> None:
        self._twist = values if values.any() else ZERO_TWIST


class ExactIK(DifferentialIK):
    """Answers a task's own twist, slowed as a whole to the greatest speed.

    The coordinates' velocities are those that reach, at the next image, what the twist reaches.
    """

    def __init__(
        self, body: FreeBody, rate: float, max_speed: Sequence[float] | None = None
    ) -> None:
        """`rate`: images a second; `max_speed`: greatest m/s and rad/s of each component, or none.
        """
        super().__init__(body)
        self._period = 1.0 / rate
        self._max_speed = np.full(6, np.inf) if max_speed is None else np.repeat(max_speed, 3)

    def solve(
        self, q: np.ndarray, task: Task, dt: float, previous: np.ndarray | None = None
    ) -> IKSolution:
        """See Resolver.resolve; the same whatever `dt` and `previous`."""
        twist = task.twist / max(1.0, float((np.abs(task.twist) / self._max_speed).max()))
        moved = self.arm.pose(q) @ exponential(twist * self._period)
        velocities = (self.arm.coordinates(moved) - q) / self._period
        return IKSolution(
            velocities, velocities, twist, twist, ZERO_TWIST, 1.0, np.full(6, np.inf), (), "", (),
            task.L, self.arm.jacobian(q), task.modelled, np.inf,
        )  # fmt: skip
