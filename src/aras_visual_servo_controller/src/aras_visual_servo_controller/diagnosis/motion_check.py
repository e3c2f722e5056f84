"""What the steps of the features from image to image say of the scheme and of the camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..goals.goal import Goal
from ..observation.observation import Observation
from ..schemes.base import SchemeOutput
from .joint_check import join_names
from .step_check import StepCheck
from .target_check import TargetCheck, compute_centre

# Correlation of the features' motion with L and the camera's from which on they go together, and
# below which a feature moves against its L. Times as far as L says that features move whose motion
# is compared so: a target moves them farther, or not at all where it is followed. Times as far as
# they move where L is wrong.
MIN_CORRELATION, OPPOSING_CORRELATION, MAX_MOTION_RATIO, MIN_MOTION_RATIO = 0.5, -0.7, 2.0, 0.2
SCATTER_FACTOR = 50.0  # times as much as the target's centre that features change without a cause
# tolerances of its rows: a camera that goes astray loses its target within 0.2 s
CENTRE_MIN_ROW = 3.0
SURE_CORRELATION = 0.8  # the correlation of the target's centre with the camera of which it is sure


class MotionCheck:
    """Follows the features' steps, and for a user's own scheme those of the target's centre, whose
    L is known: where that moves as the camera says, a contradiction is the scheme's fault.

    Attributes:
        steps: of the features. is_own: whether the scheme is a user's own.
        is_viewed: whether the scheme's L is that of the present view, from which the camera's
            motion can be predicted; L at the goal, a mean or an estimate is not.
    """

    def __init__(self, is_user_scheme: bool = False) -> None:
        self.step_check, self.is_user_scheme, self.is_current_interaction = (
            StepCheck(),
            is_user_scheme,
            True,
        )
        self._centre_check = StepCheck(CENTRE_MIN_ROW) if is_user_scheme else None

    def interrupt(self) -> None:
        """An image without measurement: the next one has no predecessor."""
        self.step_check.interrupt()
        if self._centre_check is not None:
            self._centre_check.interrupt()

    def add(
        self,
        scheme_output: SchemeOutput,
        observation: Observation,
        goal: Goal,
        tolerances: np.ndarray,
        is_angle: np.ndarray,
    ) -> None:
        """Take in one image; angles: (k,) bool, of components that may wrap."""
        self.step_check.add(scheme_output, observation, tolerances, is_angle)
        if self._centre_check is not None:
            self._add_centre(scheme_output, observation, goal)

    @property
    def target_motion_part(self) -> float:
        """Part of the latest motion in the image that is the target's own: see StepCheck.own. None
        is known where L, as that at the goal, is not that of this view."""
        if not self.is_current_interaction:
            return 0.0
        return (
            self.step_check if self._centre_check is None else self._centre_check
        ).target_motion_part

    def find_scheme_fault(self, stamp: float, is_converged: bool) -> str:
        """What the scheme does that no image can, as text; empty: nothing."""
        centre, steps = self._centre_check, self.step_check
        if steps.unchanged_since is not None and not is_converged:
            return (
                f"the scheme's features have been the same since {steps.unchanged_since:.2f} s, "
                "though the camera moves and the target in the image with it"
            )
        if self.is_interaction_wrong and (names := self._list_opposing_features()):
            return f"{names} moves against what the scheme's L says; is the sign of L right?"
        if not is_converged and centre is not None:
            if steps.is_jumping(stamp):
                return f"the features jump again and again, the target does not: {self.jump_reason}"
            if centre.has_enough_motion and steps.typical_step > max(
                steps.MIN_JUMP, SCATTER_FACTOR * centre.typical_step
            ):
                return (
                    f"the features change by {steps.typical_step:.0f} tolerances from image to "
                    "image that "
                    "the camera's motion does not explain, and the target's centre does not"
                )
        return ""

    def _add_centre(
        self, scheme_output: SchemeOutput, observation: Observation, goal: Goal
    ) -> None:
        """Follow the target's own centre, whose L is known, next to a user's own features."""
        centre, L, _ = compute_centre(observation, goal)
        count = len(centre)
        own = replace(
            scheme_output, names=("x", "y")[:count], features=centre, desired=centre, error=centre,
            L=L,
            error_drift=0.0,
        )  # fmt: skip
        self._centre_check.add(
            own, observation, np.full(count, TargetCheck.CENTRE_TOLERANCE), np.zeros(count, bool)
        )

    @property
    def is_interaction_wrong(self) -> bool:
        """Whether the target's centre moves as the camera says, so that a contradiction of a
        user's own features is their L's fault."""
        centre = self._centre_check
        return (
            centre is not None
            and centre.has_enough_motion
            and centre.correlation > SURE_CORRELATION
        )

    @property
    def jump_reason(self) -> str:
        """The first jump of the error, as text; empty: there was none."""
        jump = self.step_check.first_jump
        return "" if jump is None else str(jump)

    def find_contradiction(self, is_target_moving: bool) -> str:
        """How the features moved otherwise than L says all along, as text; empty: they did not.

        moves: whether the target does, so that a single feature may go against L.
        """
        steps, words = (
            self.step_check,
            "the features move otherwise than L and the arm's motion say",
        )
        if not (steps.has_enough_motion and self.is_current_interaction):
            return ""
        if (
            1.0 / MAX_MOTION_RATIO < steps.motion_ratio < MAX_MOTION_RATIO
            and steps.correlation < MIN_CORRELATION
        ):
            return f"{words}: their correlation is {steps.correlation:.2f}"
        against = steps.correlation < MIN_CORRELATION and steps.motion_ratio < MAX_MOTION_RATIO
        if not is_target_moving and against and (names := self._list_opposing_features()):
            return f"{words}: {names} against it"
        if self.is_interaction_wrong and steps.motion_ratio < MIN_MOTION_RATIO:
            return f"{words}: {steps.motion_ratio:.2g} times as far"
        return ""

    def _list_opposing_features(self) -> str:
        """Names of the features that move against L, as text."""
        parts = self.step_check.feature_correlations
        if parts is None or not (parts < OPPOSING_CORRELATION).any():
            return ""
        return join_names([n for n, part in zip(self.step_check.names, parts, strict=True)
                       if part < OPPOSING_CORRELATION])  # fmt: skip
