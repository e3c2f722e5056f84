"""What a run came to, why, and its remedy: live from the states, and at its end.

Asked in this order, and the first answer counts: has the camera gone far back, do the joints do
what they are told, are images there, does the target move, does the camera's motion explain the
picture, is the camera at its goal, and if not, why does the error not shrink. The loop knows no
truth but its own: `outcome` is its word, a `verdict` only physics can give.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from ..goals.goal import Goal
from ..loop.state import CONVERGED, HOLDING, STOPPED, ServoSettings, ServoState
from ..schemes.base import Decision, JointController, Scheme
from ..seeing.observation import Observation
from .arrival import Arrived
from .camera_check import CameraCheck
from .joint_check import JointCheck, foreign_text, listed
from .oscillation import Oscillation
from .outcomes import CALIBRATE, DO_NOT_FOLLOW, Outcome, outcome
from .progress_check import WINDOW, ProgressCheck
from .shape_check import ShapeCheck
from .target_check import TargetCheck

# s after which an interruption of the images is forgotten: they come well since.
FORGOTTEN = 10.0
# s for which a swing is not forgotten: one that was cut short, or the target lost by it.
SWINGS_ON = 1.0
# Times as far as L says that a camera may be from its goal whose motion L does not explain.
MISTAKEN = 2.0
# Times as far as start and goal both from which on the camera has retreated, and images in a row
# that have to show it: one may show a part of the target, or something else.
RETREAT, IN_A_ROW = 3.0, 3


class Diagnosis:
    """Follows one run. Ask `outcome` at any time."""

    def __init__(
        self,
        settings: ServoSettings,
        jacobian: Callable[[np.ndarray], np.ndarray] | None = None,
        beyond: str = "",
        names: Sequence[str] = (),
        lengths: np.ndarray | float = 1.0,
    ) -> None:
        """Args:
            jacobian: (6, n) of the arm at joints (n,); None: there is no arm.
            beyond: why the arm cannot be where the goal was taught, where it cannot.
            names: of the n joints. lengths: see JointCheck.
        """
        self.settings, self._jacobian, self._beyond = settings, jacobian, beyond
        self._names, self._lengths = tuple(names), lengths
        self.foreign: dict[str, str] = {}  # other nodes that command joints now, by joint
        self.reset()

    @property
    def outcome(self) -> Outcome:
        """What the loop knows of the run so far."""
        found = self._outcome
        if not self._faults or found.kind in ("running", "scheme_fault"):
            return found
        reason = f"{found.reason}; {self._faulty}" if found.reason else self._faulty
        return replace(found, reason=reason)

    @outcome.setter
    def outcome(self, found: Outcome) -> None:
        self._outcome = found

    @property
    def _faulty(self) -> str:
        """How many images the scheme gave no answer to, when and why, as text."""
        first, last, reason = self._faults[0], self._faults[-1], self._faults[-1][1]
        when = f"at {first[0]:.2f} s" if first is last else (
            f"from {first[0]:.2f} s to {last[0]:.2f} s"
        )  # fmt: skip
        count = len(self._faults)
        images = f"{count} image{'s' if count > 1 else ''} of {self._images}"
        return f"{images} got no answer from the scheme ({when}): {reason}"

    def reset(self) -> None:
        """A new run."""
        self._faults: list[tuple[float, str]] = []  # of images, with the scheme's fault
        self._images = 0
        self.outcome = Outcome()
        self._progress = ProgressCheck()
        self._oscillation = Oscillation()
        self._joints = JointCheck(self._names, self._lengths)
        self._target = TargetCheck()
        self._cameras: dict[str, CameraCheck] = {}
        self._shapes: dict[str, ShapeCheck] = {}
        self._touched = ""  # borders that the target touched last, in words
        self._measured: float | None = None  # when the scheme could last answer, s
        self._ended = False
        self._starvings, self._starved, self._starved_at = 0, Outcome(), -np.inf
        self._swung: tuple[float, Outcome] | None = None
        self._faster_than_targets = False  # the latest swing
        self._first = 0.0  # distance of the target at the first image, goal's distances
        self._far, self._retreated = 0, Outcome()

    # -- events that are no image ------------------------------------------------------------

    def fault(self, reason: str) -> None:
        """The scheme failed between images."""
        self.outcome = outcome("scheme_fault", reason)

    def unmeasured(self, reason: str) -> None:
        """The joints could not be measured; `reason`: why."""
        if not self._ended:
            self.outcome = outcome("no_joint_states", reason)

    def halted(self, kind: str, reason: str) -> None:
        """The loop was told to hold still until it is started, whatever it sees."""
        if not self._ended:
            self.outcome, self._ended = outcome(kind, reason), True

    def joints(
        self, stamp: float, late: np.ndarray, commanded: np.ndarray, measured: np.ndarray
    ) -> None:
        """The joints at an image: see JointCheck.add."""
        self._joints.add(stamp, late, commanded, measured)

    def starved(self, t: float, period: float) -> None:
        """The watchdog stopped the arm at t (s); period of the images before, s."""
        self._starvings = 1 if t - self._starved_at > FORGOTTEN else self._starvings + 1
        self._starved_at = t
        self.outcome = self._starved = outcome(
            "too_few_images",
            f"no image came for longer than the watchdog's time, at {t:.2f} s"
            + (f" (before that one every {period:.3f} s)" if period > 0.0 else ""),
        )

    def timed_out(self, duration: float) -> None:
        """The time for the run is over; what was found before stays the outcome."""
        if self.outcome.kind == "running":
            last = f": {self.outcome.reason}" if self.outcome.reason else ""
            found = self._unfinished(f"not at the goal after {duration:.1f} s{last}")
            # An image without an answer interrupts the loop: the camera has to settle again.
            recent = self._faults and self._faults[-1][0] > (self._measured or 0.0) - (
                self.settings.hold
            )
            if recent and found.kind in ("timed_out", "no_progress"):
                found = outcome("scheme_fault", f"{found.reason}; {self._faulty}")
            self.outcome = found
        self._ended = True

    def _unfinished(self, reason: str) -> Outcome:
        if self._beyond:
            return outcome("out_of_reach", self._beyond)
        found = self._progress.unfinished(reason)
        if found.kind in ("no_progress", "timed_out") and self._oscillation.swings:
            return outcome("gain_too_high", f"{reason}; the error swings about its goal")
        return found

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
        self._images += 1
        if faulty:
            self._faults.append((state.stamp, state.reason))
        if not self._ended:
            found = self._judged(state, observation, goal, scheme, faulty)
            # Stopped by the watchdog again and again: the images between do not cure it.
            lately = state.stamp - self._starved_at < FORGOTTEN
            starved = found.kind == "running" and lately and self._starvings > 1
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
            self._progress.clear()
            self._target.interrupt()
            for check in self._cameras.values():
                check.interrupt()
        if faulty:
            return outcome("scheme_fault", state.reason)
        if state.phase == STOPPED:
            return outcome("stopped", state.reason)
        for view in (observation, *observation.others.values()):
            if view.touches:
                by = f" of camera {view.name}" if observation.others else ""
                self._touched = f"{' and '.join(view.touches)} border{by}"
        self._follow_distance(state.stamp, observation, goal)
        if self._retreated.kind != "running" and state.phase != CONVERGED:
            return self._retreated
        if self._joints.reason and state.phase != CONVERGED:
            return self._disobeying()
        if state.decision is None:
            return self._blind(state, observation)
        self._measured = state.stamp
        if fault := self._strange(observation, goal):
            return outcome("wrong_object", fault)
        tolerances = np.asarray(scheme.tolerances, float)
        error = self._progress.add(state, tolerances, goal.distance)
        viewed = getattr(scheme, "judges_camera", True)
        # What can wrap: an angle, or what may be one; a length cannot.
        angles = np.array([unit != "m" for unit in scheme.units] or [True] * len(tolerances))
        moves = self._target.add(state.decision, observation, goal, tolerances, viewed, angles)
        if moves:
            self._cameras.clear()  # what they saw was the target's doing
        elif viewed:
            for name, part, tolerated, wrap in _by_camera(
                state.decision, observation, tolerances, angles
            ):
                check = self._cameras.get(name)
                if check is None:
                    check = self._cameras[name] = CameraCheck(self._jacobian)
                check.add(part, observation, tolerated, wrap)
        swings = self._swinging(state.stamp, error)
        fast = swings is not None and self._faster_than_targets
        if moves and state.phase != CONVERGED and not fast:
            return outcome(
                "target_moves", "the features move as the camera's motion and a motion of the "
                f"target's own say: {moves}",
            )  # fmt: skip
        # Between two images of a fast swing L is not what it is at either.
        fault = "" if fast else self._wrong_camera(observation)
        # A goal that this camera has shown is where its picture is the same, whatever is believed
        # of it; a goal that was worked out is not.
        if fault and not (state.phase == CONVERGED and _shown(observation, goal)):
            stalled = self._progress.stalled(state)
            if stalled.kind == "joint_limit":  # whatever else: past its limit no joint goes on
                return replace(stalled, reason=f"{stalled.reason}; besides, {fault}")
            return outcome("wrong_camera_model", fault)
        if state.phase == CONVERGED:
            found = _converged(state.arrived)
            if not fault or found.kind == "ambiguous":
                return found
            return replace(
                found, reason=f"at the goal as this camera has shown it; yet {fault}",
                remedy=CALIBRATE, open_distance=MISTAKEN * found.open_distance,
                open_angle=min(MISTAKEN * found.open_angle, np.pi),
            )  # fmt: skip
        stalled = swings or self._progress.stalled(state)
        if self._beyond and stalled.kind != "running":
            return outcome("out_of_reach", self._beyond)
        return stalled

    def _disobeying(self) -> Outcome:
        """The outcome of joints that do not follow: another node may command them."""
        found = outcome(DO_NOT_FOLLOW, self._joints.reason, self._joints.joints)
        if not self.foreign:
            return found
        nodes = listed(list(dict.fromkeys(self.foreign.values())))
        return replace(
            found, reason=f"{found.reason}: {foreign_text(self.foreign)}",
            remedy=f"end the commands of {nodes}; the loop then continues by itself",
        )  # fmt: skip

    def _strange(self, observation: Observation, goal: Goal) -> str:
        """Why what a camera sees cannot be its goal's target, in words; empty where it can."""
        found, goals = "", goal.cameras
        for name, view in observation.cameras.items():
            check = self._shapes.get(name)
            if check is None:
                check = self._shapes[name] = ShapeCheck()
            fault = check.add(view, goals[name]) if name in goals else ""
            found = found or (f"camera {name}: {fault}" if fault and observation.others else fault)
        return found

    def _wrong_camera(self, observation: Observation) -> str:
        """What cannot be with the cameras as believed, in words; empty where all can."""
        for name, check in self._cameras.items():
            if fault := check.fault():
                return f"camera {name}: {fault}" if observation.others and name else fault
        return ""

    def _follow_distance(self, stamp: float, observation: Observation, goal: Goal) -> None:
        """Whether the camera has gone far back, by how small it sees the target."""
        seen, wanted = observation.moments, goal.moments
        if not observation.valid or seen is None or wanted is None or seen.m00 <= 0.0:
            return
        distance = float(np.sqrt(wanted.m00 / seen.m00))
        self._first = self._first or distance
        self._far = self._far + 1 if distance > RETREAT * max(self._first, 1.0) else 0
        if self._retreated.kind == "running" and self._far == IN_A_ROW:
            words = f"the camera went back to {distance:.1f} times its goal's distance"
            self._retreated = outcome("camera_retreat", f"{words} from the target")
            if self._swung_lately(stamp):
                found = self._swung[1]
                self._retreated = replace(found, reason=f"{found.reason}; {words}")

    def _swinging(self, stamp: float, error: np.ndarray) -> Outcome | None:
        """That the error (k,), in tolerances, swings, or did a moment ago."""
        frequency = self._oscillation.add(stamp, error)
        if frequency is not None:
            self._faster_than_targets = frequency > TargetCheck.FASTEST
            self._swung = stamp, outcome(
                "gain_too_high",
                f"the error oscillates at {frequency:.2f} Hz and does not die away",
            )
        return self._swung[1] if self._swung_lately(stamp) else None

    def _swung_lately(self, stamp: float) -> bool:
        return self._swung is not None and stamp - self._swung[0] < SWINGS_ON

    # -- images without an answer -----------------------------------------------------------

    def _blind(self, state: ServoState, observation: Observation) -> Outcome:
        """Of an image that the scheme has no answer to."""
        if state.phase != HOLDING:
            # What the joints did before is over.
            over = self.outcome.kind in (DO_NOT_FOLLOW, "no_joint_states")
            return Outcome("running", state.reason) if over else self.outcome
        if observation.valid:
            return self._unanswered(state)
        # However long ago: what was swinging when it was lost, was lost by that.
        if self._measured is not None and self._swung_lately(self._measured):
            return self._swung[1]
        if self.outcome.kind in ("target_lost", "wrong_object"):
            return self.outcome
        return self._lost(state)

    def _unanswered(self, state: ServoState) -> Outcome:
        """Of an image in which the target is seen and the scheme finds no answer."""
        if self._measured is None:
            self._measured = state.stamp
        if state.stamp - self._measured < WINDOW:
            return Outcome("running", state.reason)
        return outcome(
            "target_lost", f"no measurement since {self._measured:.2f} s: {state.reason}"
        )

    def _lost(self, state: ServoState) -> Outcome:
        if self._beyond:
            return outcome(
                "out_of_reach", f"{self._beyond}; on its way the target was lost: {state.reason}"
            )
        if self._oscillation.grows:
            return outcome(
                "gain_too_high", "the error went to and fro, farther each time, until the target "
                f"was lost at {state.stamp:.2f} s",
            )  # fmt: skip
        over = f" over the {self._touched}" if self._touched else ""
        return outcome(
            "target_lost", f"target lost at {state.stamp:.2f} s{over}: {state.reason}"
        )


def _shown(observation: Observation, goal: Goal) -> bool:
    """Whether each camera is the one that has shown its goal."""
    goals = goal.cameras
    return all(name in goals and goals[name].camera == view.camera
               for name, view in observation.cameras.items())  # fmt: skip


def _by_camera(
    decision: Decision, observation: Observation, tolerances: np.ndarray,
    angles: np.ndarray | None = None,
) -> Iterator[tuple[str, Decision, np.ndarray, np.ndarray]]:
    """Name of each camera, its part of the decision, the tolerances of that, and what may wrap
    (None: every component).

    Of a scheme of several cameras, features of one are called 'camera.feature'; the others have no
    camera's name: they may be of all.
    """
    if not observation.others:
        yield observation.name, decision, tolerances, angles
        return
    L, count = decision.L, len(decision.names)
    if np.shape(L) != (count, 6):
        return
    rows: dict[str, list[int]] = {}
    for i, name in enumerate(decision.names):
        camera = name.partition(".")[0]
        rows.setdefault(camera if camera in observation.cameras else "", []).append(i)
    rate = np.broadcast_to(decision.rate, count)
    for camera, at in rows.items():
        yield camera, replace(decision, error=decision.error[at], L=L[at], rate=rate[at]), (
            tolerances[at]
        ), None if angles is None else angles[at]


def _converged(arrived: Arrived) -> Outcome:
    """What an arrival is worth."""
    if arrived.other_view:
        return outcome(
            "ambiguous", "every feature is the goal's, but the picture is not: another pose has "
            "the same features",
        )  # fmt: skip
    left = arrived.open
    kind = f"converged up to {left.up_to}" if left.up_to else "converged"
    return Outcome(kind, left.reason, left.remedy, left.distance, left.angle)
