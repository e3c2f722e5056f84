"""Plants without physics: a chain of joints that lags, a camera that flies.

Time goes from one measurement to the next in a single exact step, however long it is.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence

import numpy as np

from aras_visual_servo_base.poses import exponential
from aras_visual_servo_controller.kinematics import Arm

from ..errors import ExperimentError
from .base import JointReading, Plant, Reading
from .free_body import FreeBody
from .imaging import NS, ImagingSettings, collect_vibrations, make_exposure_schedules

JOINT_PHASE_NS = 1_000_000  # joint states come a millisecond after the hundredths, as in physics


class KinematicPlant(Plant):
    """Coordinates that follow their commands; what chain and free camera share."""

    outputs = frozenset(("position", "velocity"))
    time_ns = 0

    def __init__(
        self,
        arm: Arm | FreeBody,
        q: np.ndarray,
        imaging: ImagingSettings,
        joint_rate: float = 100.0,
        lag: float = 0.0,
        seed: int = 0,
        other_imaging: Sequence[ImagingSettings] = (),
    ) -> None:
        """Stand at joints q (n,).

        Args:
            sight: of the control camera. others: of the other cameras.
            joint_rate: joint states a second. lag: time constant of every joint, s.
        """
        self.arm, self.imaging, self.camera = arm, imaging, imaging.camera
        self.joint_names = tuple(arm.names)
        self._random = np.random.default_rng(seed)
        self._exposures = make_exposure_schedules(imaging, other_imaging, self._random, seed)
        self.control_camera_name, self.vibrations = (
            imaging.name,
            collect_vibrations(imaging, *other_imaging),
        )
        self._image_ns = min(one.due_ns for one in self._exposures)
        self._lag = lag
        self.time_ns = 0
        self._q = np.array(q, float)
        self._speed = np.zeros_like(self._q)
        self._kind, self._command = "position", self._q.copy()
        self._joint_period, self._samples = NS / joint_rate, 0

    def advance(self, until_ns: int) -> list[Reading]:
        """Go to the next measurement, or to `until_ns` if none comes before."""
        joints_ns = JOINT_PHASE_NS + round(self._samples * self._joint_period)
        time_ns = min(joints_ns, self._image_ns, until_ns)
        if time_ns > self.time_ns:
            self._move((time_ns - self.time_ns) / NS)
            self.time_ns = time_ns
        readings: list[Reading] = []
        if joints_ns == time_ns:
            self._samples += 1
            q, speed = self.read_joints()
            readings.append(JointReading(time_ns, self.joint_names, q.tolist(), speed.tolist()))
        if self._image_ns == time_ns:
            for one in self._exposures:
                if (
                    one.due_ns == time_ns
                    and (seen := one.expose(self.read_rest_pose())) is not None
                ):
                    readings.append(seen)
            self._image_ns = min(one.due_ns for one in self._exposures)
        return readings

    def command(self, kind: str, values: Sequence[float]) -> None:
        """Command positions or velocities of all joints."""
        values = np.array(values, float)
        if kind not in self.outputs:
            raise ExperimentError(
                f"this plant takes {' or '.join(sorted(self.outputs))} commands, not {kind}"
            )
        if values.shape != self._q.shape or not np.isfinite(values).all():
            raise ExperimentError(
                f"a command of {len(self._q)} finite numbers is needed, got {values}"
            )
        self._set_command(kind, values)

    def read_rest_pose(self) -> np.ndarray:
        """See Plant.at_rest."""
        return self.arm.pose(self._q)

    def compute_rest_poses(self, positions: np.ndarray) -> np.ndarray:
        """See Plant.poses."""
        return np.array([self.arm.pose(q) for q in positions]).reshape(-1, 4, 4)

    def joint_origins(self, positions: np.ndarray) -> np.ndarray:
        """See Plant.places."""
        arm = self.arm
        return (
            arm.joint_origins(positions)
            if isinstance(arm, Arm)
            else super().joint_origins(positions)
        )

    def read_joints(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities now."""
        return self._q.copy(), self._speed.copy()

    def _set_command(self, kind: str, values: np.ndarray) -> None:
        """Follow a command (n,) from now on."""
        self._kind, self._command = kind, values if kind == "position" else self._to_motion(values)

    def _move(self, dt: float) -> None:
        """Solve the lag over dt (s), exactly."""
        rest = np.exp(-dt / self._lag) if self._lag > 0.0 else 0.0
        before = self._q
        if self._kind == "position":
            self._q = self._clamp(self._command + rest * (before - self._command))
            self._speed = self._to_motion((self._q - before) / dt)
            return
        moved = self._command * dt + (self._speed - self._command) * self._lag * (1.0 - rest)
        self._speed = self._command + rest * (self._speed - self._command)
        self._displace(moved)

    def _to_motion(self, rates: np.ndarray) -> np.ndarray:
        """What is kept of coordinate rates (n,): that which a lag acts on."""
        return rates

    @abstractmethod
    def _clamp(self, q: np.ndarray) -> np.ndarray:
        """The coordinates nearest to q that the plant can have."""

    @abstractmethod
    def _displace(self, motion: np.ndarray) -> None:
        """Add a motion, what `_to_motion` gives times seconds, to the coordinates."""


class KinematicArm(KinematicPlant):
    """An arm without dynamics: each joint lags behind its command, within its limits."""

    arm: Arm

    def _clamp(self, q: np.ndarray) -> np.ndarray:
        return np.clip(q, self.arm.lower, self.arm.upper)

    def _displace(self, motion: np.ndarray) -> None:
        free = self._q + motion
        self._q = self._clamp(free)
        self._speed = np.where(self._q == free, self._speed, 0.0)


class FreeCamera(KinematicPlant):
    """A camera that flies as it is told: velocities are a twist, which moves it by its exponential.

    So a constant twist takes it to the same pose in one step as in a thousand.
    """

    arm: FreeBody

    def __init__(
        self, arm: FreeBody, q: np.ndarray, imaging: ImagingSettings, **further: float | int
    ) -> None:
        """Stand at coordinates q (6,); `further`: see KinematicPlant."""
        super().__init__(arm, q, imaging, **further)
        self._pose = arm.pose(self._q)

    def read_rest_pose(self) -> np.ndarray:
        """See Plant.at_rest."""
        return self._pose.copy()

    def read_joints(self) -> tuple[np.ndarray, np.ndarray]:
        """Coordinates and their rates now."""
        return self._q.copy(), np.linalg.solve(self.arm.jacobian(self._q), self._speed)

    def _to_motion(self, rates: np.ndarray) -> np.ndarray:
        return self.arm.jacobian(self._q) @ rates

    def _clamp(self, q: np.ndarray) -> np.ndarray:
        self._pose = self.arm.pose(q)
        return q

    def _displace(self, motion: np.ndarray) -> None:
        self._pose = self._pose @ exponential(motion)
        self._q = self.arm.coordinates(self._pose)
