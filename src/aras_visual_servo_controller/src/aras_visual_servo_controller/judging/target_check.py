"""Whether the target moves: a motion of its own, constant or periodic, explains how the features
moved where the camera's motion does not."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aras_visual_servo_base.compiled import compiled
from aras_visual_servo_base.poses import skew
from aras_visual_servo_camera.interaction import point_interaction

from ..goals.goal import Goal
from ..schemes.base import Decision
from ..seeing.observation import Observation


@dataclass(frozen=True, eq=False)
class _Row:
    """What happened within PERIOD; k features, in tolerances.

    moved: (k,) features. L: (k, 6) mean. motion: (6,) of the camera. drift: (k, 6) by which a
    target of the twist 1, at the camera's place of the first row, moves them in that time, world
    axes. stamp: s, of its middle.
    """

    stamp: float
    moved: np.ndarray
    L: np.ndarray
    motion: np.ndarray
    drift: np.ndarray


class _RowSums:
    """Some rows, `together` of them added up each, n numbers in all, in tolerances.

    Attributes:
        moved: (n,) features. parts: (n, 6) by each direction of the camera as it is believed.
        together: how many rows are added up.
    """

    def __init__(
        self, rows: Sequence[_Row], moved: np.ndarray, parts: np.ndarray, together: int
    ) -> None:
        """`moved` (m, k) and `parts` (m, k, 6) of all m rows."""
        count = len(rows) // together * together
        self._rows, self.together = list(rows)[len(rows) - count :], together
        self.moved, self.parts = self._summed(moved[-count:]), self._summed(parts[-count:])

    def _summed(self, values: np.ndarray) -> np.ndarray:
        whole = values.reshape(-1, self.together, *values.shape[1:]).sum(axis=1)
        return whole.reshape(-1, *whole.shape[2:])

    @property
    def mixed(self) -> np.ndarray:
        """(n, 18) by each translation and rotation, if it is one along or about each axis."""
        return self._summed(np.array([_mixed(row) for row in self._rows]))

    @property
    def drift(self) -> np.ndarray:
        """(n, 6) as of a row."""
        return self._summed(np.array([row.drift for row in self._rows]))

    @property
    def stamps(self) -> np.ndarray:
        """(n,) s, from the first on."""
        stamps = np.array([row.stamp for row in self._rows]).reshape(-1, self.together)
        stamps = stamps.mean(axis=1)
        return np.repeat(stamps - stamps[0], len(self._rows[0].moved))

    @property
    def along(self) -> np.ndarray:
        """(n,) by all translations of the camera."""
        return self.parts[:, :3].sum(axis=1)

    @property
    def turned(self) -> np.ndarray:
        """(n,) by all its rotations."""
        return self.parts[:, 3:].sum(axis=1)

    def depth(self) -> float:
        """The factor of the translations that explains the features' motion best."""
        along = self.along
        square = float(along @ along)
        return along @ (self.moved - self.turned) / square if square > 0.0 else 1.0

    def still(self, depth: float) -> np.ndarray:
        """(n,) of the features' motion that a target at rest leaves, with a factor of depth."""
        return self.moved - self.turned - depth * self.along


class TargetCheck:
    """Fits the features' motion by the camera's own and by the target's, over the last SPAN.

    Compared are three explanations, each by what it leaves of the square of the features' motion:

    - a target at rest before a camera as believed, but for one depth;
    - a camera that is not as believed: every direction of translation mixed into every other, and
      of rotation likewise (a mounting, a focal length);
    - a target with a constant twist, or that swings at one frequency besides.

    Measured on the campaign of outcomes (tests/outcomes; 30 images a second, chain and free): a
    target that moves at 10 to 40 mm/s leaves 1e-5 by the third of what is left by the first, one
    that swings by 5 to 20 mm at 0.2 to 0.6 Hz at most 0.035; a wrong mounting or focal length 0.2
    at least, and noise of the picture 0.9.
    """

    PERIOD = 0.12  # s of one row at least
    SPAN = 6.0  # s that are looked at
    LEAST, EVERY = 10, 5  # rows before anything is said, and between two looks
    NUMBERS = 60  # that the rows hold together, at least: 18 factors explain fewer of anything
    # Rows that are added up where one alone shows no motion: a target at 1 mm/s moves by less than
    # the tolerances within PERIOD. A sum has no more noise than a row. FEWER: its numbers.
    # LOUD: tolerances, rms, that the camera's motion has to leave in a row, or in a sum of rows.
    TOGETHER, LOUD, FEWER = (1, 3, 6, 12), (0.3, 0.3, 0.3, 0.15), 12
    SWING = 2.5  # s of rows before a swing is looked for
    LEFT = 0.1  # part of that which the target's motion may leave, at most
    BETTER = 0.5  # part of what another camera leaves that it may leave, at most
    # The factor on the camera's translation that a wrong depth explains, at least. Where features
    # move less than that, no camera explains it: it is the target that the camera follows.
    DEPTH = 0.3
    # Part of the square by which the camera would move the features that they do move at least
    # where another camera is looked for all the same: one that flies elsewhere than it is believed.
    ASTRAY = 0.2
    # The same of a camera, along and about each direction: half as far is another focal length, or
    # a mounting 60 degrees off.
    CAMERA = 0.5
    AS_WELL = 0.02  # part that another camera leaves at most that explains all as well
    FASTEST = 1.5  # Hz of a swing that is looked for
    TOLERANCE = 1e-3  # of the target's centre, normalised, where the scheme has no L of its view

    def __init__(self) -> None:
        self.another_camera = False  # whether at the last look another camera explained all as well
        self._rows: deque[_Row] = deque()
        self._place = np.zeros(3)  # m, world axes: of the velocity of a target's twist
        self._new = 0
        self._moves = ""
        # Error (k,), L (k, 6), rate (k,) or (1,) and tolerances (k,) of the last image.
        self._before: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None = None
        self._begin()

    @property
    def moves(self) -> bool:
        """Whether the target moves, by what was found last."""
        return bool(self._moves)

    def interrupt(self) -> None:
        """An image without measurement: the next one has no predecessor."""
        self._before = None
        self._begin()

    def add(
        self,
        decision: Decision,
        observation: Observation,
        goal: Goal,
        tolerances: np.ndarray,
        viewed: bool,
        angles: np.ndarray | None = None,
    ) -> str:
        """Take in one image; how the target moves, in words, empty where it does not.

        Args:
            tolerances: (k,) of the error.
            viewed: whether the decision's L is that of this view.
            angles: (k,) bool, of components that may wrap; None: all.
        """
        error, L, rate = decision.error, decision.L, decision.rate
        if not viewed or np.shape(L) != (len(error), 6):
            error, L, rate = centre_of(observation, goal)
            tolerances, angles = np.full(len(error), self.TOLERANCE), None
        angles = np.ones(len(error), bool) if angles is None else angles
        rate = np.array(rate, float, ndmin=1)
        now = np.asarray(error, float), np.asarray(L, float), rate, tolerances
        before, self._before = self._before, now
        motion, pose = observation.motion, observation.world_T_camera
        if before is None or motion is None or pose is None or len(before[0]) != len(error):
            self._begin()
            return self._moves
        if not self._images:
            self._moved, self._L = np.zeros(len(error)), np.zeros((len(error), 6))
        dt = observation.dt
        if not len(error) or _followed(
            *before, *now, dt, self._moved, self._L, angles
        ):
            self._begin()
            return self._moves
        self._time += dt
        self._images += 1
        self._motion = self._motion + motion
        if self._time >= self.PERIOD:
            self._row(observation.stamp - 0.5 * self._time, pose)
        return self._moves

    def _begin(self) -> None:
        """A row from this image on."""
        self._time, self._images = 0.0, 0
        self._motion = np.zeros(6)

    def _row(self, stamp: float, pose: np.ndarray) -> None:
        L = self._L / self._images
        rows = self._rows
        if rows and len(rows[-1].moved) != len(self._moved):
            rows.clear()
        if not rows:
            self._place = pose[:3, 3]
        # A target's twist is the camera's against it: v + w x d at the distance d from the place
        # that v is of.
        camera_R_world = pose[:3, :3].T
        along, turned = L[:, :3] @ camera_R_world, L[:, 3:] @ camera_R_world
        drift = -self._time * np.hstack([along, turned - along @ skew(pose[:3, 3] - self._place)])
        rows.append(_Row(stamp, self._moved, L, self._motion, drift))
        while rows[0].stamp < stamp - self.SPAN:
            rows.popleft()
        self._begin()
        self._new += 1
        if len(rows) >= self.LEAST and self._new >= self.EVERY:
            self._new = 0
            self._moves = self._judged()

    def _judged(self) -> str:
        """How the target moves, as text; empty where it is at rest."""
        moved = np.array([row.moved for row in self._rows])
        parts = np.array([row.L for row in self._rows])
        parts = parts * np.array([row.motion for row in self._rows])[:, None, :]
        for together, loud in zip(self.TOGETHER, self.LOUD, strict=True):
            count = len(self._rows) // together * len(self._rows[-1].moved)
            if count < (self.NUMBERS if together == 1 else self.FEWER):
                return ""
            rows = _RowSums(self._rows, moved, parts, together)
            depth = rows.depth()
            still = rows.still(max(depth, self.DEPTH))
            left = float(still @ still)
            if together == 1 and left * self.TOGETHER[-1]**2 < self.LOUD[-1]**2 * count:
                return ""  # sums of n rows are n times as large, at most
            if left >= loud**2 * count:
                if np.linalg.matrix_rank(self._rows[-1].L[:, :3]) < 2:
                    return ""  # one direction alone has no place of a target
                return self._explanation(rows, depth, left)
        return ""

    def _explanation(self, rows: _RowSums, depth: float, left: float) -> str:
        """The motion of a target that explains the square `left`, as text; empty: none does."""
        along, moved = rows.along, rows.moved - rows.turned
        known = np.column_stack([along, rows.drift])
        mixed = np.inf
        part = float(moved @ moved) / max(float(along @ along), 1e-12)
        if depth > self.DEPTH or self.ASTRAY < part < 1.0 / self.ASTRAY:
            mixed = _left_by_camera(rows.mixed, rows.moved, self.CAMERA)
        self.another_camera = mixed < self.AS_WELL * left
        bound = min(self.LEFT * left, self.BETTER * mixed)
        # Of the depth's factor what it has beyond 1: a camera that follows its target at one speed
        # moves nothing in the picture, and no factor of 0 is to explain that.
        constant, velocity = _left(known[:, :4], moved - along)
        if constant < bound:
            return f"it moves at {1e3 * float(np.linalg.norm(velocity[1:])):.1f} mm/s"
        # Sums are few and smooth, which turns and swings explain by half: more is asked of those.
        bound = min(self.LEFT / rows.together**2 * left, bound)
        # Few numbers an image do not tell a turn from a translation.
        known = known if len(self._rows[-1].moved) >= 6 else known[:, :4]
        if _left(known, moved)[0] < bound:
            return "it turns"
        return self._swing(rows.stamps, known, moved, bound)

    def _swing(
        self, time: np.ndarray, known: np.ndarray, moved: np.ndarray, bound: float
    ) -> str:
        """The swing (Hz) that leaves less than the bound of the features' motion (n,), in words.

        Args:
            time: (n,) s. known: (n, m) by which depth and the target's constant twist move them.
        """
        span = time[-1]
        if span < self.SWING:
            return ""
        # What is not the swing's is taken off once: the frequencies share it.
        base = np.linalg.qr(known)[0]
        moved = moved - base @ (base.T @ moved)
        least, found = np.inf, 0.0
        for frequency in np.arange(1.0 / span, self.FASTEST, 0.25 / span):
            phase = 2.0 * np.pi * frequency * time[:, None]
            waves = np.hstack([known[:, 1:4] * np.cos(phase), known[:, 1:4] * np.sin(phase)])
            left, _ = _left(waves - base @ (base.T @ waves), moved)
            if left < least:
                least, found = left, frequency
        return f"it swings at {found:.2f} Hz" if least < bound else ""


def centre_of(observation: Observation, goal: Goal) -> tuple[np.ndarray, np.ndarray, float]:
    """The target's centre (2,) normalised, its L (2, 6), and its rate, by its moments; (0,), (0, 6)
    where they are not known."""
    seen, wanted = observation.moments, goal.moments
    if seen is None or wanted is None or not goal.depth or seen.m00 <= 0.0:
        return np.zeros(0), np.zeros((0, 6)), 0.0
    depth = goal.depth * np.sqrt(wanted.m00 / seen.m00)
    centre = np.array([[seen.xg, seen.yg]])
    return centre[0], point_interaction(centre, np.array([1.0 / depth])), 0.0


@compiled("f8[:], f8[:,:], f8[:], f8[:], f8[:], f8[:,:], f8[:], f8[:], f8, f8[::1], f8[:,::1], "
          "b1[:]", allocates=False)
def _followed(error_before, L_before, rate_before, tolerances_before, error, L, rate, tolerances,
              dt, moved, summed, angles):
    """Add how features moved from one image to the next, and the mean of both L, in tolerances, to
    moved (k,) and summed (k, 6); True where an angle wrapped: by more than any feature moves.

    rate_before, rate: (k,) or (1,); dt: s. angles: (k,) that may wrap.
    """
    wrapped = False
    for i in range(len(error)):
        before, now = error_before[i] / tolerances_before[i], error[i] / tolerances[i]
        wrapped |= angles[i] and abs((now - before) * tolerances[i]) > 1.0
        own = rate_before[min(i, len(rate_before) - 1)] / tolerances_before[i]
        own += rate[min(i, len(rate) - 1)] / tolerances[i]
        moved[i] = moved[i] + now - before - 0.5 * own * dt
        for j in range(6):
            mean = L_before[i, j] / tolerances_before[i] + L[i, j] / tolerances[i]
            summed[i, j] += 0.5 * mean
    return wrapped


def _mixed(row: _Row) -> np.ndarray:
    """(k, 18) by which each translation or rotation of the camera moves the features if it is one
    along or about each axis."""
    return np.hstack([
        (row.L[:, first : first + 3, None] * row.motion[first : first + 3]).reshape(-1, 9)
        for first in (0, 3)
    ])  # fmt: skip


def _left_by_camera(columns: np.ndarray, moved: np.ndarray, least: float) -> float:
    """Square that a camera other than believed leaves of the features' motion (n,).

    A camera that moves, or turns, in any direction moves the features, `least` times as far as
    believed or more: what would explain the motion by less is a target that is followed.

    Args:
        columns: (n, 18), see `_mixed`.
    """
    believed = np.vstack([np.eye(3)] * 2).ravel()
    _, factors = _left(columns, moved - columns @ believed)
    U, scale, Vt = np.linalg.svd((believed + factors).reshape(2, 3, 3))
    mixing = U * np.maximum(scale, least)[:, None, :] @ Vt
    rest = moved - columns @ mixing.ravel()
    return float(rest @ rest)


def _left(columns: np.ndarray, values: np.ndarray) -> tuple[float, np.ndarray]:
    """Square that columns (n, m) leave of values (n,), and their factors (m,), least squares."""
    # A little weight against columns that are all but alike: they have no factor of their own.
    normal = columns.T @ columns
    normal += (1e-9 * np.trace(normal) + 1e-300) * np.eye(len(normal))
    factors = np.linalg.solve(normal, columns.T @ values)
    rest = values - columns @ factors
    return float(rest @ rest), factors
