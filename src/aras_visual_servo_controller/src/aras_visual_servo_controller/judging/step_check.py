"""How features and target move from one image to the next, compared with L and the camera."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import hypot, sqrt

import numpy as np

from aras_visual_servo_base.compiled import compiled

from ..goals.goal import Goal
from ..schemes.base import Decision
from ..seeing.observation import Observation


@dataclass(frozen=True)
class Jump:
    """A change of the error between two images that the camera's motion does not explain.

    stamp: of the later image, s. feature: its name. size, explained: of the change, and of it by L
    and the camera's motion, in the feature's unit.
    """

    stamp: float
    feature: str
    size: float
    explained: float

    def __str__(self) -> str:
        return (
            f"{self.feature} jumps by {self.size:.2g} at {self.stamp:.2f} s, where L and the "
            f"camera's motion explain {self.explained:.2g}"
        )


class StepCheck:
    """Follows the steps of features and of the visible area from image to image.

    Attributes:
        jumps: of the error, the latest in the last LATELY s.
        first_jump: of the run; None: there was none.
        unchanged: since when the error has been the same to the last bit though the camera has
            moved it by MOVED tolerances or more, s; None: it changes.
        covered: since when a part of the target has been invisible that does not lie beyond the
            image's border, s; None: it is as visible as at the first image.
        drifts: whether the features have moved on steadily while the camera was at rest.
        names: (k,) of the features.
        next: ranges of x and y, normalised, in which the target may be in the next image; None: it
            has not been visible.
        usual: tolerances of a step that are not explained in general.
    """

    LATELY, OFTEN = 2.0, 4  # s, and jumps within that, from which on features jump again and again
    # A jump is of so many tolerances, and so many times what L explains and what is not explained
    # in general.
    LEAST, TIMES = 20.0, 8.0
    REST = 0.9  # part of what was not explained in general that stays so from image to image
    MOVED, SAME = 5.0, 8  # tolerances; images
    # Tolerances by which the camera has to move a feature for its motion to be compared, of which
    # noise is a small part; and rows of that size from which on something is known.
    ROW, ROWS = 8.0, 5
    FEW = 5
    # Tolerances by which the camera's motion may move features before a camera at rest, and by
    # which they drift there at least; part of the squares that a steady drift has (noise has 1/n);
    # images, at least, and for how many of a rest this is looked at.
    RESTS, DRIFT, STEADY, RESTED, LONG = 0.05, 2.5, 0.7, 4, 30
    CENTRE = 0.02  # normalised, by which the target's own centre jumps, at least
    # Part of the area, with the distance by kinematics taken off, that disappears between two
    # images where something is laid over a target, at least, and for FEW images.
    HIDDEN = 0.06
    NEARER = 0.2  # part of its square by which the distance may change between these

    def __init__(self, row: float = ROW) -> None:
        """`row`: tolerances of a row whose motion is compared, see ROW."""
        self._least = row
        self.jumps: deque[Jump] = deque(maxlen=self.OFTEN)
        self.first_jump: Jump | None = None
        self.unchanged: float | None = None
        self.covered: float | None = None
        self.names: tuple[str, ...] = ()
        self._before: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
        self.usual, self._count = 1.0, 0
        self._same, self._since, self._path = 0, 0.0, 0.0
        # Of images before a camera at rest: their number, the sum of the steps' squares and that of
        # the steps (k,), in tolerances.
        self._at_rest: tuple[int, float, np.ndarray | float] = 0, 0.0, 0.0
        self.drifts = False
        self._steps: deque[tuple[float, float, float]] = deque(maxlen=self.FEW)
        self._scale = 1.0  # square of the distance by kinematics at the last image
        self._area = 0.0  # of the last image at the goal's distance, in that of the goal
        # Its mean, and the part by which it differs from that in general.
        self._mean = self._wobble = 0.0
        self._hidden, self._hidden_at = 0, 0.0  # images since a part disappeared, and when, s
        self._whole = 0.0  # the same of the last image before something covered the target
        self.next: tuple[tuple[float, float], tuple[float, float]] | None = None
        self._centre: tuple[float, float] | None = None
        self._centre_jumps = 0
        # (3, k) of whole rows: moved times predicted, and both squared; (2, k) moved and predicted
        # of the row that is not yet whole.
        self._signs: np.ndarray | None = None
        self._row = np.zeros((2, 0))

    def interrupt(self) -> None:
        """An image without measurement: the next one has no predecessor."""
        self._before = None

    @property
    def own(self) -> float:
        """Part of the features' motion in the last FEW images that is not the camera's, 0 to 1."""
        if not self._steps:
            return 0.0
        whole, rest, predicted = (sum(part) for part in zip(*self._steps, strict=True))
        # Beyond what the camera could have done, however it is mounted.
        return rest / whole if whole > max(self.LEAST, self.TIMES * predicted) else 0.0

    @property
    def jumps_often(self) -> bool:
        """Whether the features jump again and again, and the target does not."""
        jumps = self.jumps
        often = len(jumps) == self.OFTEN and jumps[-1].stamp - jumps[0].stamp < self.LATELY
        return often and self._centre_jumps < self.OFTEN // 2

    def jumping(self, stamp: float) -> bool:
        """Whether they have done so until now."""
        return self.jumps_often and stamp - self.jumps[-1].stamp < self.LATELY

    @property
    def contrary(self) -> np.ndarray | None:
        """(k,) correlation of each feature's motion with what L says of it, -1 to 1; 0 where it has
        not moved far. None: nothing is known."""
        if self._signs is None:
            return None
        product, moved, predicted = self._signs
        size = np.sqrt(moved * predicted)
        known = (predicted > self.ROWS * self._least**2) & (moved > 0.0)
        return np.divide(product, size, out=np.zeros(len(size)), where=known)

    @property
    def together(self) -> float:
        """Correlation of all features' motion with what L and the camera say of it, -1 to 1; 1
        where they have not moved far."""
        if not self.moved:
            return 1.0
        product, moved, predicted = self._signs.sum(axis=1)
        if moved == 0.0:
            return 0.0
        return float(product / np.sqrt(moved * predicted))

    @property
    def moved(self) -> bool:
        """Whether the camera has moved the features far enough to say how they go together."""
        return self._signs is not None and self._signs[2].sum() >= self.ROWS * self._least**2

    @property
    def faster(self) -> float:
        """Times as far as L and the camera say that the features have moved in all."""
        if self._signs is None:
            return 1.0
        _, moved, predicted = self._signs.sum(axis=1)
        return float(np.sqrt(moved / max(predicted, 1.0)))

    def add(
        self,
        decision: Decision,
        observation: Observation,
        tolerances: np.ndarray,
        angles: np.ndarray,
    ) -> None:
        """Take in one image; angles: (k,) bool, of components that may wrap."""
        L, error = decision.L, np.asarray(decision.error, float)
        before, self._before = self._before, None
        if L is None or np.shape(L) != (len(error), 6):
            return
        now = error, np.asarray(L, float), np.array(decision.rate, float, ndmin=1)
        self._before, self.names = now, decision.names
        if before is None or observation.motion is None or len(before[0]) != len(error):
            self._since, self._same, self._path = observation.stamp, 0, 0.0
            self._steps.clear()
            return
        sums = self._signs
        if sums is None or sums.shape[1] != len(error):
            sums, self._row = np.zeros((3, len(error))), np.zeros((2, len(error)))
            self._signs = sums
        most, at, explained, moved, left, path, wrapped = _step(
            *before, *now, observation.motion, observation.dt, tolerances, angles, self._least,
            self._row, sums,
        )  # fmt: skip
        if wrapped:
            self._row[:] = 0.0
            return
        if path > self.RESTS:
            self._at_rest = 0, 0.0, 0.0
        elif self._at_rest[0] < self.LONG:
            self._follow_rest(moved, (error - before[0]) / tolerances)
        self._steps.append((moved, left, len(error) * path * path))
        self._count += 1
        if self._count <= self.FEW:
            self.usual = max(self.usual, most)
        elif most > max(self.LEAST, self.TIMES * max(self.usual, explained)):
            change = abs(error[at] - before[0][at])
            jump = Jump(observation.stamp, decision.names[at], change, explained * tolerances[at])
            self.jumps.append(jump)
            self.first_jump = self.first_jump or jump
        else:
            self.usual = self.REST * self.usual + (1.0 - self.REST) * most
        if moved != 0.0:
            self._same, self._path, self._since = 0, 0.0, observation.stamp
            self.unchanged = None
            return
        self._same, self._path = self._same + 1, self._path + path
        if self._same >= self.SAME and self._path > self.MOVED:
            self.unchanged = self._since

    def _follow_rest(self, moved: float, step: np.ndarray) -> None:
        """Sum up the steps (k,), in tolerances, of features before a camera at rest; moved: square
        of the step."""
        images, square, sums = self._at_rest
        images, square, sums = self._at_rest = images + 1, square + moved, sums + step
        length = float(np.linalg.norm(sums))
        steady = length**2 > self.STEADY * images * square
        self.drifts = self.drifts or steady and images >= self.RESTED and length > self.DRIFT

    def follow_area(self, observation: Observation, goal: Goal) -> None:
        """Note what is visible of the target in an image, and whether its centre jumps."""
        seen, desired = observation.moments, goal.moments
        if not observation.valid or seen is None or desired is None or seen.m00 <= 0.0:
            return
        x, y = seen.xg, seen.yg
        dx, dy = (0.0, 0.0) if self._centre is None else (x - self._centre[0], y - self._centre[1])
        self._centre = x, y
        jumped = max(abs(dx), abs(dy)) > self.CENTRE
        # Twice as far on, by the target's size more: where it may be in the next image.
        x, y, size = x + 2.0 * dx, y + 2.0 * dy, sqrt(seen.m00)
        self.next = (x - size, x + size), (y - size, y + size)
        self._centre_jumps = min(self._centre_jumps + 1, self.OFTEN) if jumped else max(
            self._centre_jumps - 1, 0)
        scale = 1.0 / area_by_plane(observation, goal)
        area, nearer = seen.m00 / desired.m00 * scale, abs(scale / self._scale - 1.0)
        last, self._area, self._scale = self._area or area, area, scale
        before = self._mean or area
        if observation.touches or seen.kind != desired.kind or nearer > self.NEARER:
            return
        change = abs(area / before - 1.0)
        if self._hidden:
            if area > (1.0 - 0.5 * self.HIDDEN) * self._whole:
                self._hidden, self.covered = 0, None
                return
            self._hidden += 1
            if self._hidden == self.FEW:
                self.covered = self._hidden_at
        elif max(area / before, area / last) < 1.0 - max(self.HIDDEN, self.TIMES * self._wobble):
            self._hidden, self._hidden_at, self._whole = 1, observation.stamp, before
        else:
            self._wobble = self.REST * self._wobble + (1.0 - self.REST) * change
            self._mean = self.REST * before + (1.0 - self.REST) * area

    @property
    def visible(self) -> float:
        """Part of the target that is visible since something covers it, 0 to 1."""
        return self._area / self._whole if self._whole else 1.0


def area_by_plane(observation: Observation, goal: Goal) -> float:
    """Return the area that the target has in this view, in that of the goal, by its believed plane.

    A small part of a plane n P = d has an image of area d / Z^3 in that of its own; 1 / Z and n / d
    are those of the plane. Without a plane it is the square of the distance that counts.
    """
    seen, desired, plane = observation.moments, goal.moments, observation.plane
    if plane is None or goal.plane is None:
        return distance_by_kinematics(observation.world_T_camera, goal) ** -2
    here, there = (
        max(one.inverse_depth(moments.xg, moments.yg), 1e-9) ** 3 / hypot(one.A, one.B, one.C)
        for one, moments in ((plane, seen), (goal.plane, desired))
    )
    return max(here / there, 1e-9)


def distance_by_kinematics(world_T_camera: np.ndarray | None, goal: Goal) -> float:
    """The target's depth before the camera, in that at the goal, by the joints alone; 1 where the
    goal has no pose."""
    if world_T_camera is None or goal.world_T_camera is None:
        return 1.0
    there = goal.world_T_camera
    target = there[:3, 3] + goal.distance * there[:3, 2]
    depth = float(world_T_camera[:3, 2] @ (target - world_T_camera[:3, 3]))
    return max(depth / goal.distance, 1e-3)


@compiled("f8[:], f8[:,:], f8[:], f8[:], f8[:,:], f8[:], f8[:], f8, f8[:], b1[:], f8, f8[:,::1], "
          "f8[:,::1]", allocates=False)
def _step(error_before, L_before, rate_before, error, L, rate, motion, dt, tolerances, angles,
          least, row, sums):
    """Compare one step of the features with the camera's motion.

    Args:
        error_before, error: (k,); L_before, L: (k, 6); rate_before, rate: (k,) or (1,).
        motion: (6,) of the camera between them; dt: s. tolerances: (k,). angles: (k,) may wrap.
        least: tolerances by which a row is predicted to move a feature, at least.
        row: (2, k) moved and predicted since the last whole row; added to.
        sums: (3, k) of moved times predicted, moved squared, predicted squared, of whole rows;
            added to.

    Returns:
        Most that is not explained, in tolerances; the feature; what L explains of its step; the
        squares of all steps, and of what is not explained, in tolerances; the longest predicted
        step; whether an angle wrapped.
    """
    most, at, explained, square, left, path, longest = -1.0, 0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(len(error)):
        if angles[i] and abs(error[i] - error_before[i]) > 1.0:
            return 0.0, 0, 0.0, 0.0, 0.0, 0.0, True
    for i in range(len(error)):
        predicted = 0.0
        for j in range(6):
            predicted += 0.5 * (L_before[i, j] + L[i, j]) * motion[j]
        own = rate_before[min(i, len(rate_before) - 1)] + rate[min(i, len(rate) - 1)]
        predicted = (predicted + 0.5 * own * dt) / tolerances[i]
        moved = (error[i] - error_before[i]) / tolerances[i]
        rest = abs(moved - predicted)
        if rest > most:
            most, at, explained = rest, i, abs(predicted)
        square += moved * moved
        left += (moved - predicted) ** 2
        path = max(path, abs(predicted))
        row[0, i] += moved
        row[1, i] += predicted
        longest = max(longest, abs(row[1, i]))
    if longest >= least:
        for i in range(len(error)):
            moved, predicted = row[0, i], row[1, i]
            sums[0, i] += moved * predicted
            sums[1, i] += moved * moved
            sums[2, i] += predicted * predicted
            row[0, i] = row[1, i] = 0.0
    return most, at, explained, square, left, path, False
