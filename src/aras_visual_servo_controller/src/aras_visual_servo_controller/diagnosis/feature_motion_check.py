"""Check whether the features move from image to image as L and the camera's motion predict."""

from __future__ import annotations

from ..goals.goal import Goal
from ..observation.observation import Observation
from .area_check import AreaCheck
from .feature_rows import FeatureHistory
from .joint_tracking_check import join_names
from .step_check import MIN_JUMP, StepCheck
from .target_motion_check import TargetMotionCheck, compute_centre

# Smallest correlation of measured and predicted feature motion at which the features agree with L.
MIN_CORRELATION = 0.5
# A feature moves opposite to its prediction by L if the correlation of its measured and predicted
# motion is below this.
OPPOSING_CORRELATION = -0.7
# The correlation of measured and predicted motion is evaluated only if their ratio is between 1 /
# MAX_MOTION_RATIO and MAX_MOTION_RATIO. A moving target causes ratios outside this range: the
# features move farther than predicted, or hardly at all if the camera follows the target.
MAX_MOTION_RATIO = 2.0
# L is wrong if the features move less than this fraction of the motion that L predicts.
MIN_MOTION_RATIO = 0.2
# The scheme is wrong if the unexplained steps of its features exceed those of the target's centre
# by this factor, both in units of the tolerance.
SCATTER_FACTOR = 50.0
# The motion of the target's centre is added up until its prediction reaches this, in units of the
# tolerance; then the measured and the predicted sum are compared. The limit is small, because a
# camera that moves in a wrong direction loses its target within 0.2 s.
CENTRE_MIN_ROW = 3.0
# The scheme's L is wrong if the features contradict the camera's motion, but the measured and
# predicted motion of the target's centre have at least this correlation.
SURE_CORRELATION = 0.8


class FeatureMotionCheck:
    """Check of the steps of the features and, for user schemes, of the target's centre.

    The interaction matrix of the centre is known. If the centre moves as predicted from the
    camera's motion but the features do not, the user's scheme is wrong.

    Attributes:
        step_check: check of the steps of the features.
        target_step_check: check of the steps that show the motion of the target: those of its
            centre for user schemes, otherwise those of the features.
        area_check: check of the target's visible area and centre.
        is_user_scheme: whether the scheme or one of its features is user code.
        is_current_interaction: whether the scheme computes L at the present view, so that L
            predicts the effect of the camera's motion. False for L at the goal, a mean or an
            estimate.
    """

    def __init__(self, goal: Goal | None, is_user_scheme: bool = False) -> None:
        self.step_check, self.area_check = StepCheck(), AreaCheck(goal)
        self.is_user_scheme, self.is_current_interaction = is_user_scheme, True
        self._centre_check = StepCheck(CENTRE_MIN_ROW) if is_user_scheme else None
        self.target_step_check = self._centre_check or self.step_check
        self._centre = FeatureHistory()  # position of the target's centre

    def add_centre(self, observation: Observation) -> None:
        """Add one image to the check of the target's centre."""
        centre, L = compute_centre(observation, self.area_check.goal)
        self._centre.add(observation, centre, L, 0.0, TargetMotionCheck.CENTRE_TOLERANCE, False)
        self._centre_check.add(self._centre, ("x", "y"), observation)

    def find_scheme_fault(self, stamp: float, is_converged: bool) -> str:
        """Describe a change of the features that the images cannot cause.

        Return an empty text if there is no such change.
        """
        centre, steps = self._centre_check, self.step_check
        if steps.unchanged_since is not None and not is_converged:
            return (
                f"the scheme's features have not changed since {steps.unchanged_since:.2f} s, "
                "although camera motion has changed the image of the target"
            )
        if self.is_interaction_wrong and (names := self._list_opposing_features()):
            return f"the scheme's L predicts the opposite motion of {names}; check the sign of L"
        if not is_converged and centre is not None:
            if steps.is_jumping(stamp) and not self.area_check.is_centre_jumping:
                return f"the features jump repeatedly, but the target does not: {self.jump_reason}"
            if centre.has_enough_motion and steps.typical_step > max(
                MIN_JUMP, SCATTER_FACTOR * centre.typical_step
            ):
                return (
                    f"the features change by {steps.typical_step:.0f} tolerances from image to "
                    "image without a motion of the camera or of the target's centre"
                )
        return ""

    @property
    def is_interaction_wrong(self) -> bool:
        """Return whether the features contradict the camera's motion because L is wrong.

        This is the case if the target's centre moves as predicted from the camera's motion.
        """
        centre = self._centre_check
        return (
            centre is not None
            and centre.has_enough_motion
            and centre.correlation > SURE_CORRELATION
        )

    @property
    def jump_reason(self) -> str:
        """Return a text that describes the first jump of the error; empty if there was none."""
        jump = self.step_check.first_jump
        return "" if jump is None else str(jump)

    def find_contradiction(self, is_target_moving: bool) -> str:
        """Describe how the features have contradicted L; empty text if they have not.

        Args:
            is_target_moving: whether the target moves. If it does, single features that move
                opposite to their prediction by L are ignored.
        """
        steps = self.step_check
        text = "the features do not move as L and the arm's motion predict"
        if not (steps.has_enough_motion and self.is_current_interaction):
            return ""
        if (
            1.0 / MAX_MOTION_RATIO < steps.motion_ratio < MAX_MOTION_RATIO
            and steps.correlation < MIN_CORRELATION
        ):
            return f"{text}: their correlation is {steps.correlation:.2f}"
        against = steps.correlation < MIN_CORRELATION and steps.motion_ratio < MAX_MOTION_RATIO
        if not is_target_moving and against and (names := self._list_opposing_features()):
            return f"{text}: the motion of {names} is opposite to the prediction"
        if self.is_interaction_wrong and steps.motion_ratio < MIN_MOTION_RATIO:
            return f"{text}: they move {steps.motion_ratio:.2g} times as far as predicted"
        return ""

    def _list_opposing_features(self) -> str:
        """Return the names of the features that move opposite to their prediction by L, as text."""
        parts = self.step_check.feature_correlations
        return join_names([n for n, part in zip(self.step_check.names, parts, strict=True)
                       if part < OPPOSING_CORRELATION])  # fmt: skip
