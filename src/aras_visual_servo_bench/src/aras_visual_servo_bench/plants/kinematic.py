"""Plants without physics: an arm whose joints lag behind their commands, and a free camera.

The motion between two measurements is computed in a single step, without numerical integration.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import attrgetter
from typing import TYPE_CHECKING

import numpy as np

from aras_visual_servo_base.compiled import jit
from aras_visual_servo_controller.kinematics import Arm
from aras_visual_servo_controller.kinematics.algebra import is_finite, solve_linear
from aras_visual_servo_controller.kinematics.chain import CHAIN_SIGNATURE, compute_pose_and_jacobian
from aras_visual_servo_controller.kinematics.free_body_kinematics import move_freely
from aras_visual_servo_controller.observation.frame import NANOSECONDS
from aras_visual_servo_controller.runner.compiled_updates import (
    LOOP_ROWS,
    LOOP_TYPE,
    NEEDS_PYTHON,
    SENT_VALUES,
    LoopStateConverter,
    process_joint_state,
)

from ..errors import ExperimentError
from .base import JointReading, Plant, Reading
from .exposures import collect_vibrations, make_exposure_schedules
from .free_camera_kinematics import FreeCameraKinematics
from .imaging import ImagingSettings

if TYPE_CHECKING:
    from aras_visual_servo_controller.runner.loop_runner import LoopRunner

    from .base import JointListener

# Row indices of the state (7, n) of a plant: coordinates, their velocities, commanded coordinates,
# lower limits, upper limits, velocity of the motion, and its command. With velocity commands, the
# last two rows contain joint velocities, or the twist of a free camera.
Q, V, COMMAND, LOWER, UPPER, MOTION, MOTION_COMMAND = range(7)
CHAIN = f"Tuple(({CHAIN_SIGNATURE}))"
# Time from the start of each joint state period to the stamp of its joint state, ns; equal to that
# of the plant 'bullet'.
JOINT_PHASE_NS = 1_000_000
READ_DUE_NS = attrgetter("due_ns")


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
        self._image_ns = min(map(READ_DUE_NS, self._exposures))
        self._pose: np.ndarray | None = None  # current rest pose; None until it is computed
        self._lag = lag
        self.time_ns = 0
        self._chain, still = tuple(arm.chain), np.zeros(len(q))
        self._jacobian = np.empty((6, len(q)))  # working memory
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
        self._pose, until_ns = None, min(self._image_ns, until_ns)
        if self._updates is not None and self._joints_ns <= until_ns:
            self._update_loop(until_ns)
        joints_ns = self._joints_ns
        time_ns = min(joints_ns, until_ns)
        dt = (time_ns - self.time_ns) / NANOSECONDS
        if dt > 0.0 and self._has_velocity_commands:
            follow_velocity(self._chain, self._state, self._lag, dt)
        elif dt > 0.0:
            follow_position(self._state, self._lag, dt)
        self._pose = None  # an observer of the update may have read the pose before this motion
        self.time_ns = max(time_ns, self.time_ns)
        readings: list[Reading] = []
        if joints_ns == time_ns:
            self._samples += 1
            self._joints_ns = JOINT_PHASE_NS + round(self._samples * self._joint_period)
            q, speed = self.read_joints()
            readings.append(JointReading(time_ns, self.joint_names, q.tolist(), speed.tolist()))
        if self._image_ns == time_ns:
            for exposure in self._exposures:
                if (
                    exposure.due_ns == time_ns
                    and (frame := exposure.expose(self.read_rest_pose())) is not None
                ):
                    readings.append(frame)
            self._image_ns = min(map(READ_DUE_NS, self._exposures))
        return readings

    def command(self, kind: str, values: Sequence[float]) -> None:
        """Command positions or velocities of all joints; see Plant.command."""
        values = np.array(values, float)
        if kind not in self.outputs:
            raise ExperimentError(
                f"this plant accepts {' or '.join(sorted(self.outputs))} commands, not {kind}"
            )
        if values.shape != self._state[Q].shape or not is_finite(values):
            raise ExperimentError(
                f"a command must be {len(self.joint_names)} finite numbers, got {values}"
            )
        self._set_command(kind, values)

    def read_rest_pose(self) -> np.ndarray:
        """Return world_T_camera (4, 4) of the control camera, without vibration."""
        if self._pose is None:
            self._pose = np.empty((4, 4))
            compute_pose_and_jacobian(*self._chain, self._state[Q], self._pose, self._jacobian)
        return self._pose.copy()

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

    def _update_loop(self, until_ns: int) -> None:
        """Advance from joint state to joint state up to `until_ns`, and update the loop with each.
        """
        end_ns = min(until_ns, self._read_end_ns())
        loop = self._updates.make_loop() if self._joints_ns <= end_ns else None
        if loop is None:
            return
        most = int((end_ns - self._joints_ns) / self._joint_period) + 2
        stamps, samples = np.empty(most), np.empty((most, 3, len(self.joint_names)))
        count, self.time_ns, self._joints_ns = update_loop(
            self._samples, self._joint_period, end_ns, self.time_ns, self._lag,
            self._has_velocity_commands, self._chain, self._state, stamps, samples, loop,
        )
        self._samples += count
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


@jit("f8[:,::1], f8, f8", allocates=False)
def follow_position(state, lag, dt):
    """Move the coordinates for dt (s) towards the commanded ones.

    Each coordinate follows its command with the time constant `lag` (s), and stays within its
    limits. The motion is the exact solution for a constant command.
    """
    decay = np.exp(-dt / lag) if lag > 0.0 else 0.0
    for i in range(state.shape[1]):
        before, command = state[Q, i], state[COMMAND, i]
        after = command + decay * (before - command)
        state[Q, i] = min(max(after, state[LOWER, i]), state[UPPER, i])
        state[V, i] = (state[Q, i] - before) / dt


@jit(f"{CHAIN}, f8[:,::1], f8[::1], f8[::1]")
def convert_to_motion(chain, state, rates, motion):
    """Convert rates (n,) of the coordinates to a velocity (n,), and write it into `motion`.

    For an arm, the velocity is that of the joints; for a free camera, it is the camera's twist.
    """
    n = state.shape[1]
    if len(chain[0]) > 0:
        for i in range(n):
            motion[i] = rates[i]
        return
    jacobian = np.empty((6, n))
    compute_pose_and_jacobian(*chain, state[Q], np.empty((4, 4)), jacobian)
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += jacobian[i, j] * rates[j]
        motion[i] = total


@jit(f"{CHAIN}, f8[:,::1], f8, f8")
def follow_velocity(chain, state, lag, dt):
    """Move for dt (s) with the commanded velocity.

    The velocity follows its command with the time constant `lag` (s). A free camera moves along the
    exponential of its twist; a joint stays within its limits.
    """
    decay = np.exp(-dt / lag) if lag > 0.0 else 0.0
    n = state.shape[1]
    path = np.empty(n)
    for i in range(n):
        speed, command = state[MOTION, i], state[MOTION_COMMAND, i]
        path[i] = command * dt + (speed - command) * lag * (1.0 - decay)
        state[MOTION, i] = command + decay * (speed - command)
    if len(chain[0]) > 0:
        for i in range(n):
            free = state[Q, i] + path[i]
            state[Q, i] = min(max(free, state[LOWER, i]), state[UPPER, i])
            if state[Q, i] != free:
                state[MOTION, i] = 0.0
            state[V, i] = state[MOTION, i]
        return
    move_freely(state[Q], path)
    jacobian = np.empty((6, n))
    compute_pose_and_jacobian(*chain, state[Q], np.empty((4, 4)), jacobian)
    for i in range(n):
        state[V, i] = state[MOTION, i]
    solve_linear(jacobian, state[V])


@jit(f"i8, f8, f8, i8, f8, b1, {CHAIN}, f8[:,::1], f8[::1], f8[:,:,::1], {LOOP_TYPE}")
def update_loop(
    number,
    period,
    end_ns,
    time_ns,
    lag,
    has_velocity_commands,
    plant_chain,
    state,
    stamps,
    samples,
    loop,
):
    """Move the plant from joint state to joint state, and update the control loop with each.

    Stop at a joint state that Python has to process.

    Args:
        number: number of the next joint state, counted from the start of the simulation.
        period: period of the joint states, ns.
        end_ns: time of the last joint state to process, or later, ns.
        time_ns: present time, ns.
        lag: time constant of the coordinates, s.
        has_velocity_commands: whether velocities are commanded.
        plant_chain: kinematics of the plant, as the fields of a Chain.
        state: (7, n) state of the plant; modified.
        stamps: (m,) output, stamps of the joint states, s; m is at least their number.
        samples: (m, 3, n) output, their positions and velocities, and the resulting commands.
        loop: see `process_joint_state`.

    Returns:
        The number of joint states that the loop has processed; the time of the last joint state
        that the plant has reached, ns; the time of the next one that has to be processed, ns.
    """
    count = 0
    while True:
        joints_ns = JOINT_PHASE_NS + int(np.rint((number + count) * period))
        if joints_ns > end_ns:
            return count, time_ns, joints_ns
        dt = (joints_ns - time_ns) / NANOSECONDS
        if dt > 0.0 and has_velocity_commands:
            follow_velocity(plant_chain, state, lag, dt)
        elif dt > 0.0:
            follow_position(state, lag, dt)
        time_ns, sample = joints_ns, samples[count]
        stamps[count] = float(time_ns // NANOSECONDS) + (time_ns % NANOSECONDS) / 1e9
        for i in range(state.shape[1]):
            sample[0, i], sample[1, i] = state[Q, i], state[V, i]
        result = process_joint_state(sample[0], sample[1], stamps[count], loop)
        if result == NEEDS_PYTHON:
            return count, time_ns, joints_ns
        for i in range(state.shape[1]):
            sample[2, i] = loop[LOOP_ROWS][SENT_VALUES, i]
        if has_velocity_commands:
            convert_to_motion(plant_chain, state, sample[2], state[MOTION_COMMAND])
        else:
            for i in range(state.shape[1]):
                state[COMMAND, i] = sample[2, i]
        count += 1
