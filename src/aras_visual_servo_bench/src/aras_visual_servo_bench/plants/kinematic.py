"""Plants without physics: an arm whose joints lag behind their commands, and a free camera.

The motion between two measurements is computed exactly, in a single step.
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

# Time from the start of each joint state period to the stamp of its joint state, ns. It is that of
# the simulation with physics.
JOINT_PHASE_NS = 1_000_000


class KinematicPlant(Plant):
    """Base class of plants whose coordinates follow their commands with a lag."""

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
        """Place the arm or camera at coordinates q (n,).

        Args:
            arm: true kinematics of the control camera.
            q: initial coordinates (n,).
            imaging: settings of the control camera.
            joint_rate: number of joint states per second.
            lag: time constant of every joint, s.
            seed: seed of the noise.
            other_imaging: settings of the other cameras.
        """
        self.arm, self.imaging, self.camera = arm, imaging, imaging.camera
        self.joint_names = tuple(arm.names)
        self._random = np.random.default_rng(seed)
        self._exposures = make_exposure_schedules(imaging, other_imaging, self._random, seed)
        self.control_camera_name, self.vibrations = (
            imaging.name,
            collect_vibrations(imaging, *other_imaging),
        )
        self._image_ns = min(exposure.due_ns for exposure in self._exposures)
        self._lag = lag
        self.time_ns = 0
        self._q = np.array(q, float)
        self._speed = np.zeros_like(self._q)
        self._kind, self._command = "position", self._q.copy()
        self._joint_period, self._samples = NS / joint_rate, 0

    def advance(self, until_ns: int) -> list[Reading]:
        """Advance to the next measurement, but not beyond `until_ns`; see Plant.advance."""
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
            for exposure in self._exposures:
                if (
                    exposure.due_ns == time_ns
                    and (frame := exposure.expose(self.read_rest_pose())) is not None
                ):
                    readings.append(frame)
            self._image_ns = min(exposure.due_ns for exposure in self._exposures)
        return readings

    def command(self, kind: str, values: Sequence[float]) -> None:
        """Command positions or velocities of all joints; see Plant.command."""
        values = np.array(values, float)
        if kind not in self.outputs:
            raise ExperimentError(
                f"this plant accepts {' or '.join(sorted(self.outputs))} commands, not {kind}"
            )
        if values.shape != self._q.shape or not np.isfinite(values).all():
            raise ExperimentError(
                f"a command must be {len(self._q)} finite numbers, got {values}"
            )
        self._set_command(kind, values)

    def read_rest_pose(self) -> np.ndarray:
        """Return world_T_camera (4, 4) of the control camera, without vibration."""
        return self.arm.pose(self._q)

    def compute_rest_poses(self, positions: np.ndarray) -> np.ndarray:
        """Compute world_T_camera (m, 4, 4) for m joint states (m, n)."""
        return np.array([self.arm.pose(q) for q in positions]).reshape(-1, 4, 4)

    def joint_origins(self, positions: np.ndarray) -> np.ndarray:
        """Compute the origins of the arm's joint frames; see Plant.joint_origins."""
        arm = self.arm
        return (
            arm.joint_origins(positions)
            if isinstance(arm, Arm)
            else super().joint_origins(positions)
        )

    def read_joints(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the current positions (n,) and velocities (n,)."""
        return self._q.copy(), self._speed.copy()

    def _set_command(self, kind: str, values: np.ndarray) -> None:
        """Store the command (n,) that the coordinates follow."""
        self._kind, self._command = kind, values if kind == "position" else self._to_motion(values)

    def _move(self, dt: float) -> None:
        """Advance the coordinates by dt (s) with the exact solution of the first-order lag."""
        decay = np.exp(-dt / self._lag) if self._lag > 0.0 else 0.0
        before = self._q
        if self._kind == "position":
            self._q = self._clamp(self._command + decay * (before - self._command))
            self._speed = self._to_motion((self._q - before) / dt)
            return
        motion = self._command * dt + (self._speed - self._command) * self._lag * (1.0 - decay)
        self._speed = self._command + decay * (self._speed - self._command)
        self._displace(motion)

    def _to_motion(self, rates: np.ndarray) -> np.ndarray:
        """Convert the rates (n,) of the coordinates into the velocity that lags behind commands.

        This velocity consists of the joint velocities of an arm, or is the twist of a free camera.
        """
        return rates

    @abstractmethod
    def _clamp(self, q: np.ndarray) -> np.ndarray:
        """Clip the coordinates q (n,) to the range that the plant can reach."""

    @abstractmethod
    def _displace(self, motion: np.ndarray) -> None:
        """Change the coordinates by a motion (n,), the time integral of a joint velocity or twist.

        Coordinates are clipped to the range that the plant can reach.
        """


class KinematicArm(KinematicPlant):
    """Arm without dynamics; each joint lags behind its command and stays within its limits."""

    arm: Arm

    def _clamp(self, q: np.ndarray) -> np.ndarray:
        return np.clip(q, self.arm.lower, self.arm.upper)

    def _displace(self, motion: np.ndarray) -> None:
        free = self._q + motion
        self._q = self._clamp(free)
        self._speed = np.where(self._q == free, self._speed, 0.0)


class FreeCamera(KinematicPlant):
    """Free camera that moves along the exponential of its twist.

    With a constant twist, the final pose does not depend on the number of steps.
    """

    arm: FreeBody

    def __init__(
        self, arm: FreeBody, q: np.ndarray, imaging: ImagingSettings, **further: float | int
    ) -> None:
        """Place the camera at coordinates q (6,).

        `further`: other arguments of KinematicPlant."""
        super().__init__(arm, q, imaging, **further)
        self._pose = arm.pose(self._q)

    def read_rest_pose(self) -> np.ndarray:
        """Return world_T_camera (4, 4) of the control camera, without vibration."""
        return self._pose.copy()

    def read_joints(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the current coordinates (6,) and their rates (6,)."""
        return self._q.copy(), np.linalg.solve(self.arm.jacobian(self._q), self._speed)

    def _to_motion(self, rates: np.ndarray) -> np.ndarray:
        return self.arm.jacobian(self._q) @ rates

    def _clamp(self, q: np.ndarray) -> np.ndarray:
        self._pose = self.arm.pose(q)
        return q

    def _displace(self, motion: np.ndarray) -> None:
        self._pose = self._pose @ exponential(motion)
        self._q = self.arm.coordinates(self._pose)
