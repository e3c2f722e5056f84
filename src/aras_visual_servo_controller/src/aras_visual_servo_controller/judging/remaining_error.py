"""How far the camera still is from its goal: where the errors of the last images would vanish.

An error e = s - s* near the goal is L x, x the camera's way from the goal to here (6,). Noise of
the picture is averaged over images, and as the camera moves under it meanwhile, each error is
brought to where the camera is now: e + L d, with d its motion since, by kinematics. Where the
target moves along, errors scatter less as they were measured, and are taken so.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from aras_visual_servo_base.compiled import compiled

from ..arm.inversion import svd
from ..seeing.ring_buffer import RecentErrors

if TYPE_CHECKING:
    from ..schemes.base import Decision

# How far the camera may be from where the error vanishes to count as there, m and rad: somewhat
# less than 0.3 mm and 0.3 degrees, as pictures are not exact either. In a direction that changes
# the features little, their tolerances alone may be 6 mm (four points before a plane that was
# turned by 40 degrees).
WITHIN = np.array([2e-4, 3.5e-3])
FORGIVEN = 1.5  # times as far a camera may be that counts as there, as a feature's error may
DEVIATIONS = 2.0  # of the mean, within which it is held to be known
# Images that are averaged where noise hides so little a way, at most; those whose error is within
# so many tolerances (four times what may be noise): of a motion from afar L knows less.
LONGEST, NEAR = 120, 12.0
BLIND = 1e-6  # part of L's greatest singular value below which a direction is not seen


class Standing:
    """Follows a run's images."""

    def __init__(self) -> None:
        self._seen = RecentErrors()

    def clear(self) -> None:
        """Forget what was seen: the loop was interrupted."""
        self._seen.clear()

    def add(self, stamp: float, error: np.ndarray, tolerances: np.ndarray, pose: object) -> None:
        """Note an image's error (k,); pose: world_T_camera (4, 4) at its exposure, or None."""
        if (np.abs(error) > NEAR * np.asarray(tolerances, float)).any():
            self.clear()
            return
        known = np.full(16, np.nan) if pose is None else np.ravel(pose)
        self._seen.add(stamp, np.concatenate([error, known]))
        self._seen.drop(max(len(self._seen) - LONGEST, 0))

    def short(self, decision: Decision, count: int, there: bool = False) -> str:
        """How far the camera still is from the goal, in words; empty where it is there, or where
        the decision cannot tell.

        Args:
            count: of the latest images, at least; more are taken where they scatter too much.
            there: it counts as there, and goes on so within FORGIVEN times as far and what is not
                known: noise would else end it now and then.
        """
        L, task = decision.L, decision.task
        rows = self._seen.errors
        size = rows.shape[1] - 16
        if L is None or task is None or np.shape(L) != (size, 6):
            return ""
        L = np.where(task.modelled, L, 0.0)
        if not np.isfinite(L).all():
            return ""
        u, s, vt = svd(L)
        answer = (vt.T / np.where(s > BLIND * s[0], s, np.inf)) @ u.T
        way, turn, open_way, open_turn, enough = _judged(
            rows, answer, answer @ L, count, WITHIN
        )
        if not (enough or there) and len(rows) < LONGEST:
            return (
                "the features are within their tolerances, but scatter: where the camera is, is "
                f"known to {1e3 * open_way:.2f} mm and {np.degrees(open_turn):.2f} degrees"
            )
        near, straight = WITHIN
        if there:
            near, straight = FORGIVEN * near + open_way, FORGIVEN * straight + open_turn
        if way <= max(near, open_way) and turn <= max(straight, open_turn):
            return ""
        return (
            f"the features are within their tolerances, but by L the camera is {1e3 * way:.2f} "
            f"mm and {np.degrees(turn):.2f} degrees off"
        )


@compiled("f8[:,:], i8, i8")
def _since(rows, i, k):
    """The camera's motion (6,) since image i, in its own frame now; small, so a rotation's vector
    is its odd part. k: where in a row the pose begins."""
    last = rows.shape[0] - 1
    moved, turned = np.empty(6), np.zeros((3, 3))
    for a in range(3):
        moved[a] = 0.0
        for c in range(3):
            moved[a] += rows[last, k + 4 * c + a] * (rows[last, k + 4 * c + 3]
                                                     - rows[i, k + 4 * c + 3])
        for b in range(3):
            for c in range(3):
                turned[a, b] += rows[i, k + 4 * c + a] * rows[last, k + 4 * c + b]
    moved[3] = 0.5 * (turned[2, 1] - turned[1, 2])
    moved[4] = 0.5 * (turned[0, 2] - turned[2, 0])
    moved[5] = 0.5 * (turned[1, 0] - turned[0, 1])
    return moved


@compiled("f8[:,:], f8[:,:], f8[:,:], i8, f8[:]")
def _judged(rows, answer, seen, count, limit):
    """How far the camera is off, and how much of it is not known for noise.

    Args:
        rows: (m, k + 16) errors and poses of images, the last one now.
        answer, seen: (6, k) L^+ and (6, 6) L^+ L.
        count, limit: of the latest images, at least, so many are averaged that less than this,
            (2,) m and rad, is not known.

    Returns:
        m and rad off; m and rad not known; whether that is within the limit.
    """
    m, k = rows.shape[0], answer.shape[1]
    count = min(max(count, 1), m)
    off = np.empty(6)
    while True:
        # Of the ways by the errors as they are, and brought to where the camera is now.
        total, square = np.zeros((2, 6)), np.zeros((2, 6))
        for i in range(m - count, m):
            for a in range(6):
                off[a] = 0.0
                for j in range(k):
                    off[a] += answer[a, j] * rows[i, j]
            moved = _since(rows, i, k)
            for a in range(6):
                here = off[a]
                for b in range(6):
                    here += seen[a, b] * moved[b]
                total[0, a] += off[a]
                total[1, a] += here
                square[0, a] += off[a] * off[a]
                square[1, a] += here * here
        mean = total / count
        spread = np.maximum(square / count - mean * mean, 0.0)
        scatter = np.empty(2)
        for n in range(2):
            scatter[n] = spread[n, :3].sum() / limit[0] ** 2 + spread[n, 3:].sum() / limit[1] ** 2
        n = 1 if scatter[1] <= scatter[0] else 0  # where poses are unknown that is no number
        way, turn = np.sqrt((mean[n, :3] ** 2).sum()), np.sqrt((mean[n, 3:] ** 2).sum())
        unknown = DEVIATIONS * np.sqrt(spread[n] / count)
        open_way = np.sqrt((unknown[:3] ** 2).sum())
        open_turn = np.sqrt((unknown[3:] ** 2).sum())
        enough = open_way <= limit[0] and open_turn <= limit[1]
        if enough or count == m:
            return way, turn, open_way, open_turn, enough
        count = min(2 * count, m)
