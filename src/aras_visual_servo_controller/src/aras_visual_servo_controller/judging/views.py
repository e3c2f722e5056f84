"""What belongs to which of several cameras."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ..goals.goal import Goal
from ..schemes.base import Decision
from ..seeing.observation import Observation


def shown(observation: Observation, goal: Goal) -> bool:
    """Whether each camera is the one that has shown its goal."""
    goals = goal.cameras
    return all(name in goals and goals[name].camera == view.camera
               for name, view in observation.cameras.items())  # fmt: skip


def by_camera(
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
