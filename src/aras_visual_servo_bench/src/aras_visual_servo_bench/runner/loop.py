"""Run an experiment: advance the plant in simulated time, and update the control loop."""

from __future__ import annotations

import heapq
import logging
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from aras_visual_servo_base.memory import release_freed_memory
from aras_visual_servo_base.poses import inverse
from aras_visual_servo_controller.observation.frame import NANOSECONDS, Frame, to_seconds
from aras_visual_servo_controller.records.remedy import Remedy
from aras_visual_servo_controller.records.run_record import Record
from aras_visual_servo_controller.records.state import CONVERGED, JointCommand, ServoState
from aras_visual_servo_controller.runner.loop_runner import LoopRunner

from ..errors import log_once
from ..experiment.experiment import Experiment
from ..plants import JointReading
from ..recording.run import Run
from ..recording.run_recorder import RunRecorder
from ..recording.verdict import Verdict
from ..setup.assembly import Assembly, assemble

if TYPE_CHECKING:
    from .ideal_run_termination import IdealRunTermination

# time added to the experiment's duration for the exposure of one more image, ns
FINAL_NS = 50_000_000
FIRST_IMAGE_TIMEOUT_NS = 5 * NANOSECONDS
OCCLUSION_NOTE = (
    "at the end the arm hides {:.0f} % of the target: on plant chain the arm is transparent, on "
    "plant bullet it is not"
)
STUCK_OUTCOME = "joints_do_not_follow"
COLLISION_REMEDY = (
    "start in another posture, or choose start and goal so that the arm stays clear of {}"
)
VIBRATION_NOTE = "camera '{}' shakes {}; verdict and camera path do not contain this vibration"
log = logging.getLogger(__name__)


def run(
    experiment: Experiment | Mapping[str, Any] | str | Path | None = None,
    progress: bool | Callable[[float], None] = False,
) -> Run:
    """Run an experiment from its start to its end.

    Time is simulated. Therefore two runs of an experiment with the same seed give bit-identical
    results.

    Args:
        experiment: an Experiment, a mapping of its keys, or the path of its YAML file; None: the
            default experiment.
        progress: True shows a progress bar on the standard error; a function is called after each
            image with the finished fraction of the experiment's duration, 0 to 1.

    Returns:
        Record of the run: time series; `outcome`, which the loop reports; and `verdict`, which
        compares the true camera pose with the desired one.

    Raises:
        ExperimentError: the experiment cannot be run; the message names the wrong key and the
            remedy. Failures during the run are outcomes, not errors.
    """
    experiment = Experiment.load(experiment)
    if progress is True:
        from ..progress_bar import ProgressBar

        bar, task = ProgressBar(sys.stderr), f"of {experiment.duration:g} s"
        try:
            return run(experiment, lambda fraction: bar.show(fraction, task))
        finally:
            bar.close()
    result = _run_once(experiment, progress or None)
    release_freed_memory()
    return result


def _run_once(experiment: Experiment, progress: Callable[[float], None] | None) -> Run:
    """Run an experiment and return its record.

    This is a separate function so that loop and plant are freed when it returns.
    """
    loop = Loop(experiment, assemble(experiment), records_films=experiment.has_images)
    try:
        loop.run_to_end(progress)
        return loop.make_run()
    finally:
        loop.close()


class Loop:
    """Run of an experiment that can be advanced image by image.

    `run_to_image` continues to the next image, `run_to_end` continues to the end, and `make_run`
    returns the record of the run up to the current time. Call `close` at the end.

    Attributes:
        experiment: settings of the run.
        parts: objects that make up the run.
        plant: simulated arm or free camera.
        servo: control loop.
        reading: last image of the control camera; None before the first image.
        state: state of the loop after the last processed image; None before the first image.
    """

    def __init__(
        self, experiment: Experiment, parts: Assembly, records_films: bool = False,
        on_frame: Callable[[Loop, Frame], None] | None = None,
        on_joint_state: Callable[[Loop, JointReading], None] | None = None,
    ) -> None:
        """Prepare the run.

        Args:
            experiment: settings of the run.
            parts: objects that make up the run, from `assemble`.
            records_films: whether to record the images of all cameras, not only of the control
                camera.
            on_frame: function that is called with this Loop and a frame when any camera exposes a
                frame.
            on_joint_state: function that is called with this Loop and each joint state, before the
                loop processes it; with it, no joint states are processed in compiled code.
        """
        self.experiment, self.parts = experiment, parts
        self.plant, self.servo = parts.plant, parts.servo
        self._control_name = parts.rig.control.name
        self.reading: Frame | None = None
        self.state: ServoState | None = None
        self._recorder = RunRecorder(len(self.plant.joint_names), records_films)
        self.servo.on_record = self._recorder.records.append
        self._has_free_camera = "twist" in self.plant.outputs
        self._termination: IdealRunTermination | None = None
        if self._has_free_camera:
            from .ideal_run_termination import IdealRunTermination

            self._termination = IdealRunTermination(experiment, parts)
        # The wall clock is the function `float`, which returns 0.0, so the time of computations
        # does not count as a delay.
        self._driver = LoopRunner(
            parts.servo, parts.rig, parts.settings, self,
            clock=lambda: to_seconds(self.plant.time_ns), wall_clock=float,
        )  # fmt: skip
        self._on_frame, self._on_joint_state = on_frame, on_joint_state
        self._has_new_state = False
        # Heap of frames that have not arrived at the loop: (time of arrival (ns), serial number,
        # frame).
        self._pending: list[tuple[int, int, Frame]] = []
        self._delayed_count = 0
        self._delays_ns = {
            name: round(camera.delay * NANOSECONDS) for name, camera in parts.cameras.items()
        }
        self._start_ns: int | None = None
        self._convergence_ns: int | None = None
        self._update_end()
        self._collision: tuple[str, str] | None = None
        if on_joint_state is None:
            self.plant.attach_loop(self._driver, self._recorder, lambda: self._end_ns)

    def send(self, command: JointCommand) -> None:
        """Send a command to the joints of the plant.

        The plant 'ideal' has no joints; `report` sends it the camera twist instead.
        """
        if command.values is not None and not self._has_free_camera:
            self.plant.command(command.kind, command.values)
            self._recorder.on_command(command.values)

    def report(self, state: ServoState) -> None:
        """Record the state of the loop after an image; ignore states without a new image."""
        if not state.has_processed_image:
            return
        self._has_new_state = True
        if (state.phase == CONVERGED) != (self._convergence_ns is not None):
            self._convergence_ns = self.plant.time_ns if state.phase == CONVERGED else None
            self._update_end()
        self.state = state
        if state.outcome == STUCK_OUTCOME and self._collision is None:
            self._collision = self.plant.find_collision()
        self._recorder.add_state(state, self.plant.read_pose())
        if self._termination is not None:
            self._termination.add_image(state, self.plant.read_pose())
            self.plant.command("twist", state.achieved_twist)

    def log(self, text: str) -> None:
        """Log a message of the loop."""
        log.info("%s", text)

    @property
    def records(self) -> tuple[Record, ...]:
        """Records of the run up to now, as input of `diagnose(servo.diagnosis.run, records)`."""
        return tuple(self._recorder.records)

    @property
    def servo_time(self) -> float:
        """Time since the first image, s; 0 before it."""
        if self._start_ns is None:
            return 0.0
        return (self.plant.time_ns - self._start_ns) / NANOSECONDS

    @property
    def is_over(self) -> bool:
        """True after the end of the run."""
        if self._termination is not None and self._termination.is_over:
            return True
        return self.plant.time_ns > self._end_ns

    def _update_end(self) -> None:
        """Compute the expected end of the run, ns; it becomes earlier if the loop converges."""
        time_after_convergence = self.experiment.time_after_convergence
        if self._start_ns is None:
            self._end_ns = FIRST_IMAGE_TIMEOUT_NS - 1
            return
        # The loop detects the end of the duration at the next image, so one more image is exposed.
        self._end_ns = self._start_ns + self.experiment.duration * NANOSECONDS + FINAL_NS
        if not (time_after_convergence is None or self._convergence_ns is None
                or self._has_free_camera):
            end_ns = self._convergence_ns + time_after_convergence * NANOSECONDS
            self._end_ns = min(self._end_ns, np.nextafter(end_ns, 0.0))

    def run_to_end(self, progress: Callable[[float], None] | None = None) -> None:
        """Continue to the end of the run.

        progress: called after each image with the finished fraction of the duration, 0 to 1.
        """
        while not self.is_over:
            self.run_to_image()
            if progress is not None:
                fraction = min(self.servo_time / self.experiment.duration, 1.0)
                progress(1.0 if self.is_over else fraction)

    def run_to_image(self) -> ServoState | None:
        """Continue until the loop has processed an image.

        Returns:
            The state of the loop after the image; None if the run ends before the next image.
        """
        plant, pending = self.plant, self._pending
        self._has_new_state = False
        while not (self._has_new_state or self.is_over):
            until_ns = plant.time_ns + NANOSECONDS
            if pending:
                until_ns = min(until_ns, pending[0][0])
            for reading in plant.advance(until_ns):
                if not isinstance(reading, JointReading):
                    self._add_frame(reading)
                    continue
                if self._on_joint_state is not None:
                    self._on_joint_state(self, reading)
                stamp = reading.stamp
                self._driver.add_joint_state(
                    reading.names, reading.positions, reading.velocities, stamp
                )
                self._recorder.on_joints(stamp, *reading.select(plant.joint_names))
            while pending and pending[0][0] <= plant.time_ns:
                self._deliver(heapq.heappop(pending)[2])
        return self.state if self._has_new_state else None

    def _add_frame(self, frame: Frame) -> None:
        """Record an exposed frame, even if the loop does not read its camera, and deliver it."""
        if self._on_frame is not None:
            self._on_frame(self, frame)
        if frame.name != self._control_name:
            model = self.parts.cameras[frame.name].true_camera
            pose = self.parts.placements[frame.name].compute_pose(self.plant.read_rest_pose())
            pose = self.plant.apply_vibration(pose, frame.stamp_ns, frame.name)
            self._recorder.add_image(frame, pose, model)
        elif self._start_ns is None:
            self._start_ns = frame.stamp_ns
            self._update_end()
        if frame.name not in self.parts.rig.observers:
            return
        if delay_ns := self._delays_ns[frame.name]:
            # the increasing number keeps frames that arrive at the same time in their order
            self._delayed_count += 1
            arrival = frame.stamp_ns + delay_ns, self._delayed_count, frame
            heapq.heappush(self._pending, arrival)
        else:
            self._deliver(frame)

    def _deliver(self, frame: Frame) -> None:
        """Pass a frame to the loop."""
        if frame.name == self._control_name:
            self.reading = frame
        self._driver.add_image(frame.stamp, partial(self.parts.observe, frame), frame.name)

    def compute_goal_pose(self) -> np.ndarray:
        """Compute the current desired world_T_camera (4, 4); it moves with the target."""
        target = self.parts.target
        motion = target.world_T_target(self.plant.time_ns / NANOSECONDS) @ inverse(
            target.world_T_target(0.0)
        )
        return motion @ self.parts.goal_pose

    def compute_verdict(self) -> Verdict:
        """Compute the verdict by comparing the true camera pose, without vibration, with the goal.
        """
        offset = self.parts.cameras[self._control_name].spec.calibration_offset
        depth = self.parts.goal.distance / offset.depth
        return Verdict.compare(
            self.compute_goal_pose(), self.plant.read_rest_pose(), depth, self.experiment.reached
        )

    def make_run(self) -> Run:
        """Return the record of the run up to the current time."""
        if self.is_over and self.servo.outcome.kind == "running":
            # The loop detects the end of the duration only at an image with a measurement. If the
            # last images have no measurement, but are too few for the outcome 'target lost', the
            # end is reported here.
            self.servo.time_out(self.experiment.duration)
        outcome = self.servo.outcome
        if self._termination is not None:
            outcome = self._termination.decide_outcome(outcome)
        if outcome.kind == STUCK_OUTCOME and self._collision is not None:
            link, other = self._collision
            reason = f"{outcome.reason}: link '{link}' is in collision with '{other}'"
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
                VIBRATION_NOTE.format(name, vibration.shake)
                for name, vibration in self.plant.vibrations.items()
            ],
        )  # fmt: skip
        if self.experiment.plant == "chain" and run.converged:
            hidden = self.parts.postures.compute_occlusion(
                self.plant.read_joints()[0], self.plant.time_ns / NANOSECONDS
            )
            if hidden:
                run.notes.append(OCCLUSION_NOTE.format(100.0 * hidden))
                log_once(run.notes[-1])
        return run

    def close(self) -> None:
        """Release the resources of the plant, the simulated arm or camera."""
        self.plant.close()
