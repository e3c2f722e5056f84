"""What a run leaves: arrays of what was seen, decided and true, and what it came to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aras_visual_servo_controller.arm.poses import pose_difference

REACHED, MISSED = "goal_reached", "goal_missed"
SETTLED = 0.02  # part of the way at the start


@dataclass(frozen=True)
class Verdict:
    """What the physics knows of the end: word, and how far the camera is from its goal, m, rad."""

    word: str
    distance: float
    angle: float

    @property
    def reached(self) -> bool:
        """Whether the camera stands where the goal is."""
        return self.word == REACHED

    @classmethod
    def of(cls, goal: np.ndarray, pose: np.ndarray, reached: tuple[float, float]) -> Verdict:
        """Of two poses (4, 4), world_T_camera; `reached`: m and rad that count as there."""
        distance, angle = pose_difference(goal, pose)
        there = distance <= reached[0] and angle <= reached[1]
        return cls(REACHED if there else MISSED, distance, angle)


@dataclass(frozen=True, eq=False)
class Details:
    """What the loop worked out for each of n images besides; NaN where it did not.

    Attributes:
        filtered: (n, k) errors behind the scheme's filter; as measured where it has none.
        singular_L: (n, p) singular values of L in its modelled directions, largest first.
        singular_LJ: (n, q) of the task's Jacobian L J.
        manipulability: (n,) product of the singular values of L J.
        scale: (n,) 1, or the factor by which the task was slowed for limits.
        computing: (n,) s that the scheme took.
    """

    filtered: np.ndarray
    singular_L: np.ndarray
    singular_LJ: np.ndarray
    manipulability: np.ndarray
    scale: np.ndarray
    computing: np.ndarray

    @classmethod
    def unknown(cls, run: Run) -> Details:
        """Of a run of which no more is known than its arrays."""
        none = np.full(len(run.stamp), np.nan)
        return cls(run.error, run.smallest[:, None], none[:, None], none, none, none)


@dataclass(frozen=True, eq=False)
class Run:
    """A run as arrays; n images were answered, m joint states came.

    Attributes:
        stamp: (n,) exposures, s; the physics' clock.
        names: of the k features.
        features, desired, error: (n, k) s, s* and s - s* as measured; NaN where none.
        asked, achieved: (n, 6) twists of the camera in its own frame, m/s and rad/s.
        pose: (n, 4, 4) true world_T_camera when each image's answer was given.
        joints: (n, j) as the controller had them at the exposures.
        phases, outcomes, reasons: n words of the loop.
        rank: (n,) of the task; -1 where none. smallest: (n,) least singular value.
        joint_names: j names.
        joint_stamp: (m,) s. measured, measured_speed: (m, j) what the joint states say, rad, m, /s.
        commanded: (m, j) the latest command at each joint state; NaN before the first.
        true_joints, true_speed: (m, j) of the plant when each came: with physics a step later, for
            joint states are taken before the step that they are sent in. true_pose: (m, 4, 4)
            world_T_camera then.
        goal_pose: (4, 4) where the camera ought to be at the end.
        outcome, reason, mend: of the whole run, as the loop gives them.
        verdict: what the physics knows.
        peak_speed: (j,) greatest speed at any step, or None where it was not traced.
    """

    stamp: np.ndarray
    names: tuple[str, ...]
    features: np.ndarray
    desired: np.ndarray
    error: np.ndarray
    asked: np.ndarray
    achieved: np.ndarray
    pose: np.ndarray
    joints: np.ndarray
    phases: tuple[str, ...]
    outcomes: tuple[str, ...]
    reasons: tuple[str, ...]
    rank: np.ndarray
    smallest: np.ndarray
    joint_names: tuple[str, ...]
    joint_stamp: np.ndarray
    measured: np.ndarray
    measured_speed: np.ndarray
    true_joints: np.ndarray
    true_speed: np.ndarray
    commanded: np.ndarray
    true_pose: np.ndarray
    goal_pose: np.ndarray
    outcome: str
    reason: str
    mend: str
    verdict: Verdict
    peak_speed: np.ndarray | None = None

    @property
    def converged(self) -> bool:
        """Whether the loop holds that it has reached its goal."""
        return self.outcome.startswith("converged")

    @property
    def servoing(self) -> np.ndarray:
        """(m,) bool, joint states since the first image."""
        return self.joint_stamp >= (self.stamp[0] if len(self.stamp) else np.inf)

    def commanded_speed(self) -> np.ndarray:
        """Greatest speed (j,) at which position commands moved, rad/s or m/s."""
        moved = np.diff(self.commanded, axis=0) / np.diff(self.joint_stamp)[:, None]
        known = moved[np.isfinite(moved).all(axis=1)]
        return np.abs(known).max(axis=0, initial=0.0)

    def way(self) -> tuple[np.ndarray, np.ndarray]:
        """Distance (m,) m and angle (m,) rad of the true camera from its goal, at joint_stamp."""
        pairs = [pose_difference(self.goal_pose, pose) for pose in self.true_pose]
        distance, angle = np.array(pairs).reshape(-1, 2).T
        return distance, angle

    def settled(self, floor: tuple[float, float] = (1e-4, 1.745e-3)) -> float:
        """From the first image until the camera stays within 2 % of its first way, s; inf: never.

        floor: m and rad (0.1 mm, 0.1 degrees) that count as there however short the way was.
        """
        after = self.servoing
        if not after.any():
            return float("inf")
        latest = 0.0
        for way, least in zip(self.way(), floor, strict=True):
            latest = max(latest, _settling(self.joint_stamp[after], way[after], least))
        return latest

    def feature_settling(self) -> dict[str, float]:
        """From the first image until each |error| stays within 2 % of its first, s; inf: never."""
        return {
            name: _settling(self.stamp, np.abs(self.error[:, i]))
            for i, name in enumerate(self.names)
        }


def _settling(stamp: np.ndarray, values: np.ndarray, floor: float = 0.0) -> float:
    """From stamp[0] until values (n,) stay within 2 % of the first or `floor`, s; inf: never."""
    known = np.isfinite(values)
    stamp, values = stamp[known], values[known]
    if not len(values):
        return float("inf")
    above = np.flatnonzero(values > max(SETTLED * values[0], floor))
    if not above.size:
        return 0.0
    after = int(above[-1]) + 1
    return float(stamp[after] - stamp[0]) if after < len(stamp) else float("inf")
