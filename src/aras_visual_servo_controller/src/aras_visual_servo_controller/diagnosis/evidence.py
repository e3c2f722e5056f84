"""Evidence collected from the images of a run, shared by all diagnoses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..observation.observation import Observation
from ..records.outcomes import UNCOVER_TARGET, Outcome, make_outcome
from ..records.remedy import Remedy
from ..records.run_record import RunContext
from .advice import is_user_scheme, suggest_scheme, suggest_wider_limits
from .camera_model_check import CameraModelCheck
from .feature_motion_check import FeatureMotionCheck
from .feature_rows import FeatureHistory
from .gain_check import GainCheck
from .joint_tracking_check import JointTrackingCheck, join_names
from .progress_check import ProgressCheck
from .target_motion_check import TargetMotionCheck

# Kinds of outcomes that may be consequences of an occluded target or of a wrong L.
CONSEQUENCES = ("camera_retreat", "gain_too_high", "local_minimum", "no_progress", "too_noisy",
          "ambiguous", "target_lost", "singular", "timed_out", "target_moves", "wrong_object",
          "wrong_camera_model")  # fmt: skip
DRIFT_OUTCOME = make_outcome(
    "target_moves", "the features moved steadily while the camera was at rest"
)


class Evidence:
    """Findings about a run so far; all diagnoses read them and add the latest image to them.

    Attributes:
        run_context: arm, goal, scheme and settings, which do not change during the run.
        current_outcome: outcome that was reported last.
        joint_check, progress_check, gain_check, target_check, motion_check: checks that process the
            images of the run.
        features: features of the latest images.
        camera_checks: check of each camera, by camera name.
        last_touched_borders: image borders that the target touched last, as text.
        measured_stamp: stamp of the last image for which the scheme computed a task, s; None before
            the first.
        is_running_away: whether the target itself must have moved, because the features have just
            moved farther than any camera motion explains.
        error: (k,) error of the latest image, in units of the tolerance.
        target_motion: motion of the target, as text; empty if it is at rest.
        oscillation: outcome for an oscillating error, or None.
        is_oscillation_fast: whether the error oscillates faster than the target motions that
            `TargetMotionCheck` searches for.
        camera_fault: how the features contradict the camera model, as text; empty if they do not.
    """

    error: np.ndarray

    def __init__(self, run_context: RunContext) -> None:
        self.run_context = run_context
        self.current_outcome = Outcome()
        self.features = FeatureHistory()
        self.progress_check = ProgressCheck(run_context.settings.duration)
        self.gain_check = GainCheck(run_context.settings.duration)
        self.joint_check = JointTrackingCheck(run_context.names, run_context.joint_units)
        self.target_check = TargetMotionCheck()
        self.motion_check = FeatureMotionCheck(
            run_context.goal, run_context.scheme is not None and is_user_scheme(run_context.scheme)
        )
        self.camera_checks: dict[str, CameraModelCheck] = {}
        self.last_touched_borders = ""
        self.measured_stamp: float | None = None
        self.is_running_away = False
        self.target_motion = self.camera_fault = ""
        self.oscillation: Outcome | None = None
        self.is_oscillation_fast = False

    @property
    def is_occluded(self) -> bool:
        """Return whether something covers a part of the target."""
        return self.motion_check.area_check.occluded_since is not None

    def find_contradiction(self) -> str:
        """Describe how the features have contradicted L during the run.

        Return an empty text if they agree with L, or if the noise is too large to decide.
        """
        if self.progress_check.noise:
            return ""
        return self.motion_check.find_contradiction(self.target_check.is_moving)

    def find_camera_fault(self, observation: Observation) -> str:
        """Describe how the features contradict the camera model.

        Return an empty text if they do not contradict it. Also return it if the target itself moves
        (`is_running_away`), because this motion would look like a wrong camera model.
        """
        if self.is_running_away:
            return ""
        for name, check in self.camera_checks.items():
            if check.fault is None:
                check.fault = check.find_fault()
            if fault := check.fault:
                return f"camera {name}: {fault}" if observation.other_cameras and name else fault
        return ""

    def explain_contradiction(self, fault: str) -> Outcome:
        """Return the outcome for features that do not move as L and the camera's motion predict."""
        if self.motion_check.is_interaction_wrong:
            return make_outcome(
                "scheme_fault", f"{fault}, although the target's centre moves as predicted: the "
                "scheme's L does not belong to its features",
            )  # fmt: skip
        return self.explain_occlusion(make_outcome("wrong_camera_model", fault))

    def explain_occlusion(self, candidate: Outcome) -> Outcome:
        """Return the outcome for an occluded target if the occlusion can explain `candidate`.

        Otherwise return `candidate`.
        """
        area = self.motion_check.area_check
        if (
            area.occluded_since is None
            or candidate.kind not in CONSEQUENCES
            or self.progress_check.noise
        ):
            return candidate
        return Outcome(
            "wrong_object",
            f"something has covered the target since {area.occluded_since:.2f} s; "
            f"{100.0 * area.visible_part:.0f} % of it is visible; {candidate.reason}",
            UNCOVER_TARGET,
        )

    def add_advice(self, candidate: Outcome) -> Outcome:
        """Add further findings and a specific remedy to the outcome of an unsuccessful run."""
        if candidate.kind in ("camera_retreat", "local_minimum", "singular"):
            candidate = replace(
                candidate, remedy=suggest_scheme(candidate, self.run_context.scheme)
            )
        if candidate.kind == "joint_limit":
            if keys := self._find_narrowing_parameters(candidate.reason):
                candidate = replace(candidate, remedy=suggest_wider_limits(keys))
            slow = self.progress_check.saturation_outcome
            return candidate if slow is None else combine_outcomes(candidate, slow)
        if candidate.kind == "saturation" and self.run_context.joints_beyond_limits:
            return combine_outcomes(candidate, self._report_goal_limits())
        if candidate.kind == "gain_too_high":
            drifts = self.motion_check.step_check.has_drift and not self.motion_check.is_user_scheme
            return self.explain_occlusion(
                combine_outcomes(candidate, DRIFT_OUTCOME) if drifts else candidate
            )
        if candidate.kind not in CONSEQUENCES:
            return candidate
        if not self.is_occluded and (fault := self.find_contradiction()):
            kind = (
                "scheme_fault" if self.motion_check.is_interaction_wrong else "wrong_camera_model"
            )
            return make_outcome(kind, f"{fault}; {candidate.reason}")
        jumped = self.motion_check.jump_reason
        if jumped and jumped not in candidate.reason:
            candidate = replace(candidate, reason=f"{candidate.reason}; {jumped}")
        return self.explain_occlusion(candidate)

    def _find_narrowing_parameters(self, reason: str) -> list[str]:
        """Return the parameters that narrow the limits of joints whose names occur in `reason`."""
        return sorted({key for key, names in self.run_context.narrowed_limits.items()
                       if any(name in reason for name in names)})  # fmt: skip

    def _report_goal_limits(self) -> Outcome:
        """Return the outcome for a goal that was taught with joints beyond their limits."""
        outside = join_names(list(self.run_context.joints_beyond_limits))
        found = make_outcome(
            "joint_limit", f"the goal was taught with joints beyond the limits of {outside}"
        )
        keys = self._find_narrowing_parameters(found.reason)
        return replace(found, remedy=suggest_wider_limits(keys)) if keys else found


def combine_outcomes(first: Outcome, second: Outcome) -> Outcome:
    """Return the first outcome with the reasons and the suggested changes of both."""
    changes = dict.fromkeys((*first.remedy.changes, *second.remedy.changes))
    return replace(
        first, reason=f"{first.reason}; in addition, {second.reason}",
        remedy=Remedy(first.remedy.advice, *changes),
    )  # fmt: skip
