"""What a run came to, why, and its remedy: live from the states, and at its end.

Asked in this order, and the first answer counts: has the camera gone far back, do the joints do
what they are told, are images there, does the target move, does the camera's motion explain the
picture, is the camera at its goal, and if not, why does the error not shrink. The loop knows no
truth but its own: `outcome` is its word, a `verdict` only physics can give.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..arm.fold import Fold
from ..arm.joint_sample import JointSample
from ..errors import BEHIND
from ..goals.goal import Goal
from ..loop.state import CONVERGED, HOLDING, STOPPED, ServoSettings, ServoState
from ..schemes.base import JointController, Scheme
from ..seeing.observation import Observation
from .advice import (
    faster_joints,
    is_own,
    other_scheme,
    patience,
    wider_limits,
)
from .arrival import Arrived
from .camera_check import CameraCheck
from .gain_check import GainCheck
from .joint_check import JointCheck, foreign_text, listed
from .motion_check import MotionCheck
from .outcomes import CALIBRATE, DO_NOT_FOLLOW, NO_MOTION, UNCOVERED, Outcome, outcome
from .progress_check import WINDOW, ProgressCheck
from .remedy import Remedy, set_to
from .shape_check import ShapeCheck
from .step_check import distance_by_kinematics
from .target_check import TargetCheck
from .views import by_camera, shown

NONE: Mapping[str, Sequence[str]] = {}
# s for which an outcome is reported at least once it has been for as long, and those to which that
# applies: of one situation, an arm that servoes.
STEADY = 1.0
WHILE_SERVOING = (
    "running", "target_moves", "wrong_camera_model", "gain_too_high", "joint_limit", "singular",
    "local_minimum", "camera_retreat", "out_of_reach", "saturation", "too_noisy", "no_progress",
    "wrong_object",
)  # fmt: skip
# s after which an interruption of the images is forgotten: they come well since.
FORGOTTEN = 10.0
# Times as far as L says that a camera may be from its goal whose motion L does not explain.
MISTAKEN = 2.0
# Times as far as start and goal both from which on the camera has retreated, and images in a row
# that have to show it: one may show a part of the target, or something else. Nearer than RETURNED
# times it has come back.
RETREAT, IN_A_ROW, RETURNED = 3.0, 3, 1.5
# Bend of an elbow, rad, within which the arm counts as stretched.
STRETCHED = 0.1
# Part of the distance by the size in the image that the joints have to confirm.
CONFIRMED = 0.6
# What a scheme or the target, and not the camera, explains: outcomes that follow from it.
FOLLOW = ("camera_retreat", "gain_too_high", "local_minimum", "no_progress", "too_noisy",
          "ambiguous", "target_lost", "singular", "timed_out", "target_moves", "wrong_object",
          "wrong_camera_model")  # fmt: skip
MISREAD = Remedy(
    "see that the scheme compares each feature with its own number of the goal, and has more "
    "features than directions; a shipped one shows whether the goal can be reached",
    set_to("scheme", "points"),
)
DRIFTS = outcome("target_moves", "the features moved steadily while the camera was at rest")
# Part of the features' last motion from which on it is the target's, and s for which the camera is
# not judged by what comes after it.
OWN, RUNS_ON = 0.5, 1.0


class Diagnosis:
    """Follows one run. Ask `outcome` at any time."""

    def __init__(
        self,
        settings: ServoSettings,
        jacobian: Callable[[np.ndarray], np.ndarray] | None = None,
        beyond: str = "",
        names: Sequence[str] = (),
        lengths: np.ndarray | float = 1.0,
        narrowed: Mapping[str, Sequence[str]] = NONE,
        folds: Sequence[Fold] = (),
        outside: Sequence[str] = (),
    ) -> None:
        """Args:
            jacobian: (6, n) of the arm at joints (n,); None: there is no arm.
            beyond: why the arm cannot be where the goal was taught, where it cannot.
            names: of the n joints. lengths: see JointCheck.
            narrowed: joints whose limits are narrower than the robot's own, by the parameter.
            folds: elbows of the arm. outside: joints that the goal has beyond their limits.
        """
        self.settings, self._jacobian, self._beyond = settings, jacobian, beyond
        self._names, self._lengths, self._narrowed = tuple(names), lengths, narrowed
        self._folds, self._outside = folds, listed(list(outside))
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
        self._last: float | None = None  # stamp of the last image, s
        self._gap = 0.0  # longest time without an image, s
        self.outcome = Outcome()
        self._progress = ProgressCheck(self.settings.duration)
        self._gain = GainCheck(self.settings.duration)
        self._joints = JointCheck(self._names, self._lengths)
        self._target = TargetCheck()
        self._cameras: dict[str, CameraCheck] = {}
        self._shapes: dict[str, ShapeCheck] = {}
        self._touched = ""  # borders that the target touched last, in words
        self._since = -np.inf  # when the present outcome was found first, s
        self._other: tuple[str, float] | None = None  # kind found instead of it, and since when
        self._measured: float | None = None  # when the scheme could last answer, s
        self._ended = False
        self._starvings, self._starved, self._starved_at = 0, Outcome(), -np.inf
        # When the target moved faster than any camera could, s; whether that is not long ago.
        self._ran_away, self._runs_away = -np.inf, False
        self._first = 0.0  # distance of the target at the first image, goal's distances
        self._far, self._retreated = 0, Outcome()
        self._loss: Outcome | None = None  # why the target was lost last
        self._motion = MotionCheck()
        self._scheme: Scheme | JointController | None = None

    # -- events that are no image ------------------------------------------------------------

    def fault(self, reason: str) -> None:
        """The scheme failed between images."""
        self.outcome = outcome("scheme_fault", reason)

    def unmeasured(self, reason: str) -> None:
        """The joints could not be measured; `reason`: why."""
        if not self._ended:
            self.outcome = outcome("no_joint_states", reason)

    def halted(self, found: Outcome) -> None:
        """The loop is to hold still until it is started, whatever it sees."""
        if not self._ended:
            self.outcome, self._ended = found, True

    def joints(
        self, stamp: float, late: np.ndarray, commanded: np.ndarray, measured: np.ndarray
    ) -> None:
        """The joints at an image: see JointCheck.add."""
        self._joints.add(stamp, late, commanded, measured)

    def starved(self, t: float, period: float) -> None:
        """The watchdog stopped the arm at t (s); period of the images before, s."""
        self._starvings = 1 if t - self._starved_at > FORGOTTEN else self._starvings + 1
        self._starved_at = t
        gap = t - self._last if self._last is not None else 0.0
        self._gap = max(self._gap, gap, period)
        found = outcome(
            "too_few_images",
            f"no image came for longer than the watchdog's time, at {t:.2f} s"
            + (f" (before that one every {period:.3f} s)" if period > 0.0 else ""),
        )
        if self._starvings > 1:
            gain = getattr(getattr(self._scheme, "law", None), "gain", None)
            found = replace(found, remedy=patience(self._gap, gain, self.settings.duration))
        self.outcome = self._starved = found

    def timed_out(self, duration: float) -> None:
        """The time for the run is over; what was found before stays the outcome."""
        if self.outcome.kind == "running":
            last = f": {self.outcome.reason}" if self.outcome.reason else ""
            found = self._advised(self._unfinished(f"not at the goal after {duration:.1f} s{last}"))
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
        swings = found.kind in ("no_progress", "timed_out") and self._gain.unfinished(reason)
        return swings or found

    # -- images --------------------------------------------------------------------------------

    def see(
        self,
        state: ServoState,
        observation: Observation,
        goal: Goal,
        scheme: Scheme | JointController,
        faulty: bool = False,
        age: float = 0.0,
    ) -> Outcome:
        """Take in the state of one image, whose answer acts `age` s after its exposure; answers the
        outcome as of now."""
        self._images += 1
        if self._last is not None and self._starvings:
            self._gap = max(self._gap, state.stamp - self._last)
        self._last = state.stamp
        if scheme is not self._scheme:
            self._scheme, self._motion = scheme, MotionCheck(is_own(scheme))
        if faulty:
            self._faults.append((state.stamp, state.reason))
        if not self._ended:
            found = self._judged(state, observation, goal, scheme, faulty, age)
            # Stopped by the watchdog again and again: the images between do not cure it.
            lately = state.stamp - self._starved_at < FORGOTTEN
            starved = found.kind == "running" and lately and self._starvings > 1
            self.outcome = self._starved if starved else self._steady(state.stamp, found)
        return self.outcome

    def _steady(self, stamp: float, found: Outcome) -> Outcome:
        """What is reported: an outcome that has been for STEADY s gives way to another one of the
        same situation only once that has been found for as long."""
        current, family = self._outcome, (found.kind, self._outcome.kind)
        if found.kind == current.kind:
            self._other = None
            return found
        if not all(kind in WHILE_SERVOING for kind in family) or current.kind == "running" or (
            stamp - self._since < STEADY
        ):
            self._since, self._other = stamp, None
            return found
        if self._other is None or self._other[0] != found.kind:
            self._other = found.kind, stamp
        if stamp - self._other[1] < STEADY:
            return current
        self._since, self._other = stamp, None
        return found

    def _judged(
        self,
        state: ServoState,
        observation: Observation,
        goal: Goal,
        scheme: Scheme | JointController,
        faulty: bool,
        age: float,
    ) -> Outcome:
        if state.decision is None:
            self._progress.clear()
            self._target.interrupt()
            self._motion.interrupt()
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
        self._motion.steps.follow_area(observation, goal)
        if self._retreated.kind != "running" and state.phase != CONVERGED:
            fault = self._motion.scheme_fault(state.stamp, state.phase == CONVERGED)
            return outcome("scheme_fault", fault) if fault else self._advised(self._retreated)
        if self._joints.reason and state.phase != CONVERGED:
            return self._disobeying()
        if state.decision is None:
            return self._blind(state, observation)
        self._measured = state.stamp
        self._loss = None
        if fault := self._strange(observation, goal):
            return self._other_target(state, observation, fault)
        tolerances = np.asarray(scheme.tolerances, float)
        error = self._progress.add(
            state, tolerances, goal.distance, self._is_stretched(state.joints)
        )
        viewed = getattr(scheme, "judges_camera", True)
        own = self._motion.is_own  # features whose L may be wrong say nothing of the target
        # What can wrap: an angle, or what may be one; a length cannot.
        angles = np.array([unit != "m" for unit in scheme.units] or [True] * len(tolerances))
        moves = self._target.add(
            state.decision, observation, goal, tolerances, viewed and not own, angles
        )
        self._motion.add(state.decision, observation, goal, tolerances, angles)
        if fault := self._motion.scheme_fault(state.stamp, state.phase == CONVERGED):
            return outcome("scheme_fault", fault)
        if self._motion.targets_own > OWN:
            self._ran_away = state.stamp
        self._runs_away = state.stamp - self._ran_away < RUNS_ON
        if moves:
            self._cameras.clear()  # what they saw was the target's doing
        elif viewed:
            for name, part, tolerated, wrap in by_camera(
                state.decision, observation, tolerances, angles
            ):
                check = self._cameras.get(name)
                if check is None:
                    check = self._cameras[name] = CameraCheck(self._jacobian)
                check.add(part, observation, tolerated, wrap)
        swings = self._gain.add(state.stamp, error, scheme, age)
        fast = self._gain.swings_fast(state.stamp)
        if moves and state.phase != CONVERGED and not fast:
            if self._target.another_camera and (fault := self._contrary()):
                return self._mistaken(fault)
            found = outcome(
                "target_moves", "the features move as the camera's motion and a motion of the "
                f"target's own say: {moves}",
            )  # fmt: skip
            swings = swings or self._gain.hasty
            return self._covered(found if swings is None else _both(found, swings))
        # Between two images of a fast swing L is not what it is at either.
        fault = "" if fast else self._wrong_camera(observation)
        if fault and state.phase != CONVERGED and (swings or self._gain.hasty):
            fault = ""  # whatever the camera is: not by a motion that is not yet over when judged
        # A goal that this camera has shown is where its picture is the same, whatever is believed
        # of it; a goal that was worked out is not.
        if fault and not (state.phase == CONVERGED and shown(observation, goal)):
            stalled = self._progress.stalled(state)
            if stalled.kind == "joint_limit":  # whatever else: past its limit no joint goes on
                return replace(stalled, reason=f"{stalled.reason}; besides, {fault}")
            return self._mistaken(fault)
        if state.phase == CONVERGED:
            found = _converged(state.arrived)
            if found.kind == "ambiguous" and own:
                found = replace(found, remedy=MISREAD)
            if not fault or found.kind == "ambiguous":
                return self._covered(found)
            return replace(
                found, reason=f"at the goal as this camera has shown it; yet {fault}",
                remedy=CALIBRATE, open_distance=MISTAKEN * found.open_distance,
                open_angle=min(MISTAKEN * found.open_angle, np.pi),
            )  # fmt: skip
        stalled = swings or self._progress.stalled(state)
        if self._beyond and stalled.kind != "running":
            return outcome("out_of_reach", self._beyond)
        return self._advised(stalled)

    def _other_target(self, state: ServoState, observation: Observation, fault: str) -> Outcome:
        """The outcome where what is visible has another shape than the goal's target: a camera that
        was driven astray sees it like that too."""
        if found := self._motion.scheme_fault(state.stamp, state.phase == CONVERGED):
            return outcome("scheme_fault", found)
        if found := self._wrong_camera(observation):
            return self._mistaken(found)
        return self._covered(outcome("wrong_object", fault))

    def _mistaken(self, fault: str) -> Outcome:
        """The outcome of features that do not move as L and the camera say."""
        if self._motion.l_is_wrong:
            return outcome(
                "scheme_fault", f"{fault}, and the target's centre moves as they say: L is not "
                "that of the scheme's features",
            )  # fmt: skip
        return self._covered(outcome("wrong_camera_model", fault))

    def _contrary(self) -> str:
        """How the features moved otherwise than L says all along, as text; empty: they did not, or
        noise hides it."""
        return "" if self._progress.noise else self._motion.contrary(self._target.moves)

    def _covered(self, found: Outcome) -> Outcome:
        """The outcome where something covers the target: of that, if it can follow from it."""
        steps = self._motion.steps
        if steps.covered is None or found.kind not in FOLLOW or self._progress.noise:
            return found
        return outcome(
            "wrong_object", f"since {steps.covered:.2f} s something covers the target, of which "
            f"{100.0 * steps.visible:.0f} % is visible; {found.reason}",
        ).with_remedy(UNCOVERED)

    def _narrowed_by(self, reason: str) -> list[str]:
        """The parameters that narrow the limits of the joints which a reason names."""
        return sorted({key for key, names in self._narrowed.items()
                       if any(name in reason for name in names)})  # fmt: skip

    def _advised(self, found: Outcome) -> Outcome:
        """The outcome of a run that does not come to its goal, with what is known besides."""
        if found.kind in ("camera_retreat", "local_minimum", "singular"):
            found = replace(found, remedy=other_scheme(found, self._scheme))
        if found.kind == "joint_limit":
            if keys := self._narrowed_by(found.reason):
                found = replace(found, remedy=wider_limits(keys))
            slow = self._progress.slowed
            return found if slow is None else _both(found, slow)
        if found.kind == "saturation" and self._outside:
            return _both(found, self._limits_of_goal())
        covered = self._motion.steps.covered is not None
        if found.kind == "gain_too_high":
            drifts = self._motion.steps.drifts and not self._motion.is_own
            return self._covered(_both(found, DRIFTS) if drifts else found)
        if not covered and found.kind in FOLLOW and (fault := self._contrary()):
            kind = "scheme_fault" if self._motion.l_is_wrong else "wrong_camera_model"
            return outcome(kind, f"{fault}; {found.reason}")
        jumped = self._motion.jumped
        if jumped and found.kind in FOLLOW and jumped not in found.reason:
            found = replace(found, reason=f"{found.reason}; {jumped}")
        return self._covered(found)

    def _limits_of_goal(self) -> Outcome:
        """That the goal was shown with joints beyond their limits."""
        found = outcome("joint_limit", f"the goal was shown with {self._outside} beyond its limit")
        keys = self._narrowed_by(found.reason)
        return replace(found, remedy=wider_limits(keys)) if keys else found

    def _is_stretched(self, joints: JointSample | None) -> bool:
        """Whether an elbow is all but straight."""
        return joints is not None and any(
            abs(joints.positions[fold.joint] - fold.straight) < STRETCHED for fold in self._folds
        )

    def _disobeying(self) -> Outcome:
        """The outcome of joints that do not follow: another node may command them."""
        found = outcome(DO_NOT_FOLLOW, self._joints.reason, self._joints.joints)
        if not self.foreign and self._joints.slow:
            return replace(found, remedy=faster_joints(found.remedy))
        if not self.foreign:
            return found
        nodes = listed(list(dict.fromkeys(self.foreign.values())))
        return replace(
            found, reason=f"{found.reason}: {foreign_text(self.foreign)}",
            remedy=Remedy(f"end the commands of {nodes}; the loop then continues by itself"),
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
        """What cannot be with the cameras as believed, as text; empty where all can, or where the
        target has just run away faster than any camera of this motion shows."""
        if self._runs_away:
            return ""
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
        far = distance > RETREAT * max(self._first, 1.0)
        if far and goal.world_T_camera is not None and observation.world_T_camera is not None:
            by_joints = distance_by_kinematics(observation.world_T_camera, goal)
            far = by_joints > CONFIRMED * distance
        self._far = self._far + 1 if far else 0
        if distance < RETURNED * max(self._first, 1.0):
            self._retreated = Outcome()
        if self._retreated.kind == "running" and self._far == IN_A_ROW:
            words = f"the camera went back to {distance:.1f} times its goal's distance"
            self._retreated = outcome("camera_retreat", f"{words} from the target")
            if found := self._gain.lately(stamp):
                self._retreated = replace(found, reason=f"{found.reason}; {words}")

    # -- images without an answer -----------------------------------------------------------

    def _blind(self, state: ServoState, observation: Observation) -> Outcome:
        """Of an image that the scheme has no answer to."""
        if state.phase != HOLDING:
            return Outcome("running", state.reason)  # what was before is over
        if observation.valid:
            return self._unanswered(state)
        # However long ago: what was swinging when it was lost, was lost by that.
        if self._measured is not None and (found := self._gain.lately(self._measured)):
            return self._advised(found)
        if self._loss is None:
            seen_wrong = self._outcome.kind == "wrong_object"
            self._loss = self._outcome if seen_wrong else self._lost(state, observation)
        return self._loss

    def _unanswered(self, state: ServoState) -> Outcome:
        """Of an image in which the target is seen and the scheme finds no answer."""
        if self._measured is None:
            self._measured = state.stamp
        if state.stamp - self._measured < WINDOW:
            return Outcome("running", state.reason)
        if BEHIND in state.reason:
            return self._advised(outcome(
                "wrong_camera_model", f"the image shows the target, but {BEHIND} where that is "
                "believed to be mounted",
            ))  # fmt: skip
        return self._advised(outcome(
            "target_lost", f"no measurement since {self._measured:.2f} s: {state.reason}"
        ))  # fmt: skip

    def _lost(self, state: ServoState, observation: Observation) -> Outcome:
        """Why the target was lost: by a fault of which the loss follows, or of its own."""
        at = f"the target was lost at {state.stamp:.2f} s: {state.reason}"
        if self._beyond:
            return outcome("out_of_reach", f"{self._beyond}; before it came there {at}")
        if fault := self._motion.scheme_fault(state.stamp, state.phase == CONVERGED):
            return outcome("scheme_fault", f"{fault}; {at}")
        covered = self._motion.steps.covered is not None
        moves = self._runs_away or covered
        if not covered and (found := self._gain.lost(at)):
            return self._advised(found)
        if not moves and (fault := self._wrong_camera(observation) or self._contrary()):
            kind = "scheme_fault" if self._motion.l_is_wrong else "wrong_camera_model"
            return outcome(kind, f"{fault}; {at}")
        over = f" over the {self._touched}" if self._touched else ""
        found = outcome(
            "target_lost", f"target lost at {state.stamp:.2f} s{over}: {state.reason}"
        )
        if covered:
            return self._covered(found)
        if moves:
            return replace(found, reason=f"{found.reason}; the features moved otherwise than the "
                           "camera: the target moved", remedy=NO_MOTION)  # fmt: skip
        if self._measured is not None and self._was_inside(observation):
            found = replace(found, reason=f"{found.reason}; it was inside of the image before",
                            remedy=UNCOVERED)  # fmt: skip
        return self._advised(found)

    def _was_inside(self, observation: Observation) -> bool:
        """Whether the target cannot have left the image by the motion that it had in it."""
        if self._touched or self._motion.steps.next is None:
            return False
        camera = observation.camera
        columns, rows = camera.project(*self._motion.steps.next)
        inside = min(*columns, *rows) > 0.0
        return inside and max(columns) < camera.width and max(rows) < camera.height

def _both(first: Outcome, second: Outcome) -> Outcome:
    """The first outcome with the reason and the remedy of a second one that fits as well."""
    changes = dict.fromkeys((*first.remedy.changes, *second.remedy.changes))
    return replace(
        first, reason=f"{first.reason}; besides, {second.reason}",
        remedy=Remedy(str(first.remedy).partition(":")[0], *changes),
    )  # fmt: skip


def _converged(arrived: Arrived) -> Outcome:
    """What an arrival is worth."""
    if arrived.elsewhere:
        return outcome("ambiguous", arrived.elsewhere)
    left = arrived.open
    kind = f"converged up to {left.up_to}" if left.up_to else "converged"
    return Outcome(kind, left.reason, left.remedy, left.distance, left.angle)
