"""Event-driven execution of the loop, without ROS.

The events are joint states, images and the passing of time:

    joint states ─► history ─► Servo.update ─► commands
    images ──────► joints at the exposure ─► Observation ─► Servo.process_image ─► reports
    check_timeouts (called by another thread) ─► smooth stop if nothing is received

The time of the loop is given by the stamps of the joint states; without joint states it follows the
clock. The loop restarts only if the clock goes back, not if a message is late or has no stamp.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Protocol

import numpy as np

from ..errors import MeasurementError
from ..kinematics.algebra import are_finite
from ..kinematics.joint_sample import JointSample
from ..loop.command_integrator import has_jumped
from ..loop.servo import Servo
from ..observation.camera_rig import CameraRig, ObserveFrame
from ..observation.joint_history import MAX_AGE, JointHistory, SampleBuffer
from ..records.outcomes import Outcome, make_outcome
from ..records.state import (
    APPROACHING,
    CONVERGED,
    HOLDING,
    SERVOING,
    STOPPED,
    WAITING,
    ImageSource,
    JointCommand,
    ServoState,
)
from ..settings import ControllerSettings
from .foreign_command_watch import (
    MAX_CLOCK_SKEW,
    ForeignCommandSource,
    ForeignCommandWatch,
    JointStateWatch,
)

# Period at which the loop's state is reported while no images arrive, s: the image period of a
# camera with 30 images per second.
REPORT_PERIOD = 1.0 / 30.0
SILENT_TIME = 0.05  # after this time without a joint state, s, the loop's time follows the clock
# A clock that has not advanced for this wall time, s, is reported as stopped.
STOPPED_CLOCK_TIME = 0.5
RESUME_ADVICE = "resume the simulation, or start the simulator again"
REPEAT_PERIOD = 0.1  # period at which a command that a joint does not follow is sent again, s


class LoopListener(Protocol):
    """Receiver of the loop's output."""

    def send(self, command: JointCommand) -> None:
        """Send a command to the joints."""

    def report(self, state: ServoState) -> None:
        """Report the state of the loop, for an image or without one."""

    def log(self, text: str) -> None:
        """Log one line."""


class LoopRunner:
    """Execution of one loop; every method may be called by any thread."""

    def __init__(
        self,
        servo: Servo,
        camera_rig: CameraRig,
        settings: ControllerSettings,
        listener: LoopListener,
        clock: Callable[[], float],
        wall_clock: Callable[[], float] = time.monotonic,
        foreign: ForeignCommandSource | None = None,
    ) -> None:
        """Create the runner.

        Args:
            servo: loop to execute.
            camera_rig: cameras that make the observations.
            settings: settings of the loop.
            listener: receiver of commands and reports.
            clock: function that returns the time of the stamps, s, simulated or not.
            wall_clock: function that returns the wall time, s.
            foreign: source of the commands that other nodes send to the joints; None if they cannot
                be received.
        """
        self.servo, self.camera_rig, self.settings = servo, camera_rig, settings
        self._listener, self._clock, self._wall_clock = listener, clock, wall_clock
        self._lead = np.atleast_1d(np.asarray(servo.settings.lead, float))
        self._lock = threading.RLock()
        self.history = JointHistory()
        self._foreign_watch = ForeignCommandWatch(servo, self.history, settings, foreign)
        self._joints_source = ImageSource(
            "joint states", f"{settings.namespace.rstrip('/')}/joint_states", "the simulator"
        )
        self._joint_state_watch = JointStateWatch(
            self._joints_source, servo.arm.names, listener.log
        )
        camera_rig.find_joints = partial(self.history.interpolate, earlier_only=settings.lockstep)
        self.commands = SampleBuffer(256)
        self._joints_time = self._answer_time = wall_clock()
        self._image_times = dict.fromkeys(camera_rig.observers, wall_clock())
        self._silence_report_time = -np.inf
        self._clock_moved_time = wall_clock()  # wall time at which the clock last advanced
        self._is_starved = self._is_e_stopped = self._is_ended = False
        self.start_count = 0  # number of times that joint states started to arrive
        self._sources: dict[str, ImageSource] = {}
        features = settings.get_camera(camera_rig.control.name).features
        self.set_source(
            camera_rig.control.name,
            ImageSource("features", f"{features}/moments", "the camera node"),
        )
        self._clear()
        if not settings.autostart:
            servo.stop("waiting for start")

    def set_source(self, camera: str, source: ImageSource) -> None:
        """Set the source of a camera's images, for messages."""
        self._sources[camera] = source
        if camera == self.camera_rig.control.name:
            self.servo.source = source

    def add_joint_state(
        self,
        names: Sequence[str],
        positions: Sequence[float],
        velocities: Sequence[float],
        stamp: float,
    ) -> None:
        """Process one joint state."""
        with self._lock:
            self._joints_time = self._wall_clock()
            now, watch = self._update_clock(), self._joint_state_watch
            if watch.is_of_other_joints(names, now):
                return
            fault = ""
            if not stamp > 0.0:
                stamp = now
            elif not self.settings.lockstep:
                stamp, fault = watch.check_stamp(stamp, now)
            try:
                sample = self.servo.arm.read_joints(names, positions, velocities, stamp)
            except (MeasurementError, TypeError, ValueError) as error:
                fault = str(error)
            self.start_count += not self._is_receiving
            self._is_receiving = True
            if fault:
                self._joints_arrival = now
                watch.add_unusable(now, fault)
                self._stop_without_joints(now)
                return
            if self._stamp is not None and stamp <= self._stamp:
                return  # the joint state is not newer than the latest one
            self._stamp, self._joints_arrival = stamp, now
            watch.add_usable(now)
            if not len(velocities):
                sample = self.history.estimate_velocities(sample)
            newest = self.history.newest
            if newest is not None:
                dt = sample.stamp - newest.stamp
                if dt > self.settings.watchdog or has_jumped(
                    sample.positions, newest.positions, sample.velocities, newest.velocities,
                    self._lead, dt,
                ):  # fmt: skip
                    # The joints have jumped, or no joint state was received for longer than
                    # `watchdog`.
                    self.servo.mark_joint_jump()
            self.history.add(sample)
            if self._foreign_watch.can_name_nodes:
                self._foreign_watch.find_nodes(self._wall_clock())
            if watch.find_outcome(now) is not None:
                self._stop_without_joints(stamp, sample)
                return
            command = self._update(stamp, sample)
            if not self.settings.lockstep:
                self._send(command)
            if self._pending_image is not None:
                self._process_image(*self._pending_image)
            if self.servo.phase in (APPROACHING, WAITING, STOPPED):
                self._report_periodically(command, sample)

    def add_image(self, stamp: float, observe_frame: ObserveFrame, camera: str = "") -> None:
        """Process one image.

        Args:
            stamp: exposure time, s.
            observe_frame: function that makes the observation from the joints at that time.
            camera: name of the camera; '': the control camera.
        """
        with self._lock:
            camera = camera or self.camera_rig.control.name
            ahead = stamp - self._update_clock()
            if ahead > MAX_CLOCK_SKEW and not self.settings.lockstep:
                # The image was sent before the clock went back, or the camera uses another clock.
                self._stamps_ahead[camera] = ahead
                return
            self._stamps_ahead.pop(camera, None)
            self._image_times[camera] = self._wall_clock()
            together = self.camera_rig.add_image(camera, stamp, observe_frame)
            lacking = self.camera_rig.missing_camera or self.camera_rig.control.name
            self.servo.source = self._sources.get(lacking, self.servo.source)
            if together is None:
                return
            stamp, observe_frame = together
            if self._is_starved:
                self._is_starved = False
                self.servo.start()
            newest = self.history.newest_stamp
            silent = 0.0 if newest is None else stamp - newest
            if silent > max(self.settings.watchdog, SILENT_TIME):
                self._stop_without_joints(stamp)
            self._process_image(stamp, observe_frame)

    def _process_image(self, stamp: float, observe_frame: ObserveFrame) -> None:
        self._pending_image = None
        lockstep = self.settings.lockstep
        if lockstep and not self.history.is_complete_to(stamp):
            self._pending_image = stamp, observe_frame
            return
        joints = self.history.interpolate(stamp, earlier_only=lockstep)
        newest = self.history.newest_stamp
        if newest is not None and stamp - newest > MAX_AGE:
            return  # the joint positions at the exposure are unknown
        if self._joint_state_watch.find_outcome(self._now) is not None:
            if lockstep:
                self._send(self._stop_without_joints(max(stamp, self.update_time)), repeat=True)
            return
        # The observation contains the commands that were sent since the exposure.
        state = self.servo.process_image(observe_frame(joints, self.commands.since(stamp)))
        if not state.has_processed_image:
            return  # the image is late or was already processed
        if state.fault:
            self._listener.log(state.fault)
        if state.phase in (SERVOING, CONVERGED):
            self._answer_time = self._wall_clock()
        at = stamp if self.update_time is None else max(stamp, self.update_time)
        self._send(self._update(at if lockstep else self.update_time or at), repeat=lockstep)
        self._report(state)

    def check_timeouts(self) -> None:
        """Stop the arm if no inputs are received.

        This method must be called often by another thread.
        """
        with self._lock:
            now, wall = self._update_clock(), self._wall_clock()
            if self._stamp is not None and not self.settings.lockstep:
                silent = now - self._joints_arrival
                if silent > max(self.settings.watchdog, SILENT_TIME):
                    self._stop_without_joints(self._stamp + silent)
                elif silent > SILENT_TIME:
                    self._send(self._update(self._stamp + silent))
            moving = self.servo.phase in (SERVOING, CONVERGED)
            if moving and wall - self._answer_time > self.settings.wall_watchdog:
                self._is_starved = True
                why = self._describe_stopped_clock() or self.servo.source.describe_silence()
                limit = self.settings.wall_watchdog
                reason = f"{why}; no image processed for more than {limit:g} s of wall time"
                self.servo.hold(reason, self._make_silence_outcome("too_few_images", reason))
            self._report_silence(wall, now)

    def start(self) -> None:
        """Start or resume servoing."""
        with self._lock:
            self._is_starved = self._is_e_stopped = False
            self._answer_time = self._wall_clock()
            self.servo.start()

    def stop(self, reason: str = "stopped") -> None:
        """Stop the arm smoothly, and wait for `start`."""
        with self._lock:
            self._is_starved = False
            self.servo.stop(reason)

    def hold(self, reason: str = "held") -> None:
        """Stop the arm smoothly, and hold its position until `start`."""
        with self._lock:
            self._is_starved = False
            self.servo.hold(reason)

    def emergency_stop(self, pressed: bool) -> None:
        """Handle the emergency stop; once it is pressed, no command is sent until `start`."""
        with self._lock:
            self._is_e_stopped |= pressed

    def shut_down(self, reason: str) -> None:
        """Stop the arm, and send no more commands.

        If the output is velocity or effort, the last command is zero.
        """
        with self._lock:
            self.servo.stop(reason)
            self._is_ended = True
            kind, names = self.settings.output, self.servo.arm.names
            if kind != "position" and not self.settings.dry:
                zeros = np.zeros(len(names))
                self._listener.send(
                    JointCommand(self.update_time or 0.0, names, zeros, kind, phase=STOPPED)
                )

    def apply_change(self, change: Callable[[Servo], None]) -> None:
        """Change the loop by calling `change` between two of its steps."""
        with self._lock:
            change(self.servo)

    def _clear(self) -> None:
        self.history.clear()
        self.commands.clear()
        self._pending_image: tuple[float, ObserveFrame] | None = None
        # For each camera: time (s) by which its last image's stamp is ahead of the clock, if the
        # image was ignored for this reason.
        self._stamps_ahead: dict[str, float] = {}
        # Whether joint states have come since the start or the last reset of the clock.
        self._is_receiving = False
        self._stamp: float | None = None  # stamp of the latest usable joint state, s
        self._joints_arrival = 0.0  # clock time at which the latest joint state was received, s
        self.update_time: float | None = None  # time of the last update, s
        self._now: float | None = None
        self.sent_values: np.ndarray | None = None
        self._sent_stamp = 0.0
        self._foreign_watch.reset()
        self._joint_state_watch.clear()
        self._report_stamp = -np.inf

    def _update_clock(self) -> float:
        """Return the clock time, s, and restart the loop if the clock went back."""
        now = self._clock()
        if self._now is not None and now < self._now:
            self._listener.log(f"simulated time went back to {now:.3f} s: restarting the loop")
            stopped = self.servo.phase == STOPPED
            self._clear()
            self.servo.reset()
            self.camera_rig.reset()
            if stopped:
                self.servo.stop("waiting for start")
        if now != self._now:
            self._clock_moved_time = self._wall_clock()
        self._now = now
        return now

    def _describe_stopped_clock(self) -> str:
        """Return a text that says for how long the clock has not advanced; '' if it advances."""
        if self._wall_clock() - self._clock_moved_time < STOPPED_CLOCK_TIME:
            return ""
        return f"the clock has stopped at {self._now:.3f} s (is the simulator paused, or gone?)"

    def _update(
        self, t: float, sample: JointSample | None = None, missing_reason: str = "",
        missing_outcome: Outcome | None = None,
    ) -> JointCommand:
        # A delayed joint state can be older than the last update, whose time followed the clock.
        t = self.update_time = t if self.update_time is None else max(t, self.update_time)
        command = self.servo.update(t, sample, missing_reason, missing_outcome)
        if command.kind == "position" and command.values is not None:
            self.commands.append(JointSample.from_values(t, command.names, command.values))
        return command

    def _stop_without_joints(self, t: float, sample: JointSample | None = None) -> JointCommand:
        """Stop the arm at the time t (s), because its joints cannot be measured.

        Args:
            sample: usable joint sample that came between unusable ones, or None.
        """
        unusable = self._joint_state_watch.find_outcome(self._now)
        reason = self._joints_source.describe_silence(self._joints_arrival)
        command = self._update(t, sample, unusable.reason if unusable else reason, unusable)
        if not self.settings.lockstep:
            self._send(command)
        self._report_periodically(command, sample)
        return command

    def _send(self, command: JointCommand, repeat: bool = False) -> None:
        """Send a command; with `repeat`, send equal positions again if a joint does not follow."""
        values = command.values
        if self._is_ended or values is None or not are_finite(values, values, values):
            return
        if self.sent_values is None and self.servo.phase == STOPPED:
            # The loop has not been started, and another node may command the joints: send nothing.
            return
        if self.servo.is_yielding and command.positions is not None:
            # The last command is no longer in effect, because another node commands the joints.
            self.sent_values = None
            return
        same = self.sent_values is not None and values.tolist() == self.sent_values.tolist()
        if not same:
            self._foreign_watch.reset()
        elif command.positions is not None and not (repeat or self._is_due_again(command)):
            return
        self.sent_values, self._sent_stamp = values, command.stamp
        if not self.settings.dry:
            self._listener.send(command)

    def _is_due_again(self, command: JointCommand) -> bool:
        """Return whether a position command must be sent again.

        The controller may not have received the command, for example because the controller was
        loaded later.
        """
        allowed = not self._is_e_stopped and self._foreign_watch.can_resend(command)
        return allowed and command.stamp - self._sent_stamp >= REPEAT_PERIOD - 1e-9

    def apply_updates(
        self, stamps: Sequence[float], samples: np.ndarray, sent: np.ndarray, sent_stamp: float
    ) -> None:
        """Apply the results of compiled updates.

        Args:
            stamps: (m,) stamps of the processed joint states, s.
            samples: (m, 3, n) their positions and velocities, and the resulting commands.
            sent: command (n,) that was sent last.
            sent_stamp: time when it was sent, s.
        """
        names = self.servo.arm.names
        self.history.extend(names, stamps, samples[:, :2])
        if self.settings.output == "position":
            commands = np.zeros((len(samples), 2, len(names)))
            commands[:, 0] = samples[:, 2]
            self.commands.extend(names, stamps, commands)
        self._joints_time = self._clock_moved_time = self._wall_clock()
        self._stamp = self._joints_arrival = self.update_time = self._now = stamps[-1]
        if sent_stamp > self._sent_stamp:
            self.sent_values, self._sent_stamp = sent, sent_stamp
            self._foreign_watch.reset()

    def _report_periodically(self, command: JointCommand, joints: JointSample | None) -> None:
        """Report the state once per REPORT_PERIOD, if it is not reported for images."""
        if not 0.0 <= command.stamp - self._report_stamp < REPORT_PERIOD:
            state = ServoState(
                command.stamp, self.servo.phase, reason=command.reason, joints=joints,
                command=self.servo.command,
            )  # fmt: skip
            self._report(state.with_outcome(self.servo.outcome))

    def _report(self, state: ServoState) -> None:
        self._report_stamp = state.stamp
        self._listener.report(state)

    def _report_silence(self, wall: float, now: float) -> None:
        """Report once per second which inputs are missing."""
        settings, missing, kind = self.settings, [], "too_few_images"
        if wall - self._joints_time > settings.joint_timeout:
            kind = "no_joint_states"
            missing.append(self._joints_source.describe_silence())
        for camera, image_time in self._image_times.items():
            if wall - image_time > settings.image_timeout and not self.servo.is_approaching:
                source = self._sources.get(camera, self.servo.source)
                ahead = self._stamps_ahead.get(camera)
                missing.append(
                    source.describe_silence()
                    if ahead is None
                    else source.describe_stamp_lead(ahead)
                )
        if not missing or wall - self._silence_report_time < 1.0 or self.servo.phase == STOPPED:
            return
        stopped_clock = self._describe_stopped_clock()
        phase = HOLDING if self.servo.phase == HOLDING else WAITING
        is_certain = self.servo.outcome.kind == kind and len(missing) == 1
        if is_certain and not (stopped_clock or self._stamps_ahead or settings.lockstep) and (
            phase == (HOLDING if kind == "no_joint_states" else WAITING)
        ):  # fmt: skip
            return  # the reports of the state already say which input is missing, and since when
        self._silence_report_time = wall
        reason = "; ".join(filter(None, (stopped_clock, " and ".join(missing))))
        found = self._make_silence_outcome(kind, reason)
        self._report(ServoState(now, phase, found.kind, reason, found.remedy))

    def _make_silence_outcome(self, kind: str, reason: str) -> Outcome:
        """Return the outcome while no inputs are received.

        If the clock has stopped, the remedy of the outcome says how to make it run again.
        """
        found = make_outcome(kind, reason)
        return found.with_remedy(RESUME_ADVICE) if self._describe_stopped_clock() else found
