"""The servo loop without ROS: one measurement in, one command out.

    features -> twist of the camera -> joint velocities -> position commands

Phases: `waiting` (for joint states or images), `approaching` (the start pose, with the camera's
eyes shut), `servoing`, `converged` (every error below its threshold for `hold` seconds; the loop
stays closed), `holding` (no safe command can be computed: the last one stands).

The commands are integrated from the last command, not from the measured positions: a joint held
back by friction is pushed until it moves. How far they may run ahead is bounded. Between images
they are streamed (`Servo.streamed`), so that the joints follow a velocity and not steps.
"""

from dataclasses import dataclass

import numpy as np

from ..errors import MeasurementError, ServoError
from ..kinematics import JOINT_NAMES
from ..resolver import Resolution, Resolver
from .schemes.base import Measurement, Scheme, SchemeResult

WAITING, APPROACHING, SERVOING, CONVERGED, HOLDING = (
    "waiting",
    "approaching",
    "servoing",
    "converged",
    "holding",
)


@dataclass(frozen=True)
class ServoSettings:
    """Numbers of the loop.

    Attributes:
        start: (6,) joints to go to before the eyes are opened, or None to servo from anywhere.
        pitch: J2 + J3 + J5 to keep, rad.
        pitch_gain: 1/s with which a wrong pitch is corrected.
        hold: s that every error must stay below its threshold to count as converged.
        approach_speed: part of the joints' greatest speed used to reach the start pose.
        arrived: (6,) distance from the start pose that counts as there, m and rad.
        push: 1/s with which the command runs after a joint that stays short of the start pose.
        settle: s to stand still at the start pose before servoing.
        longest_step: s; a longer gap between images is integrated as this long.
        lead: (6,) greatest distance of a command from the measured position, m and rad.
    """

    start: tuple[float, ...] | None = None
    pitch: float = 0.0
    pitch_gain: float = 3.0
    hold: float = 2.0
    approach_speed: float = 0.3
    arrived: tuple[float, ...] = (0.005,) * 6
    push: float = 3.0
    settle: float = 0.3
    longest_step: float = 0.1
    lead: tuple[float, ...] = (0.15, 0.3, 0.3, 0.3, 0.3, 0.3)


@dataclass(frozen=True)
class ServoCommand:
    """What the loop saw, decided and wants sent. Fields as in the message ServoState.

    `joint_commands` is None when nothing may be sent (nothing is known of the joints yet).
    """

    stamp: float
    phase: str
    reason: str = ""
    scheme_result: SchemeResult | None = None
    resolution: Resolution | None = None
    joint_positions: np.ndarray | None = None
    joint_commands: np.ndarray | None = None

    @property
    def twist(self) -> np.ndarray:
        """Twist (6,) that the scheme asked for; zero when none was."""
        return np.zeros(6) if self.scheme_result is None else self.scheme_result.twist


@dataclass
class _Approach:
    """Motion to the start pose: from, since when, how long, last call, and arrived since when."""

    origin: np.ndarray
    since: float
    duration: float
    latest: float | None = None
    arrived_at: float | None = None


class Servo:
    """The loop. Construct, feed `joints` until it stops approaching, then `step` per image."""

    def __init__(
        self, scheme: Scheme, resolver: Resolver, settings: ServoSettings | None = None
    ) -> None:
        self.scheme = scheme
        self.resolver = resolver
        self.settings = settings if settings is not None else ServoSettings()
        self.reset()

    def reset(self) -> None:
        """Begin anew, as if just constructed: for a simulation that was reset or restarted."""
        self.phase = WAITING
        self._command: np.ndarray | None = None
        self._previous: np.ndarray | None = None
        self._span = 0.0
        self._approach: _Approach | None = None
        self._at_start = self.settings.start is None
        self._began: float | None = None
        self._last_stamp: float | None = None
        self._within_since: float | None = None
        self.scheme.reset()

    @property
    def approaching(self) -> bool:
        """Whether the start pose has still to be reached: feed `joints`, images are ignored."""
        return not self._at_start

    def joints(self, positions: np.ndarray, stamp: float) -> ServoCommand:
        """Go on towards the start pose.

        Args:
            positions: (6,) measured joints, m and rad.
            stamp: of the measurement, s.
        """
        positions = np.asarray(positions, float)
        if not np.isfinite(positions).all():
            return self._hold(stamp, positions, "a measured joint position is not finite")
        start = np.asarray(self.settings.start, float)
        if self._approach is None:
            speed = self.settings.approach_speed * np.asarray(self.resolver.limits.velocity)
            # Smoothstep peaks at 1.5 times its mean speed.
            duration = float(np.max(1.5 * np.abs(start - positions) / speed))
            self._approach = _Approach(positions.copy(), stamp, max(duration, 1e-3))
        motion = self._approach
        part = float(np.clip((stamp - motion.since) / motion.duration, 0.0, 1.0))
        self.phase, reason = APPROACHING, ""
        if part < 1.0 or motion.latest is None:
            blend = part * part * (3.0 - 2.0 * part)
            self._command = motion.origin + blend * (start - motion.origin)
        else:
            # A weak controller leaves a joint hanging in its friction: push until it is there.
            dt = float(np.clip(stamp - motion.latest, 0.0, self.settings.longest_step))
            missing = start - positions
            missing[np.abs(missing) < 0.5 * np.asarray(self.settings.arrived)] = 0.0
            pushed = self._command + self.settings.push * missing * dt
            lead = np.asarray(self.settings.lead)
            self._command = np.clip(pushed, start - lead, start + lead)
        motion.latest = stamp
        if part >= 1.0:
            late = np.flatnonzero(np.abs(positions - start) > self.settings.arrived)
            if late.size:
                motion.arrived_at = None
                reason = "waiting at the start pose for " + ", ".join(
                    f"{JOINT_NAMES[i]} ({positions[i]:.4f}, to be {start[i]:.4f})" for i in late
                )
            elif motion.arrived_at is None:
                motion.arrived_at = stamp
            elif stamp - motion.arrived_at >= self.settings.settle:
                self._at_start = True
        return ServoCommand(
            stamp,
            self.phase,
            reason,
            joint_positions=positions,
            joint_commands=self._command.copy(),
        )

    def step(self, measurement: Measurement, positions: np.ndarray | None) -> ServoCommand:
        """Answer one image.

        Args:
            measurement: of the image.
            positions: (6,) the latest measured joints, or None when none are known.
        """
        stamp = measurement.stamp
        if positions is None:
            self.phase = WAITING
            return ServoCommand(stamp, WAITING, "no joint states yet")
        positions = np.asarray(positions, float)
        if not np.isfinite(positions).all():
            return self._hold(stamp, positions, "a measured joint position is not finite")
        if self.approaching:
            return self.joints(positions, stamp)
        if self._command is None:
            self._command = positions.copy()
        # Until this image is answered, the last command stands.
        before = self.streamed(stamp)
        self._previous, self._span = before, 0.0
        previous, self._last_stamp = self._last_stamp, stamp
        if not measurement.valid:
            return self._hold(stamp, positions, measurement.reason or "the target is not visible")
        if self._began is None:
            self._began = stamp
        try:
            result = self.scheme.compute(measurement, stamp - self._began)
        except MeasurementError as error:
            return self._hold(stamp, positions, str(error))
        if not (np.isfinite(result.twist).all() and np.isfinite(result.error).all()):
            return self._hold(stamp, positions, "the scheme's twist or error is not finite")
        dt = 0.0 if previous is None else stamp - previous
        resolution, reason = self._advance(result, positions, dt)
        if resolution is None:
            return self._hold(stamp, positions, reason, result)
        self._judge(result.error, stamp)
        return ServoCommand(
            stamp,
            self.phase,
            reason,
            scheme_result=result,
            resolution=resolution,
            joint_positions=positions,
            joint_commands=self._command.copy(),
        )

    def streamed(self, stamp: float) -> np.ndarray | None:
        """The command (6,) for a moment between two images, None when nothing may be sent.

        It travels from the last but one command to the last within one image period, so that the
        joints are asked for a velocity and not for a step thirty times a second.
        """
        if self._command is None or self.approaching:
            return None
        if self._previous is None or self._span <= 0.0 or self._last_stamp is None:
            return self._command.copy()
        part = float(np.clip((stamp - self._last_stamp) / self._span, 0.0, 1.0))
        return self._previous + part * (self._command - self._previous)

    def stalled(self, stamp: float, reason: str) -> ServoCommand:
        """Data stopped coming: say so; the last command stands with the joints' controllers."""
        self.phase = WAITING
        self._within_since = None
        return ServoCommand(stamp, WAITING, reason)

    def _advance(
        self, result: SchemeResult, positions: np.ndarray, dt: float
    ) -> tuple[Resolution | None, str]:
        """Integrate the twist over dt (s) into the command; no reason when all is well."""
        dt = float(np.clip(dt, 0.0, self.settings.longest_step))
        kinematics = self.resolver.kinematics
        twist = np.array(result.twist, float)
        lean = self.settings.pitch - kinematics.pitch(self._command)
        axis = kinematics.pitch_axis(self._command)
        twist[3:] += axis * (self.settings.pitch_gain * lean)
        try:
            resolution = self.resolver.resolve(self._command, twist, dt)
        except (ServoError, ValueError, np.linalg.LinAlgError) as error:
            return None, str(error)
        command = self._command + resolution.joint_velocities * dt
        if not np.isfinite(command).all():
            return None, "the joint command is not finite"
        ahead = np.abs(command - positions)
        outwards = ahead > np.abs(self._command - positions)
        late = np.flatnonzero((ahead > self.settings.lead) & outwards)
        if late.size:
            return resolution, "not advancing: " + ", ".join(
                f"{JOINT_NAMES[i]} is {ahead[i]:.3f} behind its command" for i in late
            )
        self._command, self._span = command, dt
        return resolution, "; ".join(resolution.reasons)

    def _judge(self, error: np.ndarray, stamp: float) -> None:
        """Follow convergence; a converged loop forgives half a threshold more before it is not."""
        limits = np.asarray(self.scheme.thresholds) * (1.5 if self.phase == CONVERGED else 1.0)
        if (np.abs(error) >= limits).any():
            self._within_since = None
            self.phase = SERVOING
            return
        if self._within_since is None:
            self._within_since = stamp
        self.phase = CONVERGED if stamp - self._within_since >= self.settings.hold else SERVOING

    def _hold(
        self,
        stamp: float,
        positions: np.ndarray,
        reason: str,
        result: SchemeResult | None = None,
    ) -> ServoCommand:
        """Stand still at the last command and say why."""
        self.phase = HOLDING
        self._within_since = None
        command = None if self._command is None else self._command.copy()
        return ServoCommand(
            stamp,
            HOLDING,
            reason,
            scheme_result=result,
            joint_positions=positions,
            joint_commands=command,
        )
