"""Drives a loop by what arrives: joint states, images, the passing of time. No ROS.

    joint states ─► history ─► Servo.tick ─► commands
    images ──────► joints of their own instant ─► Observation ─► Servo.see ─► reports
    watch (a thread of its own) ─► stops the arm smoothly when nothing comes any more

Time is that of the joint states' stamps; between and after them it goes on with the clock. Only
the clock going back begins the loop anew: messages that are late or have no stamp do not.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import Protocol

import numpy as np

from ..arm.algebra import finite
from ..arm.joint_sample import JointSample
from ..errors import MeasurementError
from ..loop.motion import jumped
from ..loop.servo import Servo
from ..records.outcomes import Outcome, outcome
from ..records.state import (
    APPROACHING,
    CONVERGED,
    HOLDING,
    SERVOING,
    STOPPED,
    WAITING,
    Command,
    ServoState,
    Source,
)
from ..seeing.joint_history import FARTHEST, JointHistory
from ..seeing.rig import Look, Rig
from ..settings import Settings
from .foreign import ForeignCommands, ForeignWatch

REPORT_PERIOD = 1.0 / 30.0  # s; without images, reports need not be faster than a camera
SILENT = 0.05  # s without a joint state after which time goes on by the clock
STANDING = 0.5  # s of wall time after which a clock that does not go on is worth a word
RESUME = "resume the simulation, or start the simulator again"
REPEAT_PERIOD = 0.1  # s between two sendings of a command that a joint does not follow
SKEW = 0.5  # s; stamps further off the clock are of another clock, or of none


class Face(Protocol):
    """What a driver tells the world."""

    def send(self, command: Command) -> None:
        """To the joints."""

    def report(self, state: ServoState) -> None:
        """What was seen, decided and done."""

    def say(self, text: str) -> None:
        """One line for a person."""


class Driver:
    """One loop and what it is told; every method may be called from any thread."""

    def __init__(
        self,
        servo: Servo,
        rig: Rig,
        settings: Settings,
        face: Face,
        clock: Callable[[], float],
        wall: Callable[[], float] = time.monotonic,
        foreign: ForeignCommands | None = None,
    ) -> None:
        """`clock`: s, of the stamps, simulated or not; `wall`: s of wall time; `foreign`: commands
        of other nodes, None where they cannot be received."""
        self.servo, self.rig, self.settings = servo, rig, settings
        self._face, self._clock, self._wall = face, clock, wall
        self._lead = np.atleast_1d(np.asarray(servo.settings.lead, float))
        self._lock = threading.RLock()
        self.history = JointHistory()
        self._foreign = ForeignWatch(servo, self.history, settings, foreign)
        rig.joints_at = partial(self.history.at, earlier_only=settings.lockstep)
        self.commands: deque[JointSample] = deque(maxlen=256)
        self._joints_heard = self._answered = wall()
        self._images_heard = dict.fromkeys(rig.observers, wall())
        self._said_silence = -np.inf
        self._moved = wall()  # when the clock last went on
        self._starved = self._e_stopped = self._ended = False
        self.beginnings = 0  # how often joint states began to come
        self._sources: dict[str, Source] = {}
        features = settings.camera_of(rig.control.name).features
        self.comes_from(
            rig.control.name, Source("features", f"{features}/moments", "the camera node")
        )
        self._clear()
        if not settings.autostart:
            servo.stop("waiting for start")

    def comes_from(self, camera: str, source: Source) -> None:
        """Where a camera's images come from, for messages."""
        self._sources[camera] = source
        if camera == self.rig.control.name:
            self.servo.source = source

    # -- what is heard ---------------------------------------------------------------------

    def joints(
        self,
        names: Sequence[str],
        positions: Sequence[float],
        velocities: Sequence[float],
        stamp: float,
    ) -> None:
        """One joint state."""
        with self._lock:
            self._joints_heard = self._wall()
            now = self._follow()
            if not stamp > 0.0 or abs(now - stamp) > SKEW and not self.settings.lockstep:
                stamp = now
            if self._stamp is None:
                self.beginnings += 1
            elif stamp <= self._stamp:
                return  # late
            self._stamp, self._arrived = stamp, now
            try:
                sample = self.servo.arm.sample(names, positions, velocities, stamp)
            except (MeasurementError, TypeError, ValueError) as error:
                self._blind(stamp, str(error))
                return
            if not len(velocities):
                sample = self.history.with_speed(sample)
            newest = self.history.newest
            if newest is not None:
                dt = sample.stamp - newest.stamp
                if dt > self.settings.watchdog or jumped(
                    sample.positions, newest.positions, sample.velocities, newest.velocities,
                    self._lead, dt,
                ):  # fmt: skip
                    self.servo.joints_jumped()  # or not heard of for long
            self.history.add(sample)
            if self._foreign.is_able:
                self._foreign.find(self._wall())
            command = self._tick(stamp, sample)
            if not self.settings.lockstep:
                self._send(command)
            if self._waiting is not None:
                self._look(*self._waiting)
            if self.servo.phase in (APPROACHING, WAITING, STOPPED):
                self._now_and_then(command, sample)

    def image(self, stamp: float, look: Look, camera: str = "") -> None:
        """One image; `look` makes its observation, given the joints of its instant.

        camera: its name; '': the control camera.
        """
        with self._lock:
            camera = camera or self.rig.control.name
            ahead = stamp - self._follow()
            if ahead > SKEW and not self.settings.lockstep:
                # It was on its way when the clock went back, or all of them are of another clock.
                self._ahead[camera] = ahead
                return
            self._ahead.pop(camera, None)
            self._images_heard[camera] = self._wall()
            together = self.rig.add(camera, stamp, look)
            lacking = self.rig.waits_for or self.rig.control.name
            self.servo.source = self._sources.get(lacking, self.servo.source)
            if together is None:
                return
            stamp, look = together
            if self._starved:
                self._starved = False
                self.servo.start()
            newest = self.history.newest
            silent = 0.0 if newest is None else stamp - newest.stamp
            if silent > max(self.settings.watchdog, SILENT):
                self._blind(stamp, f"no joint states for {silent:.2f} s")
            self._look(stamp, look)

    def _look(self, stamp: float, look: Look) -> None:
        self._waiting = None
        lockstep = self.settings.lockstep
        if lockstep and not self.history.complete_to(stamp):
            self._waiting = stamp, look
            return
        joints, newest = self.history.at(stamp, earlier_only=lockstep), self.history.newest
        if newest is not None and stamp - newest.stamp > FARTHEST:
            return  # whatever it shows, nothing is known of the joints any more
        since: list[JointSample] = []  # commands from the stamp on
        for command in reversed(self.commands):
            if command.stamp < stamp:
                break
            since.append(command)
        state = self.servo.see(look(joints, tuple(reversed(since))))
        if not state.answers_image:
            return  # late, or seen before
        if state.fault:
            self._face.say(state.fault)
        if state.phase in (SERVOING, CONVERGED):
            self._answered = self._wall()
        at = stamp if self.time is None else max(stamp, self.time)
        self._send(self._tick(at if lockstep else self.time or at), repeat=lockstep)
        self._report(state)

    def watch(self) -> None:
        """Call often, from a thread of its own: stops the arm when nothing comes any more."""
        with self._lock:
            now, wall = self._follow(), self._wall()
            if self._stamp is not None and not self.settings.lockstep:
                silent = now - self._arrived
                if silent > max(self.settings.watchdog, SILENT):
                    self._blind(self._stamp + silent, f"no joint states for {silent:.2f} s")
                elif silent > SILENT:
                    self._send(self._tick(self._stamp + silent))
            moving = self.servo.phase in (SERVOING, CONVERGED)
            if moving and wall - self._answered > self.settings.wall_watchdog:
                self._starved = True
                reason = f"no answer for {wall - self._answered:.1f} s of wall time"
                reason = f"{reason}: {self._standing() or self.servo.source.missing()}"
                self.servo.hold(reason, self._silence("too_few_images", reason))
            self._tell_silence(wall, now)

    # -- what is asked for -----------------------------------------------------------------

    def start(self) -> None:
        """Servo."""
        with self._lock:
            self._starved = self._e_stopped = False
            self._answered = self._wall()
            self.servo.start()

    def stop(self, reason: str = "stopped") -> None:
        """Come smoothly to rest until `start`."""
        with self._lock:
            self._starved = False
            self.servo.stop(reason)

    def hold(self, reason: str = "held") -> None:
        """Come smoothly to rest and hold still until `start`."""
        with self._lock:
            self._starved = False
            self.servo.hold(reason)

    def emergency_stop(self, pressed: bool) -> None:
        """The arm's emergency stop; after it no command is repeated until `start`."""
        with self._lock:
            self._e_stopped |= pressed

    def end(self, reason: str) -> None:
        """Stop, and send nothing any more; speeds and efforts end with zeros, which come last."""
        with self._lock:
            self.servo.stop(reason)
            self._ended = True
            kind, names = self.settings.output, self.servo.arm.names
            if kind != "position" and not self.settings.dry:
                zeros = np.zeros(len(names))
                self._face.send(Command(self.time or 0.0, names, zeros, kind, phase=STOPPED))

    def change(self, apply: Callable[[Servo], None]) -> None:
        """Change something of the loop between two of its steps."""
        with self._lock:
            apply(self.servo)

    # -- shared ----------------------------------------------------------------------------

    def _clear(self) -> None:
        self.history.clear()
        self.commands.clear()
        self._waiting: tuple[float, Look] | None = None
        self._ahead: dict[str, float] = {}  # s by which a camera's last image was, and so left out
        self._stamp: float | None = None  # of the latest joint state
        self._arrived = 0.0  # when that came, by the clock
        self.time: float | None = None  # that the loop was last told
        self._now: float | None = None
        self.sent: np.ndarray | None = None
        self._sent_at = 0.0
        self._foreign.forget()
        self._reported = -np.inf

    def _follow(self) -> float:
        """The clock, s; when it went back, the loop begins anew."""
        now = self._clock()
        if self._now is not None and now < self._now:
            self._face.say(f"simulated time went back to {now:.3f} s: beginning anew")
            stopped = self.servo.phase == STOPPED
            self._clear()
            self.servo.reset()
            self.rig.reset()
            if stopped:
                self.servo.stop("waiting for start")
        if now != self._now:
            self._moved = self._wall()
        self._now = now
        return now

    def _standing(self) -> str:
        """That the clock has not moved for long, in words; empty while it does."""
        if self._wall() - self._moved < STANDING:
            return ""
        return f"time stands still at {self._now:.3f} s (is the simulator paused, or gone?)"

    def _tick(
        self, t: float, sample: JointSample | None = None, unmeasured: str = ""
    ) -> Command:
        # A joint state that was held up comes behind a tick by the clock, which did not go back.
        t = self.time = t if self.time is None else max(t, self.time)
        command = self.servo.tick(t, sample, unmeasured)
        if command.kind == "position" and command.values is not None:
            self.commands.append(JointSample.of(t, command.names, command.values))
        return command

    def _blind(self, t: float, reason: str) -> None:
        """Joints that cannot be measured stop the arm."""
        command = self._tick(t, unmeasured=reason)
        if not self.settings.lockstep:
            self._send(command)
        self._now_and_then(command, None)

    def _send(self, command: Command, repeat: bool = False) -> None:
        """Send; positions that are not new only where a joint does not follow them."""
        values = command.values
        if self._ended or values is None or not finite(values, values, values):
            return
        if self.sent is None and self.servo.phase == STOPPED:
            return  # standing by: whoever commands the joints now goes on doing so
        if self.servo.yields and command.positions is not None:
            self.sent = None  # a controller has other commands now
            return
        same = self.sent is not None and values.tolist() == self.sent.tolist()
        if not same:
            self._foreign.forget()
        elif command.positions is not None and not (repeat or self._is_due_again(command)):
            return
        self.sent, self._sent_at = values, command.stamp
        if not self.settings.dry:
            self._face.send(command)

    def _is_due_again(self, command: Command) -> bool:
        """Whether a position command is sent again: a controller may not have received it, as one
        that was loaded after it was sent."""
        allowed = not self._e_stopped and self._foreign.allows(command)
        return allowed and command.stamp - self._sent_at >= REPEAT_PERIOD - 1e-9

    def ticked(
        self, samples: Sequence[JointSample], commands: np.ndarray, sent: np.ndarray, at: float
    ) -> None:
        """Compiled ticks answered joint states with commands (m, n); what was sent last, and when,
        s."""
        still = np.zeros(len(sent))
        for sample, command in zip(samples, commands, strict=False):
            self.history.add(sample)
            self.commands.append(JointSample(sample.stamp, sample.names, command, still))
        self._joints_heard = self._moved = self._wall()
        self._stamp = self._arrived = self.time = self._now = samples[-1].stamp
        if at > self._sent_at:
            self.sent, self._sent_at = sent, at
            self._foreign.forget()

    def _now_and_then(self, command: Command, joints: JointSample | None) -> None:
        """Report without an image, at a camera's pace."""
        if not 0.0 <= command.stamp - self._reported < REPORT_PERIOD:
            state = ServoState(
                command.stamp, self.servo.phase, reason=command.reason, joints=joints,
                command=self.servo.command,
            )  # fmt: skip
            self._report(state.with_outcome(self.servo.outcome))

    def _report(self, state: ServoState) -> None:
        self._reported = state.stamp
        self._face.report(state)

    def _tell_silence(self, wall: float, now: float) -> None:
        """Say what does not come, once a second."""
        settings, missing, kind = self.settings, [], "too_few_images"
        if wall - self._joints_heard > settings.joint_timeout:
            kind = "no_joint_states"
            missing.append(
                f"no joint states on {settings.namespace}/joint_states (is the simulator running?)"
            )
        for camera, heard in self._images_heard.items():
            if wall - heard > settings.image_timeout and not self.servo.approaching:
                source = self._sources.get(camera, self.servo.source)
                ahead = self._ahead.get(camera)
                missing.append(source.missing() if ahead is None else source.ahead(ahead))
        if not missing or wall - self._said_silence < 1.0 or self.servo.phase == STOPPED:
            return
        self._said_silence = wall
        phase = HOLDING if self.servo.phase == HOLDING else WAITING
        reason = " and ".join(missing) + (f"; {words}" if (words := self._standing()) else "")
        found = self._silence(kind, reason)
        self._report(ServoState(now, phase, found.kind, reason, found.remedy))

    def _silence(self, kind: str, reason: str) -> Outcome:
        """The outcome while nothing comes: a clock that does not go on stops everything."""
        found = outcome(kind, reason)
        return found.with_remedy(RESUME) if self._standing() else found
