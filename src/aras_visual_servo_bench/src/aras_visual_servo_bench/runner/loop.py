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
from aras_visual_servo_controller.observation.frame import Frame, to_seconds
from aras_visual_servo_controller.records.remedy import Remedy
from aras_visual_servo_controller.records.run_record import Record
from aras_visual_servo_controller.records.state import CONVERGED, Command, ServoState
from aras_visual_servo_controller.runner.loop_runner import LoopRunner

from ..errors import log_once
from ..experiment.experiment import Experiment
from ..plants import JointReading
from ..recording.run import Run, Verdict
from ..recording.run_recorder import RunRecorder
from ..setup.assembly import Assembly, assemble

if TYPE_CHECKING:
    from .run_termination import RunTermination

NS = 1_000_000_000
FINAL_NS = 50_000_000
FIRST_IMAGE_TIMEOUT_NS = 5 * NS  # for a first picture
OCCLUSION_NOTE = (
    "at the end the arm, where it is drawn, hides {:.0f} % of the target: plant chain sees through "
    "it, plant bullet does not"
)
STUCK_OUTCOME = "joints_do_not_follow"
COLLISION_REMEDY = (
    "begin in another posture, or choose start and goal so that the arm keeps clear of {}"
)
VIBRATION_NOTE = "camera '{}' shakes {}; the verdict and the camera's path are of its place at rest"
log = logging.getLogger(__name__)


def run(experiment: Experiment | Mapping[str, Any] | str | Path | None = None) -> Run:
    """Run an experiment from its start to its end.

    The time is simulated: the same experiment and seed give bit-identical results on every run.

    Args:
        experiment: an Experiment, a mapping of its keys, or the path of its YAML file; None: the
            default experiment.

    Returns:
        The run: curves, `outcome` of the loop, and `compute_verdict` of the physics.

    Raises:
        ExperimentError: it cannot be run, with the key that is wrong and what would be right. What
            goes wrong while it runs is an outcome, not an error.
    """
    result = _run_once(Experiment.load(experiment))
    release_freed_memory()
    return result


def _run_once(experiment: Experiment) -> Run:
    """Run an experiment; nothing of the loop and its plant is left afterwards."""
    loop = Loop(experiment, assemble(experiment), records_films=experiment.has_images)
    try:
        loop.run_to_end()
        return loop.make_run()
    finally:
        loop.close()


class Loop:
    """A run under way, to be driven image by image; the node's own Driver drives the loop.

    `run_to_image` continues to the next image and its answer, `run_to_end` to the end; `result` is
    the run so far. `run(experiment)` does the same at once. Call `close` at the end.

    Attributes:
        experiment, parts: as given. servo: the servo loop.
        reading, state: the last image and the answer to it, or None.
    """

    def __init__(
        self, experiment: Experiment, parts: Assembly, records_films: bool = False,
        on_frame: Callable[[Loop, Frame], None] | None = None,
    ) -> None:
        """`records_films`: keep what other cameras than the control camera see. `on_frame`: is told
        of every camera's images as they are made."""
        self.experiment, self.parts = experiment, parts
        self.plant, self.servo = parts.plant, parts.servo
        self.reading: Frame | None = None
        self.state: ServoState | None = None
        self._recorder = RunRecorder(len(self.plant.joint_names), records_films)
        self.servo.on_record = self._recorder.records.append
        self._has_free_camera = "twist" in self.plant.outputs
        self._termination: RunTermination | None = None
        if self._has_free_camera:
            from .run_termination import RunTermination

            self._termination = RunTermination(experiment, parts)
        # Wall time stands still: what is late here is late in simulated time.
        self._driver = LoopRunner(
            parts.servo, parts.rig, parts.settings, self,
            clock=lambda: to_seconds(self.plant.time_ns), wall_clock=lambda: 0.0,
        )  # fmt: skip
        self._on_frame = on_frame
        self._has_answer = False
        self._pending: list[tuple[int, int, Frame]] = []  # heap, by when they arrive, ns
        self._delayed_count = 0
        self._delays_ns = {name: round(eye.delay * NS) for name, eye in parts.cameras.items()}
        self._start_ns: int | None = None
        self._convergence_ns: int | None = None
        self._collision: tuple[str, str] | None = None
        self.plant.attach_loop(self._driver, self._recorder, lambda: self._last_ns)

    # -- what the driver tells -------------------------------------------------------------

    def send(self, command: Command) -> None:
        """To the plant's joints, unless it takes the camera's twist itself."""
        if command.values is not None and not self._has_free_camera:
            self.plant.command(command.kind, command.values)
            self._recorder.on_command(command.values)

    def report(self, state: ServoState) -> None:
        """Keep the answer to an image; what is reported in between is for those who watch."""
        if not state.has_processed_image:
            return
        self._has_answer = True
        if state.phase != CONVERGED:
            self._convergence_ns = None
        elif self._convergence_ns is None:
            self._convergence_ns = self.plant.time_ns
        self.state = state
        if state.outcome == STUCK_OUTCOME and self._collision is None:
            self._collision = self.plant.find_collision()
        self._recorder.add_state(state, self.plant.read_pose())
        if self._termination is not None:
            self._termination.add_image(state, self.plant.read_pose())
            self.plant.command("twist", state.achieved_twist)

    def log(self, text: str) -> None:
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
        return 0.0 if self._start_ns is None else (self.plant.time_ns - self._start_ns) / NS

    @property
    def is_over(self) -> bool:
        """Whether the experiment's end has come."""
        if self._termination is not None and self._termination.is_over:
            return True
        return self.plant.time_ns > self._last_ns

    @property
    def _last_ns(self) -> float:
        """The time, ns, behind which the end has come, as known by now."""
        time_after_convergence = self.experiment.time_after_convergence
        if self._start_ns is None:
            return FIRST_IMAGE_TIMEOUT_NS - 1
        # An image more, for the loop to find that its time is over.
        last_ns = self._start_ns + self.experiment.duration * NS + FINAL_NS
        if time_after_convergence is None or self._convergence_ns is None or self._has_free_camera:
            return last_ns
        return min(last_ns, np.nextafter(self._convergence_ns + time_after_convergence * NS, 0.0))

    def run_to_end(self) -> None:
        """Continue to the end of the run."""
        while not self.is_over:
            self.run_to_image()

    def run_to_image(self) -> ServoState | None:
        """Continue until an image is answered; returns the answer, None where time ran out."""
        driver, observe = self._driver, self.parts.observe
        self._has_answer = False
        while not (self.is_over or self._has_answer):
            for reading in self._advance_plant():
                if isinstance(reading, JointReading):
                    stamp = reading.stamp
                    driver.add_joint_state(
                        reading.names, reading.positions, reading.velocities, stamp
                    )
                    self._recorder.on_joints(stamp, *reading.select(self.plant.joint_names))
                    continue
                if reading.name == self.parts.rig.control.name:
                    self.reading = reading
                driver.add_image(reading.stamp, partial(observe, reading), reading.name)
        return self.state if self._has_answer else None

    def _advance_plant(self) -> Iterator[JointReading | Frame]:
        """Go on in time; the joint states and frames that the loop has then, each after the delay
        of its camera."""
        plant, coming = self.plant, self._pending
        until_ns = plant.time_ns + NS
        if coming:
            until_ns = min(until_ns, coming[0][0])
        for reading in plant.advance(until_ns):
            if isinstance(reading, JointReading):
                yield reading
                continue
            self._note_exposure(reading)
            if reading.name not in self.parts.rig.observers:
                continue
            if delay_ns := self._delays_ns[reading.name]:
                self._delayed_count += 1  # a tie's order
                heapq.heappush(coming, (reading.stamp_ns + delay_ns, self._delayed_count, reading))
            else:
                yield reading
        while coming and coming[0][0] <= plant.time_ns:
            yield heapq.heappop(coming)[2]

    def _note_exposure(self, frame: Frame) -> None:
        """Note that a frame was made, whether the loop reads it or not."""
        if self._on_frame is not None:
            self._on_frame(self, frame)
        if frame.name != self.parts.rig.control.name:
            model = self.parts.cameras[frame.name].true_camera
            pose = self.parts.placements[frame.name].compute_pose(self.plant.read_rest_pose())
            pose = self.plant.apply_vibration(pose, frame.stamp_ns, frame.name)
            self._recorder.add_image(frame, pose, model)
        elif self._start_ns is None:
            self._start_ns = frame.stamp_ns

    def compute_goal_pose(self) -> np.ndarray:
        """world_T_camera (4, 4) where the camera ought to be now, before a target that may move."""
        target = self.parts.target
        moved = target.world_T_target(self.plant.time_ns / NS) @ inverse(target.world_T_target(0.0))
        return moved @ self.parts.goal_pose

    def compute_verdict(self) -> Verdict:
        """What the physics says of the camera's place now, or of that about which it shakes."""
        believed = self.parts.cameras[self.parts.rig.control.name].spec.calibration_offset
        depth = self.parts.goal.distance / believed.depth
        return Verdict.compare(
            self.compute_goal_pose(), self.plant.read_rest_pose(), depth, self.experiment.reached
        )

    def make_run(self) -> Run:
        """Return the run up to now."""
        if self.is_over and self.servo.outcome.kind == "running":
            # It holds, for less time than a lost target is worth a word: the loop's own end of
            # time asks for a measurement.
            self.servo.time_out(self.experiment.duration)
        outcome = self.servo.outcome
        if self._termination is not None:
            outcome = self._termination.decide_outcome(outcome)
        if outcome.kind == STUCK_OUTCOME and self._collision is not None:
            link, other = self._collision
            reason = f"{outcome.reason}: link '{link}' has run into '{other}'"
            remedy = Remedy(COLLISION_REMEDY.format(f"'{other}'"))
            outcome = replace(outcome, reason=reason, remedy=remedy)
        run = self._recorder.make_run(
            self.plant, self.experiment, self.parts,
            goal_pose=self.compute_goal_pose(),
            joint_names=self.plant.joint_names,
            outcome=outcome.kind,
            reason=outcome.reason,
            remedy=outcome.remedy,
            verdict=self.compute_verdict(),
            peak_speed=getattr(self.plant, "peak_speed", None),
            notes=[*self.parts.notes] + [
                VIBRATION_NOTE.format(name, one.shake) for name,
                one in self.plant.vibrations.items()
            ],
        )  # fmt: skip
        if self.experiment.plant == "chain" and run.converged:
            hidden = self.parts.postures.compute_occlusion(
                self.plant.read_joints()[0], self.plant.time_ns / NS
            )
            if hidden:
                run.notes.append(OCCLUSION_NOTE.format(100.0 * hidden))
                log_once(run.notes[-1])
        return run

    def close(self) -> None:
        """Close the plant."""
        self.plant.close()
