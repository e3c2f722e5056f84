"""Plants without physics: an arm whose joints lag behind their commands, and a free camera.

The motion between two measurements is computed in a single step, without numerical integration.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from aras_visual_servo_controller.kinematics import Arm
from aras_visual_servo_controller.observation.frame import NANOSECONDS
from aras_visual_servo_controller.runner.compiled_updates import LoopStateConverter

from ..errors import ExperimentError
from .base import JointReading, Plant, Reading
from .free_camera_kinematics import FreeCameraKinematics
from .imaging import ImagingSettings, collect_vibrations, make_exposure_schedules
from .kinematic_motion import (
    COMMAND,
    MOTION,
    MOTION_COMMAND,
    Q,
    V,
    convert_to_motion,
    follow_position,
    follow_velocity,
    update_loop,
)

if TYPE_CHECKING:
    from aras_visual_servo_controller.runner.loop_runner import LoopRunner

    from .base import JointListener

# Time from the start of each joint state period to the stamp of its joint state, ns; equal to that
# of the plant 'bullet'.
JOINT_PHASE_NS = 1_000_000


class KinematicPlant(Plant):
    """Base class of plants whose coordinates follow their commands with a lag."""

    outputs = frozenset(("position", "velocity"))
    time_ns = 0

    def __init__(
        self,
        arm: Arm | FreeCameraKinematics,
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
        self._chain, still = tuple(arm.chain), np.zeros(len(q))
        self._state = np.array([q, still, q, arm.lower, arm.upper, still, still], float)
        self._has_velocity_commands = False
        self._joint_period = NANOSECONDS / joint_rate
        # Number of the next joint state, and its stamp (ns).
        self._samples, self._joints_ns = 0, JOINT_PHASE_NS
        self._updates: LoopStateConverter | None = None

    def attach_loop(
        self, driver: LoopRunner, listener: JointListener, read_end_ns: Callable[[], float]
    ) -> None:
        """Process joint states in compiled code; see Plant.attach_loop."""
        if driver.servo.arm.names == self.joint_names:
            self._updates = LoopStateConverter(driver, ("position", "velocity"))
        self._listener, self._read_end_ns = listener, read_end_ns

    def advance(self, until_ns: int) -> list[Reading]:
        """Advance to the next measurement, but not beyond `until_ns`; see Plant.advance."""
        if self._updates is not None and self._joints_ns <= min(self._image_ns, until_ns):
            self._update_loop(min(self._image_ns, until_ns))
        joints_ns = self._joints_ns
        time_ns = min(joints_ns, self._image_ns, until_ns)
        dt = (time_ns - self.time_ns) / NANOSECONDS
        if dt > 0.0 and self._has_velocity_commands:
            follow_velocity(self._chain, self._state, self._lag, dt)
        elif dt > 0.0:
            follow_position(self._state, self._lag, dt)
        self.time_ns = max(time_ns, self.time_ns)
        readings: list[Reading] = []
        if joints_ns == time_ns:
            self._count_samples(1)
            q, speed = self.read_joints()
            readings.append(JointReading(time_ns, self.joint_names, q.tolist(), speed.tolist()))
        if self._image_ns == time_ns:
            for exposure in self._exposures:
                if (
                    exposure.due_ns == time_ns
                    and (frame := exposure.expose(self.read_rest_pose())) is not None
                ):
                    readings.append(frame)
            self._image_ns = min([exposure.due_ns for exposure in self._exposures])
        return readings

    def command(self, kind: str, values: Sequence[float]) -> None:
        """Command positions or velocities of all joints; see Plant.command."""
        values = np.array(values, float)
        if kind not in self.outputs:
            raise ExperimentError(
                f"this plant accepts {' or '.join(sorted(self.outputs))} commands, not {kind}"
            )
        if values.shape != self._state[Q].shape or not all(np.isfinite(values).tolist()):
            raise ExperimentError(
                f"a command must be {len(self.joint_names)} finite numbers, got {values}"
            )
        self._set_command(kind, values)

    def read_rest_pose(self) -> np.ndarray:
        """Return world_T_camera (4, 4) of the control camera, without vibration."""
        return self.arm.pose(self._state[Q]).copy()

    def compute_rest_poses(self, positions: np.ndarray) -> np.ndarray:
        """Compute world_T_camera (m, 4, 4) for m joint states (m, n)."""
        return self.arm.poses(positions)

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
        q, speed = self._state[: V + 1].copy()
        return q, speed

    def _set_command(self, kind: str, values: np.ndarray) -> None:
        """Store the command (n,) that the coordinates follow."""
        state = self._state
        if kind == "position":
            state[COMMAND] = values
        else:
            if not self._has_velocity_commands:
                convert_to_motion(self._chain, state, state[V], state[MOTION])
            convert_to_motion(self._chain, state, values, state[MOTION_COMMAND])
        self._has_velocity_commands = kind == "velocity"

    def _count_samples(self, count: int) -> None:
        """Count `count` more measured joint states, and compute the stamp of the next one."""
        self._samples += count
        self._joints_ns = JOINT_PHASE_NS + round(self._samples * self._joint_period)

    def _update_loop(self, until_ns: int) -> None:
        """Advance from joint state to joint state up to `until_ns`, and update the loop with each.
        """
        due, number, joints_ns = [], self._samples, self._joints_ns
        end_ns = min(until_ns, self._read_end_ns())
        while joints_ns <= end_ns:
            due.append(joints_ns)
            number += 1
            joints_ns = JOINT_PHASE_NS + round(number * self._joint_period)
        loop = self._updates.make_loop() if due else None
        if loop is None:
            return
        stamps, samples = np.empty(len(due)), np.empty((len(due), 3, len(self.joint_names)))
        count, reached = update_loop(
            np.array(due), self.time_ns, self._lag, self._has_velocity_commands, self._chain,
            self._state, stamps, samples, loop,
        )
        if reached:
            self.time_ns = due[reached - 1]
        self._count_samples(count)
        stamps, samples = stamps[:count].tolist(), samples[:count]
        self._updates.apply_results(stamps, samples)
        self._listener.on_updates(stamps, samples)


class KinematicArm(KinematicPlant):
    """Arm without dynamics; each joint lags behind its command and stays within its limits."""

    arm: Arm


class FreeCamera(KinematicPlant):
    """Free camera that moves along the exponential of its twist.

    With a constant twist, the final pose does not depend on the number of steps.
    """

    arm: FreeCameraKinematics
