"""End of a run on the plant 'ideal', a free camera, by criteria that publications use."""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.poses import inverse, pose_difference
from aras_visual_servo_controller.records.outcomes import Outcome, make_outcome
from aras_visual_servo_controller.records.state import CONVERGED, ServoState

from ..experiment.experiment import Experiment
from ..setup.assembly import Assembly

# Number of successive images without a measurement after which the target counts as lost. Without a
# measurement the camera does not move, so later images would not show the target, either.
MAX_BLIND_IMAGES = 5
# The outcome of a failed run is a camera retreat if the depth of the target exceeded this multiple
# of both its initial and its desired value.
MAX_RETREAT = 3.0


class IdealRunTermination:
    """Decides when a run of the ideal camera ends, and with which outcome.

    Attributes:
        is_over: whether the run has ended.
        outcome: outcome that this class has decided; None: the outcome is that of the loop.
    """

    def __init__(self, experiment: Experiment, parts: Assembly) -> None:
        self._ideal, self._duration = experiment.ideal, experiment.duration
        self._time_after_convergence = (
            experiment.time_after_convergence if experiment.ideal.stop is None else None
        )
        self._period = 1.0 / parts.plant.imaging.rate
        self._convergence_time = None
        self._goal_pose, self._target = parts.goal_pose, parts.target
        first = parts.plant.read_pose()
        self._initial_error = pose_difference(self._goal_pose, first)
        self._min_depth = max(
            self._compute_depth(first, 0.0), self._compute_depth(self._goal_pose, 0.0)
        )
        self._max_depth, self._blind_images = 0.0, 0
        self.is_over, self.outcome = False, None

    def add_image(self, state: ServoState, pose: np.ndarray) -> None:
        """Add the state of the loop after an image, and decide whether the run has ended.

        pose: true world_T_camera (4, 4) of the control camera."""
        output = state.scheme_output
        # The stamp is rounded to a whole number of image periods. Counting the images instead would
        # be wrong if images are dropped.
        time = round(state.stamp / self._period) * self._period
        self._blind_images = self._blind_images + 1 if output is None else 0
        if state.phase != CONVERGED:
            self._convergence_time = None
        elif self._convergence_time is None:
            self._convergence_time = time
        is_settled = None not in (self._time_after_convergence, self._convergence_time) and (
            time - self._convergence_time >= self._time_after_convergence
        )
        self._max_depth = max(self._max_depth, self._compute_depth(pose, state.stamp))
        outcome = self._check_true_pose(pose)
        if state.outcome == "scheme_fault" or self._blind_images >= MAX_BLIND_IMAGES:
            outcome = None
            if state.outcome == "running":
                outcome = make_outcome("target_lost", f"no measurement any more: {state.reason}")
        elif (
            self._ideal.stop is not None
            and output is not None
            and (output.error**2).sum() < self._ideal.stop
        ):
            outcome = Outcome("converged")
        elif is_settled:
            outcome = None
        elif outcome is None and time < self._duration:
            return
        self.is_over, self.outcome = True, outcome

    def decide_outcome(self, loop_outcome: Outcome) -> Outcome:
        """Return the outcome of the run.

        An outcome that this class has decided replaces the outcome of the loop. If the run has not
        converged and the camera went far back, the outcome is a camera retreat.
        """
        loop_outcome = self.outcome or loop_outcome
        if (
            loop_outcome.kind.startswith("converged")
            or self._max_depth < MAX_RETREAT * self._min_depth
        ):
            return loop_outcome
        return make_outcome(
            "camera_retreat", f"the camera went back to {self._max_depth:.2f} m from its target"
        )

    def _check_true_pose(self, pose: np.ndarray) -> Outcome | None:
        """Return the outcome from the true pose of the camera; None if the run continues.

        The run has converged if the distance and the angle to the goal are at most `ideal.enough`
        times their initial values. It makes no progress if the distance exceeds `ideal.farthest`
        times its initial value.

        pose: true world_T_camera (4, 4) of the control camera.
        """
        enough, farthest = self._ideal.enough, self._ideal.farthest
        if enough is None and farthest is None:
            return None
        error = pose_difference(self._goal_pose, pose)
        if enough is not None and all(
            now <= enough * first for now, first in zip(error, self._initial_error, strict=True)
        ):
            return Outcome("converged")
        if farthest is not None and error[0] > farthest * self._initial_error[0]:
            return make_outcome(
                "no_progress",
                f"the camera is {error[0]:.2f} m from its goal, more than at its start",
            )
        return None

    def _compute_depth(self, pose: np.ndarray, time: float) -> float:
        """Compute the depth (m) of the target's origin in the camera frame at `time` (s)."""
        return float((inverse(pose) @ self._target.world_T_target(time))[2, 3])
