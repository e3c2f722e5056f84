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

import numpy as np

from ..errors import MeasurementError
from ..kinematics.joint_sample import JointSample
from ..loop.command_integrator import has_jumped
from ..loop.servo import Servo
from ..observation.camera_rig import CameraRig, ObserveFrame
from ..observation.joint_history import MAX_AGE, JointHistory, SampleBuffer
from ..records.outcomes import Outcome
from ..records.state import (
    APPROACHING,
    CONVERGED,
    SERVOING,
    STOPPED,
    WAITING,
    ImageSource,
    JointCommand,
    ServoState,
)
from ..settings import ControllerSettings
from .command_sender import CommandSender, LoopListener
from .foreign_command_watch import (
    MAX_CLOCK_SKEW,
    ForeignCommandSource,
    ForeignCommandWatch,
    JointStateWatch,
)
from .silence_watch import SilenceWatch

# Period at which the loop's state is reported while no images arrive, s: the image period of a
# camera with 30 images per second.
REPORT_PERIOD = 1.0 / 30.0
SILENT_TIME = 0.05  # after this time without a joint state, s, the loop's time follows the clock


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
        self._answer_time = wall_clock()
        self._silence_watch = SilenceWatch(
            servo, settings, self._joints_source, camera_rig.observers, wall_clock
        )
        self.sender = CommandSender(servo, settings, self._foreign_watch, listener)
        self._is_starved = False
        self.start_count = 0  # number of times that joint states started to arrive
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
        self._silence_watch.sources[camera] = source
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
            self._silence_watch.joints_time = self._wall_clock()
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
                self.sender.send(command)
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
            camera, watch = camera or self.camera_rig.control.name, self._silence_watch
            ahead = stamp - self._update_clock()
            if ahead > MAX_CLOCK_SKEW and not self.settings.lockstep:
                # The image was sent before the clock went back, or the camera uses another clock.
                watch.stamps_ahead[camera] = ahead
                return
            watch.stamps_ahead.pop(camera, None)
            watch.image_times[camera] = self._wall_clock()
            together = self.camera_rig.add_image(camera, stamp, observe_frame)
            lacking = self.camera_rig.missing_camera or self.camera_rig.control.name
            self.servo.source = watch.sources.get(lacking, self.servo.source)
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
                command = self._stop_without_joints(max(stamp, self.update_time))
                self.sender.send(command, repeat=True)
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
        self.sender.send(self._update(at if lockstep else self.update_time or at), repeat=lockstep)
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
                    self.sender.send(self._update(self._stamp + silent))
            moving = self.servo.phase in (SERVOING, CONVERGED)
            if moving and wall - self._answer_time > self.settings.wall_watchdog:
                self._is_starved = True
                watch, limit = self._silence_watch, self.settings.wall_watchdog
                why = watch.describe_stopped_clock(now) or self.servo.source.describe_silence()
                reason = f"{why}; no image processed for more than {limit:g} s of wall time"
                self.servo.hold(reason, watch.make_outcome("too_few_images", reason, now))
            if (state := self._silence_watch.report_missing_inputs(now)) is not None:
                self._report(state)

    def start(self) -> None:
        """Start or resume servoing."""
        with self._lock:
            self._is_starved = self.sender.is_e_stopped = False
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
            self.sender.is_e_stopped |= pressed

    def shut_down(self, reason: str) -> None:
        """Stop the arm, and send no more commands.

        If the output is velocity or effort, the last command is zero.
        """
        with self._lock:
            self.servo.stop(reason)
            self.sender.end(self.update_time or 0.0)

    def apply_change(self, change: Callable[[Servo], None]) -> None:
        """Change the loop by calling `change` between two of its steps."""
        with self._lock:
            change(self.servo)

    def _clear(self) -> None:
        self.history.clear()
        self.commands.clear()
        self._pending_image: tuple[float, ObserveFrame] | None = None
        self._silence_watch.stamps_ahead.clear()
        # Whether joint states have come since the start or the last reset of the clock.
        self._is_receiving = False
        self._stamp: float | None = None  # stamp of the latest usable joint state, s
        self._joints_arrival = 0.0  # clock time at which the latest joint state was received, s
        self.update_time: float | None = None  # time of the last update, s
        self._now: float | None = None
        self.sender.clear()
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
            self._silence_watch.clock_moved_time = self._wall_clock()
        self._now = now
        return now

    def _update(
        self, t: float, sample: JointSample | None = None, missing_reason: str = "",
        missing_outcome: Outcome | None = None,
    ) -> JointCommand:
        # A delayed joint state can be older than the last update, whose time followed the clock.
        t = self.update_time = t if self.update_time is None else max(t, self.update_time)
        command = self.servo.update(t, sample, missing_reason, missing_outcome)
        if command.kind == "position" and command.values is not None:
            rows = np.zeros((1, 2, len(command.names)))
            rows[0, 0] = command.values
            self.commands.extend(command.names, (t,), rows)
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
            self.sender.send(command)
        self._report_periodically(command, sample)
        return command

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
        watch = self._silence_watch
        watch.joints_time = watch.clock_moved_time = self._wall_clock()
        self._stamp = self._joints_arrival = self.update_time = self._now = stamps[-1]
        self.sender.note_sent(sent, sent_stamp)

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
