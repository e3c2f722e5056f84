"""The ideal plant: a camera that flies as the scheme's twist says, one exact motion an image.

What papers and tutorials compute: no arm, no resolver, no delay; the twist of one image moves the
camera by its exponential until the next. The target's plane is known as it is (times the believed
depth). Scheme, law, goal, diagnosis and observations are those of every other run.
"""

from __future__ import annotations

import contextlib
from dataclasses import replace

import numpy as np

from aras_visual_servo_base.poses import exponential, inverse, pose_difference, relative, transform
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_controller.errors import MeasurementError, ServoError
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.judging.arrival import NOT_ARRIVED, Arrival
from aras_visual_servo_controller.judging.diagnosis import Diagnosis
from aras_visual_servo_controller.judging.outcomes import Outcome, outcome
from aras_visual_servo_controller.loop.state import (
    CONVERGED,
    HOLDING,
    SERVOING,
    ServoSettings,
    ServoState,
)
from aras_visual_servo_controller.schemes import Decision, JointController
from aras_visual_servo_controller.schemes.answer_checks import checked_decision, guarded
from aras_visual_servo_controller.seeing.observation import Need, Observation

from ..asked.assembly import Assembly
from ..asked.cameras import in_view
from ..asked.experiment import Experiment
from ..errors import ExperimentError, ViewError
from ..plants.kinematic import FreeCamera
from ..recording.from_loop import Recorder
from ..recording.run import Run, Verdict

NS = 1_000_000_000
PATIENCE = 5  # images without a measurement after which nothing new will come: the camera stands
# Times the first and the last distance at which a run that does not end well has retreated.
RETREAT = 3.0
OUTLINED = frozenset((Need.MOMENTS, Need.CONTOUR))
NONE = np.zeros(0)


def fly(experiment: Experiment, parts: Assembly) -> Run:
    """Run an experiment of the ideal plant from its start to its end.

    Raises:
        ExperimentError: its scheme answers joints, of which there are none.
    """
    flight = Flight(experiment, parts)
    while flight.outcome is None:
        flight.step()
    return flight.result()


class _NoNoise:
    """Draws nothing but the mean."""

    @staticmethod
    def normal(mean: float, deviation: float, shape: tuple[int, ...]) -> np.ndarray:
        """As numpy's Generator."""
        return np.full(shape, mean)


class Flight:
    """A flight under way.

    Attributes:
        pose: world_T_camera (4, 4) now. time: s. outcome: None until it is over.
    """

    def __init__(self, experiment: Experiment, parts: Assembly) -> None:
        self.experiment, self.parts = experiment, parts
        self.scheme, self.goal = parts.servo.scheme, parts.goal
        if isinstance(self.scheme, JointController):
            raise ExperimentError(
                f"scheme '{experiment.scheme}' answers joints, the ideal camera has none: "
                "use plant bullet, chain or free"
            )
        plant: FreeCamera = parts.plant
        self.pose, self.time, self.outcome = plant.pose(), 0.0, None
        self._sight, self._period = plant.sight, 1.0 / plant.sight.rate
        self._random = np.random.default_rng(experiment.seed)
        believed = experiment.believed
        self._true_T_believed = transform(believed.xyz, believed.rpy)
        self._settings = ServoSettings(hold=parts.settings.hold)
        self._arrival = Arrival(parts.settings.hold)
        self._diagnosis = Diagnosis(self._settings)
        self._recorder = Recorder(0)
        self._poses: list[np.ndarray] = []
        self._images, self._blind = 0, 0
        self._converged_at: float | None = None
        self._depth = [self._distance()]
        self._first = pose_difference(parts.goal_pose, self.pose)
        if parts.camera != plant.sight.camera:
            self.goal = self._shown()
        self.scheme.reset()

    def _shown(self) -> Goal:
        """The goal as it is taught by showing: through the camera as it is believed."""
        start, self.pose = self.pose, self.parts.goal_pose
        random, self._random = self._random, _NoNoise()
        try:
            goal = Goal.teach(
                self.scheme, self._observed(), self.goal.name, self.parts.goal.depth
            )
            self.scheme.check(goal)
        except ServoError as error:
            raise ExperimentError(str(error)) from error
        finally:
            self.pose, self._random = start, random
            self.parts.observer.reset()
        return goal

    # -- one image -------------------------------------------------------------------------

    def step(self) -> None:
        """See, decide, move."""
        self.time = self._images * self._period
        self._images += 1
        decision, phase, reason, faulty = None, HOLDING, "", False
        arrived = NOT_ARRIVED
        observation = self._observed()
        try:
            decision = guarded(
                self.experiment.scheme, self.scheme.compute, observation, self.goal, self.time
            )
            decision = checked_decision(self.experiment.scheme, decision, self.scheme)
            phase = SERVOING
        except MeasurementError as error:
            reason = str(error)
        except (ServoError, ValueError, ArithmeticError, np.linalg.LinAlgError) as error:
            reason, faulty = str(error), True
        if decision is not None:
            arrived = self._arrival.add(decision, observation, self.goal, self.scheme)
            if arrived.reached:
                phase = CONVERGED
            reason = arrived.short
        else:
            self._arrival.clear()
        state = ServoState(
            self.time, phase, reason=reason, decision=decision, answers_image=True, arrived=arrived
        )
        found = self._diagnosis.see(state, observation, self.goal, self.scheme, faulty)
        state = replace(state, outcome=found.kind, mend=found.mend)
        self._recorder.image(state, self.pose)
        self._recorder.joints(self.time, (NONE, NONE), (NONE, NONE))
        self._poses.append(self.pose)
        self._end(decision, phase, found, faulty)
        if self.outcome is None and decision is not None:
            self._move(decision.task.twist)

    def _observed(self) -> Observation:
        experiment, parts = self.experiment, self.parts
        if experiment.pictures:
            try:
                reading = self._sight.look(self.pose, round(self.time * NS), self._random)
            except ViewError:  # the camera has flown into the target's plane: nothing is seen
                return parts.observer.of_exact(self.time, parts.camera, world_T_camera=self.pose)
            return parts.observer.of_image(
                self.time, reading.picture, parts.camera, depth=reading.depth,
                plane=self._plane(), world_T_camera=self.pose,
            )  # fmt: skip
        target = parts.target.shape
        seen_from = parts.target.seen_from(self.pose, self.time)
        outline = points = plane = None
        with contextlib.suppress(ViewError):
            rim, known = target.outline(seen_from), target.points(seen_from)
            if experiment.ideal.unbounded or in_view(rim, self._sight.camera, 0.0):
                points = None if known is None else self._blurred(known)
                outline = self._blurred(rim) if parts.needs & OUTLINED else None
                plane = self._plane()
        return parts.observer.of_exact(
            self.time, parts.camera, world_T_camera=self.pose, contour=outline, points=points,
            plane=plane,
        )  # fmt: skip

    def _blurred(self, points: np.ndarray) -> np.ndarray:
        """Normalised points (n, 2) as the believed camera takes them, with the jitter's noise."""
        camera, believed, jitter = self._sight.camera, self.parts.camera, self.experiment.jitter
        if camera == believed and not jitter:
            return points
        pixels = np.stack(camera.project(*points.T), axis=1)
        if jitter:
            pixels = pixels + self._random.normal(0.0, jitter, pixels.shape)
        x, y, _ = believed.normalise(*pixels.T)
        return np.stack([x, y], axis=1)

    def _plane(self) -> Plane:
        """The target's plane, as believed."""
        seen_from = self.parts.target.seen_from(self.pose, self.time)
        factor = self.experiment.believed.depth
        return Plane(*(part / factor for part in self.parts.target.shape.plane(seen_from)))

    def _move(self, twist: np.ndarray) -> None:
        """Fly with a twist (6,) of the believed camera until the next image."""
        speed = self.experiment.ideal.speed
        if speed is not None:
            greatest = np.repeat(speed, 3)
            twist = twist / max(1.0, float((np.abs(twist) / greatest).max()))
        motion = exponential(twist * self._period)
        moved = self._true_T_believed
        self.pose = self.pose @ moved @ motion @ inverse(moved)
        self._depth.append(self._distance())

    # -- the end ---------------------------------------------------------------------------

    def _end(
        self, decision: Decision | None, phase: str, found: Outcome, faulty: bool
    ) -> None:
        """Whether this image was the last."""
        stop, linger = self.experiment.ideal.stop, self.experiment.linger
        self._blind = self._blind + 1 if decision is None else 0
        if faulty or self._blind >= PATIENCE:
            self.outcome = found if found.kind != "running" else outcome(
                "target_lost", f"no measurement any more: {found.reason}"
            )  # fmt: skip
        elif stop is not None and decision is not None and (decision.error**2).sum() < stop:
            self.outcome = Outcome("converged")
        elif stop is None and phase == CONVERGED and linger is not None:
            if self._converged_at is None:
                self._converged_at = self.time
            if self.time - self._converged_at >= linger:
                self.outcome = found
        else:
            self._converged_at = None
        if self.outcome is None:
            self.outcome = self._far_or_near()
        if self.outcome is None and self.time >= self.experiment.duration:
            self._diagnosis.timed_out(self.experiment.duration)
            self.outcome = self._diagnosis.outcome
        if self.outcome is not None and not self.outcome.kind.startswith("converged"):
            self.outcome = self._retreated() or self.outcome

    def _far_or_near(self) -> Outcome | None:
        """The end by the true pose, where the experiment wants it."""
        ideal = self.experiment.ideal
        if ideal.enough is None and ideal.farthest is None:
            return None
        way = pose_difference(self.parts.goal_pose, self.pose)
        if ideal.enough is not None and all(
            now <= ideal.enough * first for now, first in zip(way, self._first, strict=True)
        ):
            return Outcome("converged")
        if ideal.farthest is not None and way[0] > ideal.farthest * self._first[0]:
            return outcome(
                "no_progress", f"the camera is {way[0]:.2f} m from its goal, more than at its start"
            )  # fmt: skip
        return None

    def _retreated(self) -> Outcome | None:
        goal = self._distance(self.parts.goal_pose)
        farthest = max(self._depth)
        if farthest < RETREAT * max(self._depth[0], goal):
            return None
        return outcome(
            "camera_retreat", f"the camera went back to {farthest:.2f} m from its target"
        )  # fmt: skip

    def _distance(self, pose: np.ndarray | None = None) -> float:
        """Of the target's origin along the optical axis, m."""
        seen = relative(
            self.pose if pose is None else pose, self.parts.target.world_T_target(self.time)
        )
        return float(seen[2, 3])

    def poses(self, positions: np.ndarray) -> np.ndarray:
        """World_T_camera (n, 4, 4) of every image: as a plant's, whose joints this one has not."""
        return np.array(self._poses)

    def result(self) -> Run:
        """What the flight has come to."""
        target = self.parts.target
        moved = target.world_T_target(self.time) @ inverse(target.world_T_target(0.0))
        goal_pose = moved @ self.parts.goal_pose
        return self._recorder.run(
            self, self.experiment, self.parts,
            goal_pose=goal_pose,
            joint_names=(),
            outcome=self.outcome.kind,
            reason=self.outcome.reason,
            mend=self.outcome.mend,
            verdict=Verdict.of(goal_pose, self.pose, self.experiment.reached),
        )  # fmt: skip
