"""How far the camera still is from its goal: where the errors of the last images would vanish.

An error e = s - s* near the goal is L x, x the camera's way from the goal to here (6,). Noise of
the picture is averaged over images, and as the camera moves under it meanwhile, each error is
brought to where the camera is now: e + L d, with d its motion since, by kinematics. Where the
target moves along, errors scatter less as they were measured, and are taken so.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .recent import RecentErrors

if TYPE_CHECKING:
    from .schemes.base import Decision

# How far the camera may be from where the error vanishes to count as there, m and rad: somewhat
# less than 0.3 mm and 0.3 degrees, as pictures are not exact either. In a direction that changes
# the features little, their tolerances alone may be 6 mm (four points before a plane that was
# turned by 40 degrees).
WITHIN = np.array([2e-4, 3.5e-3])
DEVIATIONS = 2.0  # of the mean, within which it is held to be known
# Images that are averaged where noise hides so little a way, at most; those whose error is within
# so many tolerances: of a motion from afar L knows less.
LONGEST, NEAR = 120, 5.0


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

    def short(self, decision: Decision, count: int, forgiven: float = 1.0) -> str:
        """How far the camera still is from the goal, in words; empty where it is there, or where
        the decision cannot tell.

        Args:
            count: of the latest images, at least; more are taken where they scatter too much.
            forgiven: how many times as far it may be.
        """
        L, task = decision.L, decision.task
        rows = self._seen.errors
        size = rows.shape[1] - 16
        if L is None or task is None or np.shape(L) != (size, 6):
            return ""
        L = np.where(task.modelled, L, 0.0)
        if not np.isfinite(L).all():
            return ""
        answer, limit = np.linalg.pinv(L, rcond=1e-6), forgiven * WITHIN
        errors = _brought_here(rows[:, :size], rows[:, size:].reshape(-1, 4, 4), L, answer)
        count = min(max(count, 1), len(errors))
        while True:
            latest = errors[-count:]
            way = _sizes(answer @ latest.mean(axis=0))
            open_ = _sizes(DEVIATIONS * np.sqrt(answer**2 @ latest.var(axis=0) / count))
            if (open_ <= limit).all() or count == len(errors):
                break
            count = min(2 * count, len(errors))
        if (open_ > limit).any() and len(errors) < LONGEST:
            return (
                "the features are within their tolerances, but scatter: where the camera is, is "
                f"known to {1e3 * open_[0]:.2f} mm and {np.degrees(open_[1]):.2f} degrees"
            )
        if (way <= np.maximum(limit, open_)).all():
            return ""
        return (
            f"the features are within their tolerances, but by L the camera is {1e3 * way[0]:.2f} "
            f"mm and {np.degrees(way[1]):.2f} degrees off"
        )


def _brought_here(
    errors: np.ndarray, poses: np.ndarray, L: np.ndarray, answer: np.ndarray
) -> np.ndarray:
    """Errors (m, k) of cameras at poses (m, 4, 4) as they would be at the last one."""
    last = poses[-1]
    turned = np.swapaxes(poses[:, :3, :3], 1, 2) @ last[:3, :3]  # small: its log is its odd part
    moved = np.column_stack([
        (last[:3, 3] - poses[:, :3, 3]) @ last[:3, :3],
        0.5 * (turned[:, 2, 1] - turned[:, 1, 2]),
        0.5 * (turned[:, 0, 2] - turned[:, 2, 0]),
        0.5 * (turned[:, 1, 0] - turned[:, 0, 1]),
    ])  # fmt: skip
    here = errors + moved @ L.T
    return here if _scatter(here, answer) <= _scatter(errors, answer) else errors


def _scatter(errors: np.ndarray, answer: np.ndarray) -> float:
    """Of the ways that errors (m, k) stand for, in parts of WITHIN; NaN of unknown ones."""
    return float(((_sizes(np.sqrt(answer**2 @ errors.var(axis=0))) / WITHIN) ** 2).sum())


def _sizes(motion: np.ndarray) -> np.ndarray:
    """Length, m, and angle, rad, of a small motion (6,)."""
    return np.array([np.linalg.norm(motion[:3]), np.linalg.norm(motion[3:])])
