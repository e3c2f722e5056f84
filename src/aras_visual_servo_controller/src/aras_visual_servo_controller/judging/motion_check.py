"""What the steps of the features from image to image say of the scheme and of the camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..goals.goal import Goal
from ..schemes.base import Decision
from ..seeing.observation import Observation
from .joint_check import listed
from .step_check import StepCheck
from .target_check import TargetCheck, centre_of

# Correlation of the features' motion with L and the camera's from which on they go together, and
# below which a feature moves against its L. Times as far as L says that features move whose motion
# is compared so: a target moves them farther, or not at all where it is followed. Times as far as
# they move where L is wrong.
TOGETHER, AGAINST, FASTER, SLOWER = 0.5, -0.7, 2.0, 0.2
SCATTER = 50.0  # times as much as the target's centre that features change without a cause
CENTRE = 3.0  # tolerances of its rows: a camera that goes astray loses its target within 0.2 s
ALONG = 0.8  # the correlation of the target's centre with the camera of which it is sure


class MotionCheck:
    """Follows the features' steps, and for a user's own scheme those of the target's centre, whose
    L is known: where that moves as the camera says, a contradiction is the scheme's fault.

    Attributes:
        steps: of the features. is_own: whether the scheme is a user's own.
        is_viewed: whether the scheme's L is that of the present view, from which the camera's
            motion can be predicted; L at the goal, a mean or an estimate is not.
    """

    def __init__(self, is_own: bool = False) -> None:
        self.steps, self.is_own, self.is_viewed = StepCheck(), is_own, True
        self._centre = StepCheck(CENTRE) if is_own else None

    def interrupt(self) -> None:
        """An image without measurement: the next one has no predecessor."""
        self.steps.interrupt()
        if self._centre is not None:
            self._centre.interrupt()

    def add(
        self,
        decision: Decision,
        observation: Observation,
        goal: Goal,
        tolerances: np.ndarray,
        angles: np.ndarray,
    ) -> None:
        """Take in one image; angles: (k,) bool, of components that may wrap."""
        self.steps.add(decision, observation, tolerances, angles)
        if self._centre is not None:
            self._follow_centre(decision, observation, goal)

    @property
    def targets_own(self) -> float:
        """Part of the latest motion in the image that is the target's own: see StepCheck.own. None
        is known where L, as that at the goal, is not that of this view."""
        if not self.is_viewed:
            return 0.0
        return (self.steps if self._centre is None else self._centre).own

    def scheme_fault(self, stamp: float, converged: bool) -> str:
        """What the scheme does that no image can, as text; empty: nothing."""
        centre, steps = self._centre, self.steps
        if steps.unchanged is not None and not converged:
            return (
                f"the scheme's features have been the same since {steps.unchanged:.2f} s, "
                "though the camera moves and the target in the image with it"
            )
        if self.l_is_wrong and (names := self._against()):
            return f"{names} moves against what the scheme's L says; is the sign of L right?"
        if not converged and centre is not None:
            if steps.jumping(stamp):
                return f"the features jump again and again, the target does not: {self.jumped}"
            if centre.moved and steps.usual > max(steps.LEAST, SCATTER * centre.usual):
                return (
                    f"the features change by {steps.usual:.0f} tolerances from image to image that "
                    "the camera's motion does not explain, and the target's centre does not"
                )
        return ""

    def _follow_centre(self, decision: Decision, observation: Observation, goal: Goal) -> None:
        """Follow the target's own centre, whose L is known, next to a user's own features."""
        centre, L, _ = centre_of(observation, goal)
        count = len(centre)
        own = replace(
            decision, names=("x", "y")[:count], features=centre, desired=centre, error=centre, L=L,
            rate=0.0,
        )  # fmt: skip
        self._centre.add(
            own, observation, np.full(count, TargetCheck.TOLERANCE), np.zeros(count, bool)
        )

    @property
    def l_is_wrong(self) -> bool:
        """Whether the target's centre moves as the camera says, so that a contradiction of a
        user's own features is their L's fault."""
        centre = self._centre
        return centre is not None and centre.moved and centre.together > ALONG

    @property
    def jumped(self) -> str:
        """The first jump of the error, as text; empty: there was none."""
        jump = self.steps.first_jump
        return "" if jump is None else str(jump)

    def contrary(self, moves: bool) -> str:
        """How the features moved otherwise than L says all along, as text; empty: they did not.

        moves: whether the target does, so that a single feature may go against L.
        """
        steps, words = self.steps, "the features move otherwise than L and the arm's motion say"
        if not (steps.moved and self.is_viewed):
            return ""
        if 1.0 / FASTER < steps.faster < FASTER and steps.together < TOGETHER:
            return f"{words}: their correlation is {steps.together:.2f}"
        against = steps.together < TOGETHER and steps.faster < FASTER
        if not moves and against and (names := self._against()):
            return f"{words}: {names} against it"
        if self.l_is_wrong and steps.faster < SLOWER:
            return f"{words}: {steps.faster:.2g} times as far"
        return ""

    def _against(self) -> str:
        """Names of the features that move against L, as text."""
        parts = self.steps.contrary
        if parts is None or not (parts < AGAINST).any():
            return ""
        return listed([n for n, part in zip(self.steps.names, parts, strict=True)
                       if part < AGAINST])  # fmt: skip
