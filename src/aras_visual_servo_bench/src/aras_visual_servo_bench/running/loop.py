"""Runs an experiment: the plant goes from measurement to measurement, the loop answers each."""

from __future__ import annotations

import heapq
import logging
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from aras_visual_servo_base.memory import release_freed_memory
from aras_visual_servo_base.poses import inverse
from aras_visual_servo_controller.driving.driver import Driver
from aras_visual_servo_controller.records.remedy import Remedy
from aras_visual_servo_controller.records.run_record import Record
from aras_visual_servo_controller.records.state import CONVERGED, Command, ServoState
from aras_visual_servo_controller.seeing.frame import Frame, seconds

from ..asked.experiment import Experiment
from ..errors import log_once
from ..plants import JointReading
from ..recording.from_loop import Recorder
from ..recording.run import Run, Verdict
from ..setup.assembly import Assembly, assemble

if TYPE_CHECKING:
    from .ending import Ending

NS = 1_000_000_000
LAST_NS = 50_000_000
PATIENCE_NS = 5 * NS  # for a first picture
SEEN_THROUGH = (
    "at the end the arm, where it is drawn, hides {:.0f} % of the target: plant chain sees through "
    "it, plant bullet does not"
)
STUCK = "joints_do_not_follow"
IN_THE_WAY = "begin in another posture, or choose start and goal so that the arm keeps clear of {}"
SHAKES = "camera '{}' shakes {}; the verdict and the camera's path are of its place at rest"
log = logging.getLogger(__name__)


def run(experiment: Experiment | Mapping[str, Any] | str | Path | None = None) -> Run:
    """Run an experiment from its start to its end.

    The time is simulated: the same experiment and seed give bit-identical results on every run.

    Args:
        experiment: an Experiment, a mapping of its keys, or the path of its YAML file; None: the
            default experiment.

    Returns:
        The run: curves, `outcome` of the loop, and `verdict` of the physics.

    Raises:
        ExperimentError: it cannot be run, with the key that is wrong and what would be right. What
            goes wrong while it runs is an outcome, not an error.
    """
    result = _carry_out(Experiment.of(experiment))
    release_freed_memory()
    return result


def _carry_out(experiment: Experiment) -> Run:
    """Run an experiment; nothing of the loop and its plant is left afterwards."""
    loop = Loop(experiment, assemble(experiment), filmed=experiment.pictures)
    try:
        loop.to_end()
        return loop.result()
    finally:
        loop.close()


class Loop:
    """A run under way, to be driven image by image; the node's own Driver drives the loop.

    `to_image` continues to the next image and its answer, `to_end` to the end; `result` is the run
    so far. `run(experiment)` does the same at once. Call `close` at the end.

    Attributes:
        experiment, parts: as given. servo: the servo loop.
        reading, state: the last image and the answer to it, or None.
    """

    def __init__(
        self, experiment: Experiment, parts: Assembly, filmed: bool = False,
        watch: Callable[[Loop, Frame], None] | None = None,
    ) -> None:
        """`filmed`: keep what other cameras than the control camera see. `watch`: is told of every
        camera's images as they are made."""
        self.experiment, self.parts = experiment, parts
        self.plant, self.servo = parts.plant, parts.servo
        self.reading: Frame | None = None
        self.state: ServoState | None = None
        self._recorder = Recorder(len(self.plant.joint_names), filmed)
        self.servo.keep = self._recorder.records.append
        self._flies = "twist" in self.plant.outputs
        self._ending: Ending | None = None
        if self._flies:
            from .ending import Ending

            self._ending = Ending(experiment, parts)
        # Wall time stands still: what is late here is late in simulated time.
        self._driver = Driver(
            parts.servo, parts.rig, parts.settings, self,
            clock=lambda: seconds(self.plant.time_ns), wall=lambda: 0.0,
        )  # fmt: skip
        self._watch = watch
        self._answered = False
        self._coming: list[tuple[int, int, Frame]] = []  # heap, by when they arrive, ns
        self._delayed = 0
        self._delays_ns = {name: round(eye.delay * NS) for name, eye in parts.eyes.items()}
        self._began_ns: int | None = None
        self._converged_ns: int | None = None
        self._touched: tuple[str, str] | None = None
        self.plant.join(self._driver, self._recorder, lambda: self._last_ns)

    # -- what the driver tells -------------------------------------------------------------

    def send(self, command: Command) -> None:
        """To the plant's joints, unless it takes the camera's twist itself."""
        if command.values is not None and not self._flies:
            self.plant.command(command.kind, command.values)
            self._recorder.commanded(command.values)

    def report(self, state: ServoState) -> None:
        """Keep the answer to an image; what is reported in between is for those who watch."""
        if not state.answers_image:
            return
        self._answered = True
        if state.phase != CONVERGED:
            self._converged_ns = None
        elif self._converged_ns is None:
            self._converged_ns = self.plant.time_ns
        self.state = state
        if state.outcome == STUCK and self._touched is None:
            self._touched = self.plant.touched()
        self._recorder.image(state, self.plant.pose())
        if self._ending is not None:
            self._ending.image(state, self.plant.pose())
            self.plant.command("twist", state.achieved)

    def say(self, text: str) -> None:
        """Into the log."""
        log.info("%s", text)

    # -- the run ---------------------------------------------------------------------------

    @property
    def records(self) -> tuple[Record, ...]:
        """What the diagnosis has read so far: `diagnose(servo.diagnosis.run, records)` repeats it.
        """
        return tuple(self._recorder.records)

    @property
    def servo_time(self) -> float:
        """s since the first image; 0 before it."""
        return 0.0 if self._began_ns is None else (self.plant.time_ns - self._began_ns) / NS

    @property
    def over(self) -> bool:
        """Whether the experiment's end has come."""
        if self._ending is not None and self._ending.over:
            return True
        return self.plant.time_ns > self._last_ns

    @property
    def _last_ns(self) -> float:
        """The time, ns, behind which the end has come, as known by now."""
        linger = self.experiment.linger
        if self._began_ns is None:
            return PATIENCE_NS - 1
        # An image more, for the loop to find that its time is over.
        last_ns = self._began_ns + self.experiment.duration * NS + LAST_NS
        if linger is None or self._converged_ns is None or self._flies:
            return last_ns
        return min(last_ns, np.nextafter(self._converged_ns + linger * NS, 0.0))

    def to_end(self) -> None:
        """Continue to the end of the run."""
        while not self.over:
            self.to_image()

    def to_image(self) -> ServoState | None:
        """Continue until an image is answered; returns the answer, None where time ran out."""
        driver, observe = self._driver, self.parts.observe
        self._answered = False
        while not (self.over or self._answered):
            for reading in self._measure():
                if isinstance(reading, JointReading):
                    stamp = reading.stamp
                    driver.joints(reading.names, reading.positions, reading.velocities, stamp)
                    self._recorder.joints(stamp, *reading.of(self.plant.joint_names))
                    continue
                if reading.name == self.parts.rig.control.name:
                    self.reading = reading
                driver.image(reading.stamp, partial(observe, reading), reading.name)
        return self.state if self._answered else None

    def _measure(self) -> Iterator[JointReading | Frame]:
        """Go on in time; the joint states and frames that the loop has then, each after the delay
        of its camera."""
        plant, coming = self.plant, self._coming
        until_ns = plant.time_ns + NS
        if coming:
            until_ns = min(until_ns, coming[0][0])
        for reading in plant.advance(until_ns):
            if isinstance(reading, JointReading):
                yield reading
                continue
            self._exposed(reading)
            if reading.name not in self.parts.rig.observers:
                continue
            if delay_ns := self._delays_ns[reading.name]:
                self._delayed += 1  # a tie's order
                heapq.heappush(coming, (reading.stamp_ns + delay_ns, self._delayed, reading))
            else:
                yield reading
        while coming and coming[0][0] <= plant.time_ns:
            yield heapq.heappop(coming)[2]

    def _exposed(self, frame: Frame) -> None:
        """Note that a frame was made, whether the loop reads it or not."""
        if self._watch is not None:
            self._watch(self, frame)
        if frame.name != self.parts.rig.control.name:
            model = self.parts.eyes[frame.name].true
            pose = self.parts.places[frame.name].at(self.plant.at_rest())
            pose = self.plant.shaken(pose, frame.stamp_ns, frame.name)
            self._recorder.saw(frame, pose, model)
        elif self._began_ns is None:
            self._began_ns = frame.stamp_ns

    def goal_pose(self) -> np.ndarray:
        """world_T_camera (4, 4) where the camera ought to be now, before a target that may move."""
        target = self.parts.target
        moved = target.world_T_target(self.plant.time_ns / NS) @ inverse(target.world_T_target(0.0))
        return moved @ self.parts.goal_pose

    def verdict(self) -> Verdict:
        """What the physics says of the camera's place now, or of that about which it shakes."""
        believed = self.parts.eyes[self.parts.rig.control.name].spec.believed
        depth = self.parts.goal.distance / believed.depth
        return Verdict.of(self.goal_pose(), self.plant.at_rest(), depth, self.experiment.reached)

    def result(self) -> Run:
        """Return the run up to now."""
        if self.over and self.servo.outcome.kind == "running":
            # It holds, for less time than a lost target is worth a word: the loop's own end of
            # time asks for a measurement.
            self.servo.time_out(self.experiment.duration)
        outcome = self.servo.outcome
        if self._ending is not None:
            outcome = self._ending.last_word(outcome)
        if outcome.kind == STUCK and self._touched is not None:
            link, other = self._touched
            reason = f"{outcome.reason}: link '{link}' has run into '{other}'"
            remedy = Remedy(IN_THE_WAY.format(f"'{other}'"))
            outcome = replace(outcome, reason=reason, remedy=remedy)
        run = self._recorder.run(
            self.plant, self.experiment, self.parts,
            goal_pose=self.goal_pose(),
            joint_names=self.plant.joint_names,
            outcome=outcome.kind,
            reason=outcome.reason,
            remedy=outcome.remedy,
            verdict=self.verdict(),
            peak_speed=getattr(self.plant, "peak_speed", None),
            notes=[*self.parts.notes] + [
                SHAKES.format(name, one.shake) for name, one in self.plant.vibrations.items()
            ],
        )  # fmt: skip
        if self.experiment.plant == "chain" and run.converged:
            hidden = self.parts.postures.hidden(self.plant.joints()[0], self.plant.time_ns / NS)
            if hidden:
                run.notes.append(SEEN_THROUGH.format(100.0 * hidden))
                log_once(run.notes[-1])
        return run

    def close(self) -> None:
        """Close the plant."""
        self.plant.close()
