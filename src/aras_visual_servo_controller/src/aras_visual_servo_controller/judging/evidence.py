"""What the images of a run have shown so far, and what that says of a finding."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..arm.joint_sample import JointSample
from ..records.outcomes import UNCOVERED, Outcome, outcome
from ..records.remedy import Remedy
from ..records.run_record import RunContext
from ..seeing.observation import Observation
from .advice import is_own, other_scheme, wider_limits
from .camera_check import CameraCheck
from .gain_check import GainCheck
from .joint_check import JointCheck, listed
from .motion_check import MotionCheck
from .progress_check import ProgressCheck
from .target_check import TargetCheck

# Bend of an elbow, rad, within which the arm counts as stretched.
STRETCHED = 0.1
# What a scheme or the target, and not the camera, explains: outcomes that follow from it.
FOLLOW = ("camera_retreat", "gain_too_high", "local_minimum", "no_progress", "too_noisy",
          "ambiguous", "target_lost", "singular", "timed_out", "target_moves", "wrong_object",
          "wrong_camera_model")  # fmt: skip
DRIFTS = outcome("target_moves", "the features moved steadily while the camera was at rest")


class Evidence:
    """Shared by the diagnoses of a run, which add each image to it in their order.

    Attributes:
        run: what does not change. present: the outcome that was reported last.
        joints, progress, gain, target, motion: checks, each with the images that it has seen.
        cameras: the check of each camera, by name.
        touched: borders that the target touched last, as text.
        measured: when the scheme could last answer, s; None: never yet.
        is_running_away: whether the target has just moved faster than any camera could.
        error: (k,) of this image, in tolerances. tolerances: (k,).
        angles: (k,) bool, of components that may wrap.
        moves: how the target moves, as text. swings: that the error swings, or None.
        is_fast: whether it swings faster than any target that is looked for.
        camera_fault: what contradicts the cameras as believed, as text.
    """

    error: np.ndarray
    tolerances: np.ndarray
    angles: np.ndarray

    def __init__(self, run: RunContext) -> None:
        self.run = run
        self.present = Outcome()
        self.progress = ProgressCheck(run.settings.duration)
        self.gain = GainCheck(run.settings.duration)
        self.joints = JointCheck(run.names, run.lengths)
        self.target = TargetCheck()
        self.motion = MotionCheck(run.scheme is not None and is_own(run.scheme))
        self.cameras: dict[str, CameraCheck] = {}
        self.touched = ""
        self.measured: float | None = None
        self.is_running_away = False
        self.moves = self.camera_fault = ""
        self.swings: Outcome | None = None
        self.is_fast = False

    def interrupt(self) -> None:
        """An image without an answer: the next one has no predecessor."""
        self.progress.clear()
        self.target.interrupt()
        self.motion.interrupt()
        for check in self.cameras.values():
            check.interrupt()

    @property
    def is_covered(self) -> bool:
        """Whether something covers a part of the target."""
        return self.motion.steps.covered is not None

    def contrary(self) -> str:
        """How the features moved otherwise than L says all along, as text; empty: they did not, or
        noise hides it."""
        return "" if self.progress.noise else self.motion.contrary(self.target.moves)

    def wrong_camera(self, observation: Observation) -> str:
        """What cannot be with the cameras as believed, as text; empty where all can, or where the
        target has just run away faster than any camera of this motion shows."""
        if self.is_running_away:
            return ""
        for name, check in self.cameras.items():
            if fault := check.fault():
                return f"camera {name}: {fault}" if observation.others and name else fault
        return ""

    def mistaken(self, fault: str) -> Outcome:
        """The outcome of features that do not move as L and the camera say."""
        if self.motion.l_is_wrong:
            return outcome(
                "scheme_fault", f"{fault}, and the target's centre moves as they say: L is not "
                "that of the scheme's features",
            )  # fmt: skip
        return self.covered(outcome("wrong_camera_model", fault))

    def covered(self, found: Outcome) -> Outcome:
        """The outcome where something covers the target: of that, if it can follow from it."""
        steps = self.motion.steps
        if steps.covered is None or found.kind not in FOLLOW or self.progress.noise:
            return found
        return outcome(
            "wrong_object", f"since {steps.covered:.2f} s something covers the target, of which "
            f"{100.0 * steps.visible:.0f} % is visible; {found.reason}",
        ).with_remedy(UNCOVERED)

    def advised(self, found: Outcome) -> Outcome:
        """The outcome of a run that does not come to its goal, with what else is known."""
        if found.kind in ("camera_retreat", "local_minimum", "singular"):
            found = replace(found, remedy=other_scheme(found, self.run.scheme))
        if found.kind == "joint_limit":
            if keys := self._narrowed_by(found.reason):
                found = replace(found, remedy=wider_limits(keys))
            slow = self.progress.slowed
            return found if slow is None else both(found, slow)
        if found.kind == "saturation" and self.run.outside:
            return both(found, self._limits_of_goal())
        if found.kind == "gain_too_high":
            drifts = self.motion.steps.drifts and not self.motion.is_own
            return self.covered(both(found, DRIFTS) if drifts else found)
        if found.kind not in FOLLOW:
            return found
        if not self.is_covered and (fault := self.contrary()):
            kind = "scheme_fault" if self.motion.l_is_wrong else "wrong_camera_model"
            return outcome(kind, f"{fault}; {found.reason}")
        jumped = self.motion.jumped
        if jumped and jumped not in found.reason:
            found = replace(found, reason=f"{found.reason}; {jumped}")
        return self.covered(found)

    def is_stretched(self, joints: JointSample | None) -> bool:
        """Whether an elbow is all but straight."""
        return joints is not None and any(
            abs(joints.positions[fold.joint] - fold.straight) < STRETCHED
            for fold in self.run.folds
        )

    def _narrowed_by(self, reason: str) -> list[str]:
        """The parameters that narrow the limits of the joints which a reason names."""
        return sorted({key for key, names in self.run.narrowed.items()
                       if any(name in reason for name in names)})  # fmt: skip

    def _limits_of_goal(self) -> Outcome:
        """That the goal was shown with joints beyond their limits."""
        outside = listed(list(self.run.outside))
        found = outcome("joint_limit", f"the goal was shown with {outside} beyond its limit")
        keys = self._narrowed_by(found.reason)
        return replace(found, remedy=wider_limits(keys)) if keys else found


def both(first: Outcome, second: Outcome) -> Outcome:
    """The first outcome with the reason and the remedy of a second one that fits as well."""
    changes = dict.fromkeys((*first.remedy.changes, *second.remedy.changes))
    return replace(
        first, reason=f"{first.reason}; besides, {second.reason}",
        remedy=Remedy(str(first.remedy).partition(":")[0], *changes),
    )  # fmt: skip
