"""When a run of the ideal plant is over, as protocols of papers say it: some go by the truth."""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.poses import inverse, pose_difference
from aras_visual_servo_controller.records.outcomes import Outcome, outcome
from aras_visual_servo_controller.records.state import CONVERGED, ServoState

from ..asked.experiment import Experiment
from ..setup.assembly import Assembly

BLIND = 5  # images without a measurement after which none will come: the camera stands
# Times the first and the last distance at which a run that does not end well has retreated.
RETREAT = 3.0


class Ending:
    """Follows a run of the ideal camera image by image.

    Attributes:
        over: whether it has ended. outcome: where the loop's own is not the last word, else None.
    """

    def __init__(self, experiment: Experiment, parts: Assembly) -> None:
        self._ideal, self._duration = experiment.ideal, experiment.duration
        self._linger = experiment.linger if experiment.ideal.stop is None else None
        self._period = 1.0 / parts.plant.sight.rate
        self._converged = None
        self._goal_pose, self._target = parts.goal_pose, parts.target
        first = parts.plant.pose()
        self._first = pose_difference(self._goal_pose, first)
        self._nearest = max(self._depth(first, 0.0), self._depth(self._goal_pose, 0.0))
        self._farthest, self._blind = 0.0, 0
        self.over, self.outcome = False, None

    def image(self, state: ServoState, pose: np.ndarray) -> None:
        """Take in the answer to an image, at the true world_T_camera (4, 4)."""
        decision = state.decision
        time = round(state.stamp / self._period) * self._period  # images may be lost
        self._blind = self._blind + 1 if decision is None else 0
        if state.phase != CONVERGED:
            self._converged = None
        elif self._converged is None:
            self._converged = time
        lingered = None not in (self._linger, self._converged) and (
            time - self._converged >= self._linger
        )
        self._farthest = max(self._farthest, self._depth(pose, state.stamp))
        found = self._by_truth(pose)
        if state.outcome == "scheme_fault" or self._blind >= BLIND:
            found = None
            if state.outcome == "running":
                found = outcome("target_lost", f"no measurement any more: {state.reason}")
        elif (
            self._ideal.stop is not None
            and decision is not None
            and (decision.error**2).sum() < self._ideal.stop
        ):
            found = Outcome("converged")
        elif lingered:
            found = None
        elif found is None and time < self._duration:
            return
        self.over, self.outcome = True, found

    def last_word(self, found: Outcome) -> Outcome:
        """What the run came to, where the loop, or this ending, has found an outcome."""
        found = self.outcome or found
        if found.kind.startswith("converged") or self._farthest < RETREAT * self._nearest:
            return found
        return outcome(
            "camera_retreat", f"the camera went back to {self._farthest:.2f} m from its target"
        )

    def _by_truth(self, pose: np.ndarray) -> Outcome | None:
        """The end by the true pose, where the experiment wants it."""
        enough, farthest = self._ideal.enough, self._ideal.farthest
        if enough is None and farthest is None:
            return None
        way = pose_difference(self._goal_pose, pose)
        if enough is not None and all(
            now <= enough * first for now, first in zip(way, self._first, strict=True)
        ):
            return Outcome("converged")
        if farthest is not None and way[0] > farthest * self._first[0]:
            return outcome(
                "no_progress", f"the camera is {way[0]:.2f} m from its goal, more than at its start"
            )
        return None

    def _depth(self, pose: np.ndarray, time: float) -> float:
        """Of the target's origin along the optical axis, m."""
        return float((inverse(pose) @ self._target.world_T_target(time))[2, 3])
