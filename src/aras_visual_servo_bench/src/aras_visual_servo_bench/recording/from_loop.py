"""Collects a run while it goes on, and makes arrays of it at the end."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from aras_visual_servo_controller.loop.state import ServoState

from ..plants import Plant
from .run import Details, Run


class History:
    """What was answered to each image, and where the plant was at each joint state."""

    def __init__(self, joints: int) -> None:
        """`joints`: how many there are."""
        self._unknown = np.full(joints, np.nan)
        self._states: list[tuple[ServoState, np.ndarray]] = []
        self._stamps: list[float] = []
        self._joints: list[tuple[np.ndarray, ...]] = []
        self._asked = self._unknown

    def image(self, state: ServoState, pose: np.ndarray) -> None:
        """One answered image; pose: the true one then."""
        self._states.append((state, pose))

    def commanded(self, values: np.ndarray) -> None:
        """What was sent last, (n,)."""
        self._asked = values

    def joints(
        self,
        stamp: float,
        measured: tuple[np.ndarray, np.ndarray],
        true: tuple[np.ndarray, np.ndarray],
    ) -> None:
        """One joint state, after the latest command.

        measured, true: positions and velocities (n,) that it tells, and of the plant when it came.
        """
        self._stamps.append(stamp)
        self._joints.append((*measured, *true, self._asked))

    def run(self, plant: Plant, **known: Any) -> Run:
        """The arrays, with the poses of this plant; `known`: the fields that are not collected."""
        states = [state for state, _ in self._states]
        decisions = [state.decision for state in states]
        names = next((tuple(d.names) for d in decisions if d is not None), ())
        count, joints = len(names), len(self._unknown)

        def rows(values: list, width: int) -> np.ndarray:
            empty = np.full(width, np.nan)
            known = [empty if value is None else value for value in values]
            return np.array(known, float).reshape(len(values), width)

        def of(attribute: str) -> np.ndarray:
            return rows(
                [
                    getattr(d, attribute) if d is not None and len(d.names) == count else None
                    for d in decisions
                ],
                count,
            )

        smallest = [s.singular_values_L[-1] if len(s.singular_values_L) else np.nan for s in states]
        return Run(
            stamp=np.array([state.stamp for state in states]),
            names=names,
            features=of("features"),
            desired=of("desired"),
            error=of("error"),
            asked=rows([state.twist for state in states], 6),
            achieved=rows([state.achieved for state in states], 6),
            pose=np.array([pose for _, pose in self._states]).reshape(-1, 4, 4),
            joints=rows([s.joints.positions if s.joints else None for s in states], joints),
            phases=tuple(state.phase for state in states),
            outcomes=tuple(state.outcome for state in states),
            reasons=tuple(state.reason for state in states),
            rank=np.array([state.rank for state in states], int),
            smallest=np.array(smallest, float),
            joint_stamp=np.array(self._stamps),
            measured=rows([row[0] for row in self._joints], joints),
            measured_speed=rows([row[1] for row in self._joints], joints),
            true_joints=rows([row[2] for row in self._joints], joints),
            true_speed=rows([row[3] for row in self._joints], joints),
            commanded=rows([row[4] for row in self._joints], joints),
            true_pose=plant.poses(np.array([row[2] for row in self._joints])),
            **known,
        )

    def details(self) -> Details:
        """What the loop worked out for the images besides; costs two decompositions an image."""
        states = [state for state, _ in self._states]
        decisions = [state.decision for state in states]
        found = [state.resolution for state in states]
        judged = [None if d is None else d.filtered_error if d.filtered_error is not None
                  else d.error for d in decisions]  # fmt: skip
        return Details(
            filtered=padded(judged),
            singular_L=padded(state.singular_values_L for state in states),
            singular_LJ=padded(None if r is None else r.singular_values for r in found),
            manipulability=_numbers(r and r.manipulability for r in found),
            scale=_numbers(r and r.scale for r in found),
            computing=_numbers(s.computing or None for s in states),
        )


def padded(values: Iterable[Sequence[float] | None]) -> np.ndarray:
    """Rows of different lengths as one array (n, longest), NaN where there is nothing."""
    rows = [np.zeros(0) if row is None else np.asarray(row, float) for row in values]
    table = np.full((len(rows), max((len(row) for row in rows), default=0)), np.nan)
    for i, row in enumerate(rows):
        table[i, : len(row)] = row
    return table


def _numbers(values: Iterable[float | None]) -> np.ndarray:
    return np.array([np.nan if value is None else value for value in values], float)
