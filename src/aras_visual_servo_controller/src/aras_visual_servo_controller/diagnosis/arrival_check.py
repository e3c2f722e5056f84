"""Is the camera at its goal, and how far may it be from it all the same?

An error e = s - s* near the goal is L x, x the camera's offset from the goal (6,). Noise is
averaged over images: as the camera moves meanwhile, each image's offset L^+ e is brought by
kinematics to where the camera is now. Where the target moves along, offsets scatter less as they
were measured, and are taken so.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot, nan
from typing import TYPE_CHECKING

import numpy as np

from aras_visual_servo_base.compiled import jit

from ..goals.goal import DEFAULT_DEPTH
from ..kinematics.algebra import is_task_finite, solve_least_squares, svd
from ..observation.recent_errors import RecentErrors
from ..records.outcomes import ArrivalStatus, PoseUncertainty
from .pose_uncertainty import (
    RANK_TOLERANCE,
    ArrivalMargin,
    PoseOffsets,
    bound_symmetry,
    split_directions,
)
from .view_check import MIN_VIEWS, ViewCheck

if TYPE_CHECKING:
    from ..goals.goal import Goal
    from ..kinematics.ik_solution import IKSolution
    from ..observation.observation import Observation
    from ..schemes.base import JointController, Scheme, SchemeOutput
    from .ambiguous_poses import AmbiguousPoses

# Offset from the goal within which the camera counts as there, parts of the target's depth and rad:
# so much less than PLAIN that it is not exceeded by what L may err (KNOWN). In a direction that
# changes the features little, their tolerances alone may be 6 mm (four points of a plane that was
# turned by 40 degrees).
GOAL_TOLERANCE = (8e-4, 3.5e-3)
HYSTERESIS = 1.5  # times tolerances and offset within which a camera that has arrived stays so
KNOWN_DEVIATIONS = 2.0  # standard deviations of the mean within which it is taken as known
# Errors may scatter about their mean by so many tolerances, rms: more is a motion, not noise.
MAX_SCATTER = 3.0
# With fewer images than FEW each has to be within its tolerances, and there have to be LEAST:
# images that come seldom would else make a mean of a motion.
FEW_IMAGES, MIN_IMAGES = 5, 3
# Largest averaging window, images. An image with a larger error than FAR tolerances (four times
# what may be noise) empties it: the linearisation by L does not hold so far from the goal.
MAX_WINDOW, FAR_TOLERANCES = 120, 12.0
RENEWAL_RATIO = 0.7  # part of the mean error from which on what it leaves open is worked out anew
# Standard deviations by which the latest image's offset may differ from the mean of those brought
# to where the camera is: more, and its motion is not what kinematics say.
OUTLIER_DEVIATIONS = 5.0
NOISE_STEPS = 8  # latest images, at least, whose steps tell how noisy they are
MAX_ROWS = 64  # rows of L from which on the normal equations are solved
VIEW_PERIOD = 8  # images of an arrival, each of which is compared with the goal; then every so many
ALIKE_REASON = "the points look as at the goal from several poses"
OTHER_VIEW_REASON = "every feature is at its goal, but the image is not the goal's"
ROUNDING = 1e-9  # s; rad, and m at a depth of DEPTH


class ArrivalCheck:
    """Judges the mean of the measured error over `hold` seconds; with hysteresis."""

    def __init__(self, hold: float) -> None:
        """`hold`: s; 0: every image is judged by itself."""
        self.hold = float(hold)
        self._errors, self._offsets, self._view_check = RecentErrors(), RecentErrors(), ViewCheck()
        self._ambiguous_poses: AmbiguousPoses | None = None
        self.clear()

    def clear(self) -> None:
        """Forget what was seen: the loop was interrupted."""
        self._errors.clear()
        self._offsets.clear()
        self._view_check.clear()
        self._is_reached = False
        self._margin: ArrivalMargin | None = None
        # the other pose it is at, and those it may be at
        self._other_pose, self._possible_poses = None, ()
        self._wrong_pose_reason, self._unseen_motion, self._images = "", np.zeros(6), 0
        self._error_size = 0.0  # of the mean error that it is of, in tolerances

    def add(
        self,
        scheme_output: SchemeOutput,
        observation: Observation,
        goal: Goal,
        scheme: Scheme | JointController,
        ik_solution: IKSolution | None = None,
    ) -> ArrivalStatus:
        """Take in one image.

        Args:
            resolution: of the decision's task: what the arm can move. None: a camera that is free.
        """
        error, tolerances = scheme_output.error, np.asarray(scheme.tolerances, float)
        if len(self._errors) and self._errors.errors.shape[1] != len(error):
            self.clear()
        self._errors.add(observation.stamp, error)
        free = None if scheme_output.task is None else split_directions(
            observation, goal, scheme_output.task.modelled, ik_solution
        )[1]  # fmt: skip
        self._add_offset(scheme_output, observation, tolerances, free, goal.distance)
        settled, short = self._has_settled(observation.stamp, tolerances), ""
        offsets = None
        if settled and len(self._offsets):
            offsets, short = compute_mean_offset(
                self._offsets.stamps,
                self._offsets.errors,
                _compute_observable(scheme_output, free, goal.distance),
                len(self._errors),
                self._is_reached,
                goal.distance,
            )
        self._view_check.add(observation, goal)
        if not settled or short:
            if self._is_reached:
                self._view_check.clear()
            self._is_reached, self._margin = False, None
            return ArrivalStatus(pending_reason=short)
        if not self._is_reached:  # what was seen on the way is no view of the arrival
            self._images = 0
            self._view_check.retain(max(1 if offsets is None else offsets.count, MIN_VIEWS))
        self._is_reached = True
        if offsets is None:
            way, turn = (
                bound_symmetry(scheme_output.ambiguity, goal)
                if scheme_output.ambiguity
                else (nan, nan)
            )
            return ArrivalStatus(
                True, pose_uncertainty=PoseUncertainty(way, turn, scheme_output.ambiguity)
            )
        return self._evaluate_arrival(
            scheme_output, observation, goal, scheme, ik_solution, offsets
        )

    def _evaluate_arrival(
        self,
        scheme_output: SchemeOutput,
        observation: Observation,
        goal: Goal,
        scheme: Scheme | JointController,
        ik_solution: IKSolution | None,
        offsets: PoseOffsets,
    ) -> ArrivalStatus:
        """What an image leaves open that shows the camera at its goal."""
        tolerances = np.asarray(scheme.tolerances, float)
        errors = self._errors.errors
        size = float(np.linalg.norm(errors.mean(axis=0) / tolerances))
        self._images += 1
        # The nearer the features are to their goals, the more exact they are.
        if self._margin is None or size < RENEWAL_RATIO * self._error_size:
            self._error_size = size
            # Of the images that the offset is of: the accuracy is that of a camera so near.
            latest = errors[-max(offsets.count, MIN_VIEWS) :]
            self._margin = margin = ArrivalMargin(
                scheme_output, observation, goal, latest.mean(axis=0),
                scheme.accuracy(observation, goal), ik_solution,
                latest.std(axis=0) / np.sqrt(len(latest)), offsets.scatter,
            )  # fmt: skip
            if self._ambiguous_poses is None or self._ambiguous_poses.goal is not goal:
                from .ambiguous_poses import AmbiguousPoses

                self._ambiguous_poses = AmbiguousPoses(goal)
            self._other_pose, self._possible_poses = self._ambiguous_poses.find_pose(observation)
            if scheme_output.residual is None:  # what is judged are the features that L is of
                L = scheme_output.L / tolerances[:, None] / np.repeat((1.0, goal.distance), 3)
                self._view_check.set_expected_place(
                    observation, L, margin.compute_covariance(offsets), goal.distance
                )
        if self._images <= VIEW_PERIOD or self._images % VIEW_PERIOD == 0:
            seen = self._offsets.errors[-len(self._view_check) :, :6].mean(axis=0)
            self._compare_views(
                self._margin.compute_offset(observation, seen), scheme_output.ambiguity
            )
        left = self._margin.bound_uncertainty(
            observation, offsets, self._unseen_motion, self._possible_poses
        )
        return ArrivalStatus(True, "", self._wrong_pose_reason, left)

    def _compare_views(self, offset: np.ndarray, ambiguity: str) -> None:
        """Where the camera is elsewhere than at its goal, as text, and what no feature sees.

        known: (6,) its offset by features and kinematics, scaled.
        """
        place, self._unseen_motion = self._view_check.compare_place(offset)
        self._wrong_pose_reason = ""
        if self._other_pose is not None:
            self._wrong_pose_reason = (
                f"{ALIKE_REASON}: the camera is at the one {1e3 * self._other_pose.distance:.1f} "
                "mm and "
                f"{np.degrees(self._other_pose.angle):.1f} degrees from its goal"
            )
        elif place:
            self._wrong_pose_reason = f"{OTHER_VIEW_REASON}: {place}"
        elif not self._margin.has_unseen_directions and self._view_check.has_other_shape(
            bool(ambiguity)
        ):
            self._wrong_pose_reason = f"{OTHER_VIEW_REASON}: the target's outline has another shape"

    def _add_offset(
        self, scheme_output: SchemeOutput, observation: Observation, tolerances: np.ndarray,
        free: np.ndarray | None, depth: float,
    ) -> None:
        """Note where the camera is by this image, if it is near the goal and L tells it."""
        if _is_far(scheme_output.error, tolerances):
            self._offsets.clear()
            return
        offset = compute_offset(scheme_output, free, depth)
        if offset is None:
            self._offsets.clear()
            return
        pose = observation.world_T_camera
        known = np.full(16, np.nan) if pose is None else np.ravel(pose)
        self._offsets.add(observation.stamp, np.concatenate([offset, known]))
        self._offsets.drop_oldest(max(len(self._offsets) - MAX_WINDOW, 0))

    def _has_settled(self, stamp: float, tolerances: np.ndarray) -> bool:
        """Whether the mean error of the last `hold` seconds is within the tolerances (k,)."""
        seen = self._errors
        # One image at or before the window's beginning stays, to know that it is full.
        before = int(np.searchsorted(seen.stamps, stamp - self.hold + ROUNDING, "right"))
        least = MIN_IMAGES if self.hold > 0.0 else 1
        seen.drop_oldest(max(min(before - 1, len(seen) - least), 0))
        if len(seen) < least or stamp - seen.stamps[0] < self.hold - ROUNDING:
            return False
        limit = tolerances * (HYSTERESIS if self._is_reached else 1.0)
        if not _is_within(seen.errors, limit):
            return False
        return len(seen) >= FEW_IMAGES or bool((np.abs(seen.errors) < limit).all())


def compute_mean_offset(
    stamps: np.ndarray,
    rows: np.ndarray,
    observable: np.ndarray,
    settled_images: int,
    was_reached: bool,
    depth: float = DEFAULT_DEPTH,
) -> tuple[PoseOffsets, str]:
    """How far the camera is from its goal, averaged over images, and why that is too much.

    Args:
        stamps: (m,) of images, s. rows: (m, 22) of each its offset L^+ e (6,) in the camera's
            frame, m and rad, and its `world_T_camera` (16,); NaN where that is unknown.
        seen: L^+ L (6, 6), the part of a motion that changes the offsets.
        settled: number of images for which the features have settled.
        reached: whether the camera was at its goal by the image before.
        depth: of the target at the goal, m.

    Returns:
        The mean offset, as of the last image; a sentence, empty where it is small enough.
    """
    near = GOAL_TOLERANCE[0] * depth, GOAL_TOLERANCE[1]
    mean, scatter, count, enough = _average_offsets(
        rows, observable, min(settled_images, FEW_IMAGES), np.array(near) / KNOWN_DEVIATIONS
    )
    latest, noise = rows[-1, :6], _estimate_noise(rows[-max(count, NOISE_STEPS) :, :6], depth)
    if (np.abs(latest - mean) > OUTLIER_DEVIATIONS * noise).any():
        mean, scatter, count = latest, np.diag(noise**2), 1
    off = _compute_lengths(mean.tolist())
    # Rounding may leave less than nothing of a variance.
    deviations = np.sqrt(np.maximum(np.diag(scatter), 0.0) / count)
    unknown = _compute_lengths((KNOWN_DEVIATIONS * deviations).tolist())
    offsets = PoseOffsets(mean, scatter, count, compute_speed(stamps, rows))
    if not (enough or was_reached) and len(rows) < MAX_WINDOW:
        return offsets, (
            "the features are within their tolerances, but scatter: where the camera is, is "
            f"known to {1e3 * unknown[0]:.2f} mm and {np.degrees(unknown[1]):.2f} degrees"
        )
    limits = [HYSTERESIS * a + u if was_reached else max(a, u) for a, u in zip(
        near, unknown, strict=True
    )]  # fmt: skip
    if off[0] <= limits[0] and off[1] <= limits[1]:
        return _estimate_offset(offsets, rows, observable, settled_images, noise), ""
    return offsets, (
        f"the features are within their tolerances, but by L the camera is {1e3 * off[0]:.2f} "
        f"mm and {np.degrees(off[1]):.2f} degrees off"
    )


def _estimate_offset(
    offsets: PoseOffsets, rows: np.ndarray, seen: np.ndarray, settled: int, noise: np.ndarray
) -> PoseOffsets:
    """The offset of a camera that has arrived by all images for which the features have settled,
    where that is known better than by the latest ones: on the way there it scatters more."""
    mean, scatter, count, _ = _average_offsets(rows, seen, settled, np.full(2, np.inf))
    told, by_all = np.diag(offsets.scatter) / offsets.count, np.diag(scatter) / count
    if count <= offsets.count or (np.abs(rows[-1,
        :6] - mean) > OUTLIER_DEVIATIONS * noise).any() or not all(
        by_all[part].sum() < told[part].sum() for part in (slice(0, 3), slice(3, 6))
    ):  # fmt: skip
        return offsets
    return offsets._replace(mean=mean, scatter=scatter, count=count)


def compute_speed(stamps: np.ndarray, rows: np.ndarray) -> tuple[float, float]:
    """The camera's speed towards or from its goal before the last image, m/s and rad/s: the less
    of what kinematics (a target may move along) and images (in which noise moves) say of it.

    stamps, rows: as of `compute_mean_offset`.
    """
    if len(rows) < 2 or stamps[-1] <= stamps[-2]:
        return 0.0, 0.0
    seen = _compute_lengths((rows[-1, :6] - rows[-2, :6]).tolist())
    # no numbers where poses are unknown
    moved = _compute_lengths(_compute_motion_since(rows, len(rows) - 2).tolist())
    past = stamps[-1] - stamps[-2]
    return tuple(float(np.fmin(*pair)) / past for pair in zip(seen, moved, strict=True))


def _estimate_noise(offsets: np.ndarray, depth: float = DEFAULT_DEPTH) -> np.ndarray:
    """Standard deviation (6,) of offsets (m, 6), by their steps from image to image, or better by
    how these differ, which a slow motion changes little."""
    order = 2 if len(offsets) > 2 else 1
    steps = np.diff(offsets, n=order, axis=0)
    variance = (steps**2).sum(axis=0) / max(len(steps), 1) / (2.0, 6.0)[order - 1]
    return np.sqrt(variance) + ROUNDING * np.repeat((depth / DEFAULT_DEPTH, 1.0), 3)


def compute_offset(
    scheme_output: SchemeOutput, free: np.ndarray | None, depth: float
) -> np.ndarray | None:
    """L^+ e (6,), the camera's offset from the goal by one image, in the directions (f, 6) in which
    the task moves it; None where the decision has no L of its error."""
    L = scheme_output.L
    error = scheme_output.error if scheme_output.residual is None else scheme_output.residual
    if L is None or free is None or np.shape(L) != (len(error), 6):
        return None
    L, error = np.asarray(L, float), np.asarray(error, float)
    if not is_task_finite(L, error):
        return None
    scale = np.array((1.0, 1.0, 1.0, depth, depth, depth))
    moved, blind = (L / scale) @ free.T, RANK_TOLERANCE
    if len(L) > MAX_ROWS:
        moved, error, blind = moved.T @ moved, moved.T @ error, RANK_TOLERANCE**2
    return solve_least_squares(moved, error, blind) @ free / scale


def _compute_observable(scheme_output: SchemeOutput, free: np.ndarray, depth: float) -> np.ndarray:
    """What a motion (6,) of the camera changes of its offset, (6, 6)."""
    scale = np.repeat((1.0, depth), 3)
    L = np.asarray(scheme_output.L, float) / scale
    moved, blind = L @ free.T, RANK_TOLERANCE
    if len(L) > MAX_ROWS:
        L, moved, blind = moved.T @ L, moved.T @ moved, RANK_TOLERANCE**2
    u, s, vt = svd(moved)
    seen = s > blind * s[0]
    inverse = vt[seen].T / s[seen] @ u[:, seen].T
    return free.T @ inverse @ L * scale / scale[:, None]


def _compute_lengths(offset: Sequence[float]) -> tuple[float, float]:
    """Lengths of an offset's translation and rotation, m and rad."""
    return hypot(*offset[:3]), hypot(*offset[3:])


@jit("f8[:], f8[:]")
def _is_far(error, tolerances):
    """Whether a component of the error (k,) is beyond FAR tolerances (k,)."""
    far = False
    for i in range(len(error)):
        far |= abs(error[i]) > FAR_TOLERANCES * tolerances[i]
    return far


@jit("f8[:,:], f8[:]")
def _is_within(errors, limit):
    """Whether errors (m, k) have means within the limits (k,) and scatter little about them."""
    count = errors.shape[0]
    for k in range(errors.shape[1]):
        mean, square = 0.0, 0.0
        for i in range(count):
            mean += errors[i, k]
        mean /= count
        for i in range(count):
            square += (errors[i, k] - mean) ** 2
        if not (abs(mean) < limit[k] and square / count < (MAX_SCATTER * limit[k]) ** 2):
            return False
    return True


@jit("f8[:,:], i8")
def _compute_motion_since(rows, i):
    """The camera's motion (6,) since image i, in its own frame now; small, so a rotation's vector
    is its odd part. rows: (m, 22) offsets and poses."""
    last, k = rows.shape[0] - 1, 6
    moved, turned = np.empty(6), np.zeros((3, 3))
    for a in range(3):
        moved[a] = 0.0
        for c in range(3):
            moved[a] += rows[last, k + 4 * c + a] * (
                rows[last, k + 4 * c + 3] - rows[i, k + 4 * c + 3]
            )
        for b in range(3):
            for c in range(3):
                turned[a, b] += rows[i, k + 4 * c + a] * rows[last, k + 4 * c + b]
    moved[3] = 0.5 * (turned[2, 1] - turned[1, 2])
    moved[4] = 0.5 * (turned[0, 2] - turned[2, 0])
    moved[5] = 0.5 * (turned[1, 0] - turned[0, 1])
    return moved


@jit("f8[:,:], f8[:,:], i8, f8[:]")
def _average_offsets(rows, observable, count, limit):
    """The mean offset of the latest images, brought to where the camera is now.

    Args:
        rows: (m, 22) offsets and poses of images, the last one now.
        seen: (6, 6) part of a motion that changes the offsets, L^+ L.
        count: of the latest images, at least; more are taken until their mean's standard deviation
            is at most the limit (2,), m and rad.

    Returns:
        (6,) the mean; (6, 6) the offsets' covariance; how many they are; whether the deviation of
        the mean is within the limit.
    """
    m = rows.shape[0]
    count = min(max(count, 1), m)
    while True:
        # Of the offsets as they were measured, and brought to where the camera is now.
        total, square = np.zeros((2, 6)), np.zeros((2, 6, 6))
        off = np.empty((2, 6))
        for i in range(m - count, m):
            moved = _compute_motion_since(rows, i)
            for a in range(6):
                off[0, a] = off[1, a] = rows[i, a]
                for b in range(6):
                    off[1, a] += observable[a, b] * moved[b]
            for n in range(2):
                for a in range(6):
                    total[n, a] += off[n, a]
                    for b in range(6):
                        square[n, a, b] += off[n, a] * off[n, b]
        scatter, variances = np.empty(2), np.zeros((2, 2))
        for n in range(2):
            for a in range(6):
                mean = total[n, a] / count
                variances[n, a // 3] += max(square[n, a, a] / count - mean * mean, 0.0) / count
            scatter[n] = variances[n, 0] / limit[0] ** 2 + variances[n, 1] / limit[1] ** 2
        n = 1 if scatter[1] <= scatter[0] else 0  # where poses are unknown that is no number
        enough = variances[n, 0] <= limit[0] ** 2 and variances[n, 1] <= limit[1] ** 2
        if enough or count == m:
            mean, scattered = total[n] / count, square[n] / count
            for a in range(6):
                for b in range(6):
                    scattered[a, b] -= mean[a] * mean[b]
            return mean, scattered, count, enough
        count = min(2 * count, m)
