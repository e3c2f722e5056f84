"""What a run came to, why, and what would mend it: live from the states, and at its end.

The loop knows no truth but its own: `outcome` is its word, a `verdict` only physics can give.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from math import nan
from typing import TYPE_CHECKING

import numpy as np

from ..goals.goal import Goal
from ..loop.state import CONVERGED, HOLDING, SERVOING, STOPPED, ServoSettings, ServoState
from ..schemes.base import JointController, Scheme
from ..seeing.observation import Observation
from .arrival import Arrived
from .evidence import CameraEvidence, Oscillation, ShapeEvidence

if TYPE_CHECKING:
    from ..arm.resolution import Resolution

KINDS = (
    "running", "converged", "target_lost", "local_minimum", "camera_retreat", "singular",
    "out_of_reach",
    "joint_limit", "saturation", "gain_too_high", "too_few_images", "wrong_camera_model",
    "wrong_object", "ambiguous", "scheme_fault", "timed_out", "stopped",
)  # fmt: skip
NEARER = "choose a goal nearer to the arm"
CALIBRATE = "calibrate the camera: K, D, and where it is mounted"
# s over which a lack of progress is judged, and the part of the error that has to be left of it.
WINDOW, PROGRESS = 1.5, 0.9
# Part of the window's images in which a cause has to be there, to be the cause.
MOST = 0.6
# Asked speed of the camera that is worth a word, m/s and (rad/s) x 0.1 m.
SLOW = 2e-4
# s for which an oscillation is not forgotten: a swing cut short, or the target lost by it.
RINGS_ON = 1.0
# Part of the wanted rate that L can give below which the error is no camera motion's.
UNREACHED = 0.1


@dataclass(frozen=True)
class Outcome:
    """One word for how it stands, the reason in words, and what would mend it.

    open_distance, open_angle: of a camera that has arrived, 99.7 % bounds on how far it is from its
    goal, m and rad; inf where it may be anywhere along a direction, NaN where nobody knows.
    """

    kind: str = "running"
    reason: str = ""
    mend: str = ""
    open_distance: float = nan
    open_angle: float = nan


@dataclass(frozen=True, eq=False)
class _Seen:
    """What one servoed image leaves behind; size and error (k,) in tolerances (k,)."""

    stamp: float
    size: float
    state: ServoState
    full_rank: int
    error: np.ndarray
    tolerances: np.ndarray

    @property
    def resolution(self) -> Resolution | None:
        """Of the state."""
        return self.state.resolution

    @property
    def rank(self) -> int:
        """Of L; worked out when first asked for."""
        return self.state.rank

    @property
    def asked(self) -> float:
        """Speed of the camera that was asked for, m/s and (rad/s) x 0.1 m."""
        twist = self.state.twist
        return float(np.linalg.norm(twist[:3]) + 0.1 * np.linalg.norm(twist[3:]))

    def reached(self) -> float:
        """Part of the error that some twist could take away, by L (k, 6) in tolerances."""
        L, norm = self.state.decision.L, float(np.linalg.norm(self.error))
        if L is None or len(L) != len(self.error) or norm == 0.0:
            return 1.0
        L = L / self.tolerances[:, None]
        answer = np.linalg.lstsq(L, self.error, rcond=1e-6)[0]
        return float(np.linalg.norm(L @ answer)) / norm


class Diagnosis:
    """Follows one run. Ask `outcome` at any time."""

    def __init__(
        self,
        settings: ServoSettings,
        jacobian: Callable[[np.ndarray], np.ndarray] | None = None,
        beyond: str = "",
    ) -> None:
        """Args:
            jacobian: (6, n) of the arm at joints (n,); None: there is no arm.
            beyond: why the arm cannot be where the goal was taught, where it cannot.
        """
        self.settings, self._jacobian, self._beyond = settings, jacobian, beyond
        self.reset()

    def reset(self) -> None:
        """A new run."""
        self.outcome = Outcome()
        self._window: deque[_Seen] = deque()
        self._oscillation = Oscillation()
        self._camera = CameraEvidence(self._jacobian)
        self._shape = ShapeEvidence()
        self._touched: tuple[str, ...] = ()
        self._measured: float | None = None  # when the scheme could last answer, s
        self._ended: Outcome | None = None
        self._starvings, self._starved = 0, Outcome()
        self._ringing: tuple[float, Outcome] | None = None

    # -- events that are no image ------------------------------------------------------------

    def fault(self, reason: str) -> None:
        """The scheme failed between images."""
        self.outcome = Outcome("scheme_fault", reason, "mend the scheme; its traceback is logged")

    def starved(self, t: float, period: float) -> None:
        """The watchdog stopped the arm at t (s); period of the images before, s."""
        self._starvings += 1
        self.outcome = self._starved = Outcome(
            "too_few_images",
            f"no image came for longer than the watchdog's time, at {t:.2f} s"
            + (f" (before that one every {period:.3f} s)" if period > 0.0 else ""),
            "raise the camera's rate, or look after what delays its images",
        )

    def timed_out(self, duration: float) -> None:
        """The time for the run is over; what was found before stays the outcome."""
        if self.outcome.kind == "running" and self._beyond:
            self.outcome = Outcome("out_of_reach", self._beyond, NEARER)
        elif self.outcome.kind == "running":
            last = f": {self.outcome.reason}" if self.outcome.reason else ""
            self.outcome = Outcome(
                "timed_out", f"not at the goal after {duration:.1f} s{last}",
                "allow more time, or a higher gain",
            )  # fmt: skip
        self._ended = self.outcome

    # -- images --------------------------------------------------------------------------------

    def see(
        self,
        state: ServoState,
        observation: Observation,
        goal: Goal,
        scheme: Scheme | JointController,
        faulty: bool = False,
    ) -> Outcome:
        """Take in the state of one image; answers the outcome as of now."""
        if self._ended is None:
            found = self._judged(state, observation, goal, scheme, faulty)
            # Stopped by the watchdog again and again: the images between do not mend it.
            starved = found.kind == "running" and self._starvings > 1
            self.outcome = self._starved if starved else found
        return self.outcome

    def _judged(
        self,
        state: ServoState,
        observation: Observation,
        goal: Goal,
        scheme: Scheme | JointController,
        faulty: bool,
    ) -> Outcome:
        if state.decision is None:
            self._window.clear()
            self._camera.interrupt()
        if faulty:
            return Outcome("scheme_fault", state.reason, "mend the scheme; its traceback is logged")
        if state.phase == STOPPED:
            return Outcome("stopped", state.reason, "call start")
        if observation.touches:
            self._touched = observation.touches
        if state.decision is not None:
            self._measured = state.stamp
        if state.decision is None:
            if state.phase != HOLDING:
                return self.outcome
            if observation.valid:
                return self._unmeasured(state)
            if self._ringing is not None and state.stamp - self._ringing[0] < RINGS_ON:
                return self._ringing[1]
            if self.outcome.kind in ("target_lost", "wrong_object"):
                return self.outcome
            return self._lost(state)
        if fault := self._shape.add(observation, goal):
            return Outcome(
                "wrong_object", fault,
                "let the segmentation choose the target: component 'nearest' or 'mask'",
            )  # fmt: skip
        tolerances = np.asarray(scheme.tolerances, float)
        if getattr(scheme, "judges_camera", True):
            self._camera.add(state.decision, observation, tolerances)
        self._add(state, tolerances)
        fault = self._camera.fault()
        # A goal that this camera has shown is where its picture is the same, whatever is believed
        # of it; a goal that was worked out is not.
        shown = goal.camera is not None and goal.camera == observation.camera
        if fault and not (shown and state.phase == CONVERGED):
            stalled = self._stalled(state)
            if stalled.kind == "joint_limit":  # whatever else: past its limit no joint goes on
                return replace(stalled, reason=f"{stalled.reason}; besides, {fault}")
            return Outcome("wrong_camera_model", fault, CALIBRATE)
        if state.phase == CONVERGED:
            found = _converged(state.arrived)
            if not fault or found.kind == "ambiguous":
                return found
            return replace(
                found, reason=f"at the goal as this camera has shown it; yet {fault}",
                mend=CALIBRATE,
            )  # fmt: skip
        ringing = self._oscillation.add(state.stamp, self._window[-1].error)
        if ringing is not None:
            found = Outcome(
                "gain_too_high", f"the error oscillates at {ringing:.2f} Hz and does not die away",
                "lower the gain, or the delay between image and command",
            )  # fmt: skip
            self._ringing = (state.stamp, found)
            return found
        if self._ringing is not None and state.stamp - self._ringing[0] < RINGS_ON:
            return self._ringing[1]
        return self._stalled(state)

    def _add(self, state: ServoState, tolerances: np.ndarray) -> None:
        decision = state.decision
        error = decision.error / tolerances
        size = max(map(abs, error.tolist()))
        modelled = 6 if decision.task is None else int(decision.task.modelled.sum())
        self._window.append(
            _Seen(state.stamp, size, state, min(modelled, len(error)), error, tolerances)
        )
        while self._window[0].stamp < state.stamp - WINDOW:
            self._window.popleft()

    def _stalled(self, state: ServoState) -> Outcome:
        """Why the error does not shrink; 'running' while it does."""
        seen = list(self._window)
        if state.phase != SERVOING or seen[-1].stamp - seen[0].stamp < 0.9 * WINDOW:
            return Outcome("running", state.reason)
        half = len(seen) // 2
        before = max(s.size for s in seen[:half])
        after = max(s.size for s in seen[half:])
        if after < 1.0 or after < PROGRESS * before or _within(seen[half:]):
            return Outcome("running", state.reason)
        for cause in (self._limit, self._rank, self._minimum, self._reach, self._saturation):
            if (found := cause(seen)) is not None:
                return found
        return Outcome("running", state.reason or "the error does not shrink")

    @staticmethod
    def _limit(seen: list[_Seen]) -> Outcome | None:
        stopped = [s.resolution.stopped for s in seen if s.resolution is not None]
        if not seen or sum(bool(names) for names in stopped) < MOST * len(seen):
            return None
        joints = ", ".join(sorted({name for names in stopped for name in names}))
        return Outcome(
            "joint_limit", f"{joints} at its limit: the goal lies beyond it on this way",
            "begin from another posture, or choose a goal away from the limit",
        )  # fmt: skip

    @staticmethod
    def _rank(seen: list[_Seen]) -> Outcome | None:
        if sum(s.rank < s.full_rank for s in seen) >= MOST * len(seen):
            last = seen[-1]
            return Outcome(
                "singular", f"L has rank {last.rank} of {last.full_rank}",
                "other features, or more of them: some direction of the camera is not seen",
            )  # fmt: skip
        return None

    @staticmethod
    def _minimum(seen: list[_Seen]) -> Outcome | None:
        if not all(s.reached() < UNREACHED for s in seen[len(seen) // 2 :]):
            return None
        words = ""
        resolution = seen[-1].resolution
        if resolution is not None and resolution.null_direction is not None:
            direction = np.round(np.asarray(resolution.null_direction), 2).tolist()
            words = f"; null direction {direction}"
        return Outcome(
            "local_minimum",
            f"the camera stands still with an error {seen[-1].size:.0f} times its tolerance: L v "
            f"gives {100.0 * seen[-1].reached():.0f} % of it{words}",
            "begin nearer to the goal, or use L desired or mean",
        )

    @staticmethod
    def _reach(seen: list[_Seen]) -> Outcome | None:
        lost = 0
        for s in seen:
            if s.resolution is None or s.asked < SLOW:
                continue
            missing = np.asarray(s.resolution.lost)
            amount = np.linalg.norm(missing[:3]) + 0.1 * np.linalg.norm(missing[3:])
            lost += amount > 0.3 * s.asked
        if lost < MOST * len(seen):
            return None
        resolution = seen[-1].resolution
        stretched = any("reach" in reason for reason in resolution.reasons)
        missing = np.round(np.asarray(resolution.lost), 4).tolist()
        if stretched:
            return Outcome(
                "out_of_reach", f"the arm is stretched; lost of the asked twist: {missing}",
                NEARER,
            )  # fmt: skip
        return Outcome(
            "singular", f"the arm has not the directions asked for; lost: {missing}",
            "begin from another posture, or choose a goal away from the singularity",
        )  # fmt: skip

    @staticmethod
    def _saturation(seen: list[_Seen]) -> Outcome | None:
        slowed = [s.resolution for s in seen if s.resolution and s.resolution.scale < 0.99]
        if len(slowed) < MOST * len(seen):
            return None
        joint = slowed[-1].slowing
        return Outcome(
            "saturation", f"{joint} at its limit of speed or acceleration, and no progress",
            "raise max_velocity or max_acceleration, or lower the gain",
        )  # fmt: skip

    def _unmeasured(self, state: ServoState) -> Outcome:
        """Of an image in which the target is seen and the scheme finds no answer."""
        if self._measured is None:
            self._measured = state.stamp
        if state.stamp - self._measured < WINDOW:
            return Outcome("running", state.reason)
        return Outcome(
            "target_lost", f"no measurement since {self._measured:.2f} s: {state.reason}",
            "teach the goal with this camera and scheme, or begin nearer to it",
        )  # fmt: skip

    def _lost(self, state: ServoState) -> Outcome:
        if self._beyond:
            return Outcome(
                "out_of_reach", f"{self._beyond}; on its way the target was lost: {state.reason}",
                NEARER,
            )  # fmt: skip
        over = f" over the {' and '.join(self._touched)} border" if self._touched else ""
        return Outcome(
            "target_lost", f"target lost at {state.stamp:.2f} s{over}: {state.reason}",
            "begin with the target nearer to the middle, or lower the gain",
        )  # fmt: skip


def _within(seen: list[_Seen]) -> bool:
    """Whether errors are within their tolerances but for noise, which has no cause to be named."""
    errors = [s.error for s in seen]
    return len({len(e) for e in errors}) == 1 and bool((np.abs(np.mean(errors, axis=0)) < 1).all())


def _converged(arrived: Arrived) -> Outcome:
    """What an arrival is worth."""
    if arrived.other_view:
        return Outcome(
            "ambiguous", "every feature is the goal's, but the picture is not: another pose has "
            "the same features",
            "begin nearer to the goal, or use more features than directions",
        )  # fmt: skip
    left = arrived.open
    kind = f"converged up to {left.up_to}" if left.up_to else "converged"
    return Outcome(kind, left.reason, left.mend, left.distance, left.angle)
