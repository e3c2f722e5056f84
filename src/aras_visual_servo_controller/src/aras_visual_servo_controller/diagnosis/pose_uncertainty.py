"""How far a camera that has arrived may be from its goal: a bound that 99.7 % of runs keep.

It covers the mean offset that L sees, noise of the mean, the accuracy to which the features are
measured (twice: the goal was measured once, in the same way), directions that are held by
kinematics, directions that nothing measures, and poses from which the target looks the same.

Offsets are scaled here: the rotations by the target's depth, so that all six numbers are in m.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from math import inf, pi, radians, sin, sqrt
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from aras_visual_servo_base.compiled import jit
from aras_visual_servo_base.poses import pose_difference, skew
from aras_visual_servo_camera.interaction import Plane

from ..goals.goal import DEFAULT_DEPTH
from ..kinematics.held_directions import compute_held_directions
from ..records.outcomes import NO_REMEDY, PoseUncertainty
from ..records.remedy import Remedy
from .advice import suggest_larger_target

if TYPE_CHECKING:
    from ..goals.goal import Goal
    from ..kinematics.ik_solution import IKSolution
    from ..observation.observation import Observation
    from ..schemes.base import SchemeOutput
    from .ambiguous_poses import AmbiguousPose

# Parts of the target's depth and rad: plain 'converged' leaves open no more, 0.3 mm at 0.2 m.
NEGLIGIBLE_UNCERTAINTY = (1.5e-3, radians(0.3))
# Parts of the depth and rad that a camera at rest is known to: its joints move between images.
REST_MOTION = (5e-5, 1e-4)
# s for which a camera may go on as before the last image: its answer takes time and is ramped.
REACTION_TIME = 0.06
# Times that an offset by L counts where it is no noise, its translation and its rotation: L's depth
# may be believed 0.6 of the true one, and the camera's mounting 8 degrees off.
OFFSET_FACTORS = 1.7, 1.4
# Times that the deviation of corners and pixels counts: their errors have longer tails than a
# normal distribution. Of 949 pairs of rendered views, the offset is farther off than 99.7 % bound
# in 0.8 % by corners, 1.2 times at most; with 1.25 in 0.1 %, and the bound is a seventh wider.
TAIL_FACTOR = 1.1
Z_997 = 2.748  # of a normal distribution: 99.7 % are below
# Part of one image's scatter that averaging does not take away: noise is cut at black and white,
# and so moves what is measured. Corners and markers in noise of 5 grey levels, averaged over 25
# images: twice the 0.2 that is noise's own in a quarter of the cases, four times in one of twenty.
SYSTEMATIC_PART = 0.25
RANK_TOLERANCE = 1e-6  # part of L's greatest singular value below which a direction is not seen
# Part of the depth (and rad) that an offset may be for L to hold; what is known less well counts as
# a direction that nothing measures. A small plate is seen alike from two sides: 0.08 was 0.19.
MAX_LINEAR_OFFSET = 0.05
MAX_SCATTER = 0.08  # of one image's offset, whose mean over images is known better
# Of a direction that nothing measures: translation, times the (scaled) rotation, above which it is
# no turn about an axis.
MIN_TRANSLATION_RATIO = 20.0
# numbers that are looked at for what no motion explains; more say so themselves
MAX_RESIDUAL_ROWS = 64
# Part of L's greatest singular value below which features may be at their goals from another pose
# nearby; and of the plane's greatest change, below which a motion does not turn it.
WEAK_DIRECTION, MIN_PLANE_CHANGE = 0.05, 0.05
NO_OFFSET, IDENTITY = np.zeros(6), np.eye(6)
NOISE_DEVIATIONS = 3.0  # standard deviations beyond which an error is no noise
USE_LARGER_TARGET = suggest_larger_target(1.5)
ADD_FEATURE = Remedy("add a feature for them, if the pose matters")
PLANE_REASON = (
    "as kinematics have the target's plane elsewhere in the camera's frame than at the goal (it "
    "lies elsewhere, or the camera is not as described, or another pose has the same features)"
)
CHECK_CALIBRATION = Remedy("check the camera's calibration and where the goal has its target")
ADD_POINTS = Remedy("a target of more points, farther apart, or not in one plane")


class PoseOffsets(NamedTuple):
    """Of a camera from its goal by `count` noisy images: mean (6,), covariance (6, 6); m, rad.

    speed: of the camera towards or from its goal before the last image, m/s and rad/s.
    """

    mean: np.ndarray
    scatter: np.ndarray
    count: int
    speed: tuple[float, float]


class ArrivalMargin:
    """What the view at an arrival says of the images that follow, while their error is as large."""

    def __init__(
        self,
        scheme_output: SchemeOutput,
        observation: Observation,
        goal: Goal,
        error: np.ndarray,
        accuracy: np.ndarray | float | None,
        ik_solution: IKSolution | None,
        noise: np.ndarray | float = 0.0,
        scatter: np.ndarray | None = None,
    ) -> None:
        """Of the image with which the goal was reached.

        Args:
            error: (k,) mean of the last images. noise: (k,) standard deviations of that.
            scatter: (6, 6) covariance of the offsets by single images, m and rad.
            accuracy: of what L's rows belong to, see Feature.accuracy.
            resolution: says what an arm of few joints can move; None: all six directions.
        """
        self._goal, self._modelled = goal, scheme_output.task.modelled
        self._ambiguity, self._symmetry_bound = (
            scheme_output.ambiguity,
            bound_symmetry(scheme_output.ambiguity, goal),
        )
        self._systematic_part = 0.0 if accuracy is None else SYSTEMATIC_PART
        self._depth = depth = goal.distance
        scale = self._scale = np.array([1.0] * 3 + [depth] * 3)
        L = np.asarray(scheme_output.L, float) / scale
        if scheme_output.residual is not None:
            error, noise = scheme_output.residual, 0.0
        if np.ndim(accuracy) == 0 and accuracy is not None:
            accuracy = accuracy * np.eye(len(L))
        if len(error) <= MAX_RESIDUAL_ROWS:
            accuracy = _estimate_residual_accuracy(L, error, noise) if accuracy is None else (
                accuracy * max(compute_unexplained_ratio(L, error, accuracy, noise), 1.0)
            )  # fmt: skip
        if len(L) > 6:  # the same least squares with six rows
            Q, L = np.linalg.qr(L)
            accuracy = None if accuracy is None else Q.T @ accuracy
        self._ik_solution = ik_solution
        free = split_directions(observation, goal, self._modelled, ik_solution)[1]
        u, s, vt = np.linalg.svd(L @ free.T)
        s = np.append(s, np.zeros(len(vt) - len(s)))
        seen = s > RANK_TOLERANCE * s[0]
        spread = np.zeros((len(vt), 0))
        if accuracy is not None:
            spread = (u.T @ accuracy)[: len(s)]
            spread = np.vstack([spread, np.zeros((len(s) - len(spread), spread.shape[1]))])
            seen &= np.linalg.norm(spread, axis=1) <= MAX_LINEAR_OFFSET / Z_997 * depth * s
        along = vt @ free
        if scatter is not None:
            variance = ((along * scale) @ scatter * (along * scale)).sum(axis=1)
            seen &= np.sqrt(np.maximum(variance, 0.0)) <= MAX_SCATTER * depth
        inverse = np.divide(1.0, s, out=np.zeros_like(s), where=seen)
        out = free.T @ vt.T * inverse  # (6, f): from rotated rows to offsets
        spread = out @ spread
        # Twice: the goal was measured as well.
        self._measurement_covariance = 2.0 * TAIL_FACTOR**2 * spread @ spread.T
        rows = min(len(L), len(s))
        self._coupling = np.eye(6) - out[:, :rows] @ u.T[:rows] @ L
        self._unseen_directions = along[~seen]
        # A goal that was worked out is where its pose is. The target of one that this camera has
        # shown may lie elsewhere by now: of it kinematics are asked for the plane's direction, in
        # what features tell little.
        self._is_goal_camera = goal.camera is not None and goal.camera == observation.camera
        self._plane_offset: tuple[float, float] | None = None
        self._doubtful_directions = (
            along[seen & (s < WEAK_DIRECTION * s[0])] if self._is_goal_camera else IDENTITY
        )

    @property
    def has_unseen_directions(self) -> bool:
        """Whether there are directions that nothing measures."""
        return len(self._unseen_directions) > 0

    def bound_uncertainty(
        self,
        observation: Observation,
        offsets: PoseOffsets,
        unseen_motion: np.ndarray | None = None,
        poses: Sequence[AmbiguousPose] = (),
    ) -> PoseUncertainty:
        """What is left open as of an image.

        Args:
            unseen: (6,) motion that the view shows and no feature sees, scaled.
            poses: of which nothing tells that the camera is not there.
        """
        held, part = self._compute_held_offset(observation), self._compute_scatter_part(offsets)
        distance, angle = _compute_bounds(
            offsets.mean,
            offsets.scatter,
            self._measurement_covariance,
            part,
            self._coupling,
            held,
            self._scale,
        )
        distance += REST_MOTION[0] * self._depth + REACTION_TIME * offsets.speed[0]
        angle = angle / self._depth + REST_MOTION[1] + REACTION_TIME * offsets.speed[1]
        words = [self._ambiguity] if self._ambiguity else []
        reason, remedy = "", NO_REMEDY
        if count := len(self._unseen_directions):
            words.append(f"{count} direction{'s' if count > 1 else ''}")
            reason = f"there are {count} motions of the camera that no feature sees, or too little"
            remedy = ADD_FEATURE
        else:
            why, remedy = "by noise and the accuracy of the picture", USE_LARGER_TARGET
            if self._plane_offset is None:  # once: the camera is at rest
                known = self.compute_offset(observation, offsets.mean)
                self._plane_offset = self._compute_plane_offset(observation, known)
            away, tilted = self._plane_offset
            if away > distance or tilted > angle:
                away, tilted = pose_difference(
                    self._goal.world_T_camera, observation.world_T_camera
                )
                distance, angle = distance + away, min(angle + tilted, pi)
                why, remedy = PLANE_REASON, CHECK_CALIBRATION
            if unseen_motion is not None and unseen_motion.any():
                distance += float(np.linalg.norm(unseen_motion[:3]))
                angle += float(np.linalg.norm(unseen_motion[3:])) / self._depth
                why, remedy = "as the view differs by a motion that no feature sees", ADD_FEATURE
            if poses:
                distance += max(pose.distance for pose in poses)
                angle = min(angle + max(pose.angle for pose in poses), pi)
                why, remedy = f"as its points look alike from {len(poses) + 1} poses", ADD_POINTS
            if size := _format_size(distance, angle, self._depth):
                words.append(size)
                reason = (
                    f"{why} the camera may be {1e3 * distance:.2f} mm and "
                    f"{np.degrees(angle):.2f} degrees from its goal"
                )
            remedy = remedy if reason else NO_REMEDY
        if words:
            for way, turn in (self._bound_unseen_motion(), self._symmetry_bound):
                distance, angle = distance + way, min(angle + turn, pi)
        return PoseUncertainty(distance, angle, " and ".join(words), reason, remedy)

    def compute_offset(self, observation: Observation, offset: np.ndarray) -> np.ndarray:
        """(6,) the camera's offset from the goal by features (6,) and kinematics, scaled."""
        return offset * self._scale + self._coupling @ self._compute_held_offset(observation)

    def compute_covariance(self, offsets: PoseOffsets) -> np.ndarray:
        """(6, 6) of that offset."""
        scatter = self._scale[:, None] * offsets.scatter * self._scale
        return self._compute_scatter_part(offsets) * scatter + self._measurement_covariance

    def _compute_plane_offset(
        self, observation: Observation, offset: np.ndarray
    ) -> tuple[float, float]:
        """m and rad that the camera is farther off by where kinematics have the target's plane,
        than by features, (6,) scaled: along the doubtful directions.

        A camera's motion v, w changes the plane p by (p . v) p + p x w, its normal n by n x w.
        """
        plane, pose = self._goal.plane, observation.world_T_camera
        now = None if pose is None else self._goal.compute_plane(pose)
        if now is None or not len(self._doubtful_directions):
            return 0.0, 0.0
        p, now = self._depth * np.array(plane), self._depth * np.array(now)
        moves = np.outer(p, p)
        if self._is_goal_camera:
            p, now, moves = p / np.linalg.norm(p), now / np.linalg.norm(now), np.zeros((3, 3))
        changes = np.hstack([moves, skew(p)]) / self._depth
        rest = now - p - changes @ offset
        by_motion = changes @ self._doubtful_directions.T
        motion = np.linalg.pinv(by_motion, MIN_PLANE_CHANGE) @ rest @ self._doubtful_directions
        return float(np.linalg.norm(motion[:3])), float(np.linalg.norm(motion[3:])) / self._depth

    def _compute_held_offset(self, observation: Observation) -> np.ndarray:
        return split_directions(observation, self._goal, self._modelled, self._ik_solution)[0]

    def _compute_scatter_part(self, offsets: PoseOffsets) -> float:
        """Part of one image's scatter that is left in the mean."""
        return 1.0 / max(offsets.count - 1, 1) + self._systematic_part**2

    def _bound_unseen_motion(self) -> tuple[float, float]:
        """m and rad that the camera may go along directions that nothing measures."""
        if not len(self._unseen_directions):
            return 0.0, 0.0
        way, turn = (
            float(np.linalg.norm(part)) for part in np.split(self._unseen_directions[0], 2)
        )
        if len(self._unseen_directions) > 1 or way > MIN_TRANSLATION_RATIO * turn:
            return inf, pi
        return 2.0 * way * self._depth / turn, pi  # round an axis


def split_directions(
    observation: Observation, goal: Goal, modelled: np.ndarray, ik_solution: IKSolution | None
) -> tuple[np.ndarray, np.ndarray]:
    """The camera's offset (6,) from the goal along the directions that are held, by kinematics, and
    the directions (f, 6) in which the task moves it, scaled; of an arm of few joints those that it
    can move in."""
    if ik_solution is not None and ik_solution.jacobian.shape[1] < 6:
        scale = np.repeat((1.0, goal.distance), 3)
        return np.zeros(6), np.linalg.qr(scale[:, None] * ik_solution.jacobian)[0].T
    here, there = observation.world_T_camera, goal.world_T_camera
    if modelled.all():
        return NO_OFFSET, IDENTITY
    if here is None or there is None:
        return NO_OFFSET, IDENTITY[modelled]
    held, errors, free = compute_held_directions(here, there, modelled, goal.distance)
    return -errors @ held, free


def _estimate_residual_accuracy(
    L: np.ndarray, error: np.ndarray, noise: np.ndarray | float
) -> np.ndarray | None:
    """Accuracy (k, k) of features that declare none, by what no motion explains of their error (k,)
    beyond its noise; None where L (k, 6) explains all."""
    lengths = np.linalg.norm(L, axis=1)
    weights = np.divide(1.0, lengths, out=np.zeros_like(lengths), where=lengths > 0.0)
    u, s, _ = np.linalg.svd(weights[:, None] * L)
    rest = u[:, int((s > RANK_TOLERANCE * s[0]).sum()) :].T
    if not len(rest):
        return None
    noise = NOISE_DEVIATIONS * np.linalg.norm(rest * (weights * noise))
    left = np.linalg.norm(rest @ (weights * error)) ** 2 - noise**2
    return np.diag(lengths * sqrt(left / len(rest))) if left > 0.0 else None


def compute_unexplained_ratio(
    L: np.ndarray, error: np.ndarray, accuracy: np.ndarray, noise: np.ndarray | float = 0.0
) -> float:
    """How many times as large an error (k,) is, beside what a motion explains by L (k, 6) and its
    noise (k,), as the accuracy (k, m) of goal and image lets expect; 0 of no more numbers than L
    has rank."""
    u, s, _ = np.linalg.svd(L)
    rest = u[:, int((s > RANK_TOLERANCE * s[0]).sum()) :].T
    expected = 2.0 * float(((rest @ accuracy) ** 2).sum())
    found = float(((rest @ error) ** 2).sum() - ((rest * noise) ** 2).sum())
    return sqrt(found / expected) if expected > 0.0 and found > 0.0 else 0.0


@jit("f8[:], f8[:,:]")
def compute_confidence_length(mean, covariance):
    """Length that 99.7 % of normally distributed vectors of three numbers do not exceed.

    Their squared length is taken for a scaled chi square of the same mean and variance (P. Patnaik,
    Biometrika 36, 1949), whose quantile is that of E. Wilson and M. Hilferty, 1931.

    Args:
        mean, covariance: (3,), (3, 3).
    """
    square, variance = 0.0, 0.0
    for i in range(3):
        square += mean[i] * mean[i] + covariance[i, i]
        for j in range(3):
            variance += 2.0 * covariance[i, j] ** 2 + 4.0 * mean[i] * covariance[i, j] * mean[j]
    if variance <= 0.0 or square <= 0.0:
        return np.sqrt(max(square, 0.0))
    inverse = variance / (9.0 * square * square)  # 2 / (9 degrees of freedom)
    return np.sqrt(square * (1.0 - inverse + Z_997 * np.sqrt(inverse)) ** 3)


@jit("f8[:], f8[:,:], f8[:,:], f8, f8[:,:], f8[:], f8[:]")
def _compute_bounds(mean, scatter, measured, scatter_part, coupling, held_offset, scale):
    """m (scaled) that an offset's translation and rotation do not exceed.

    Args:
        mean, scatter: (6,), (6, 6) of the offset by images, m and rad.
        measured: (6, 6) covariance of what the accuracy of the features leaves open, scaled.
        part: of the scatter that is left in the mean.
        coupling, held: (6, 6), (6,) of the held directions, scaled.
        scale: (6,).
    """
    known, covariance, factors = np.empty(6), np.empty((6, 6)), np.empty(2)
    for block in range(2):
        square, noise = 0.0, 0.0
        for i in range(3 * block, 3 * block + 3):
            square += mean[i] ** 2
            noise += scatter_part * scatter[i, i]
        # Of an offset that is no more than noise nothing is to be made larger.
        surely = 1.0 - noise / square if noise < square else 0.0
        factors[block] = 1.0 + (OFFSET_FACTORS[block] - 1.0) * surely
    for i in range(6):
        known[i] = factors[i // 3] * mean[i] * scale[i]
        for j in range(6):
            known[i] += coupling[i, j] * held_offset[j]
            covariance[i, j] = scatter_part * scale[i] * scale[j] * scatter[i, j] + measured[i, j]
    return compute_confidence_length(known[:3], covariance[:3, :3]), compute_confidence_length(
        known[3:], covariance[3:, 3:]
    )


def bound_symmetry(ambiguity: str, goal: Goal) -> tuple[float, float]:
    """m and rad that the camera turns and moves round a symmetric target, where it looks the same
    after every `ambiguity`, as '90°'; infinitely far where that says something else."""
    if not ambiguity:
        return 0.0, 0.0
    found = re.match(r"(\d+)°", ambiguity)
    if found is None:
        return inf, pi
    step = radians(float(found[1]))
    turn = step * max(round(pi / step - 0.01), 1)
    turn = min(turn, 2.0 * pi - turn)
    plane = _get_plane(goal)
    x, y = _get_centre(goal)
    place = np.array([x, y, 1.0]) / plane.inverse_depth(x, y)
    normal = np.array(plane) / np.linalg.norm(plane)
    beside = float(np.linalg.norm(np.cross(place, normal)))
    return 2.0 * beside * sin(0.5 * turn), turn


def _get_plane(goal: Goal) -> Plane:
    """The target's plane at the goal."""
    return goal.plane or Plane.fronto_parallel(goal.distance)


def _get_centre(goal: Goal) -> np.ndarray:
    """The target's middle (2,) at the goal, normalised; the optical axis where nobody knows."""
    if goal.moments is not None:
        return np.array([goal.moments.xg, goal.moments.yg])
    for taught in goal.features.values():
        if "points" in taught:
            return np.mean(taught["points"], axis=0)
    return np.zeros(2)


def _format_size(distance: float, angle: float, depth: float = DEFAULT_DEPTH) -> str:
    """'0.4 mm' or '0.5 degrees', the larger part; empty where both are next to nothing."""
    parts = distance / (NEGLIGIBLE_UNCERTAINTY[0] * depth), angle / NEGLIGIBLE_UNCERTAINTY[1]
    if max(parts) <= 1.0:
        return ""
    if parts[0] >= parts[1]:
        return f"{np.ceil(1e4 * distance) / 10.0:g} mm"
    return f"{np.ceil(10.0 * np.degrees(angle)) / 10.0:g} degrees"
