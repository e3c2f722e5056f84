"""The target moves by itself."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ...records.outcomes import Outcome, outcome
from ...records.run_record import ImageRecord
from ...records.state import CONVERGED
from ...schemes.base import Decision
from ...seeing.observation import Observation
from ..base import DIAGNOSES, RunDiagnosis
from ..camera_check import CameraCheck
from ..evidence import Evidence, both


@DIAGNOSES.register("target_moves")
class TargetMoves(RunDiagnosis):
    """The features move as the camera's motion and one of the target's say; see TargetCheck."""

    help = "the target moves while it is servoed on"
    reads = "motion of the features, L, motion of the camera (`target_check.py`)"
    kinds = ("target_moves", "wrong_camera_model")

    # Part of the features' last motion from which on it is the target's, and s for which the camera
    # is not judged by what comes after it.
    OWN, RUNS_ON = 0.5, 1.0

    def __init__(self) -> None:
        self._ran_away = -np.inf  # when the target moved faster than any camera could, s

    def judge(self, record: ImageRecord, evidence: Evidence) -> Outcome | None:
        """See RunDiagnosis.judge; takes the image into the checks of cameras and gain."""
        state, observation, run = record.state, record.observation, evidence.run
        if evidence.motion.targets_own > self.OWN:
            self._ran_away = state.stamp
        evidence.is_running_away = state.stamp - self._ran_away < self.RUNS_ON
        if evidence.moves:
            evidence.cameras.clear()  # what they saw was the target's doing
        elif getattr(run.scheme, "judges_camera", True):
            for name, part, tolerated, wrap in by_camera(
                state.decision, observation, evidence.tolerances, evidence.angles
            ):
                check = evidence.cameras.get(name)
                if check is None:
                    check = evidence.cameras[name] = CameraCheck(run.jacobian)
                check.add(part, observation, tolerated, wrap)
        evidence.swings = evidence.gain.add(state.stamp, evidence.error, run.scheme, record.age)
        evidence.is_fast = evidence.gain.swings_fast(state.stamp)
        if not evidence.moves or state.phase == CONVERGED or evidence.is_fast:
            return None
        if evidence.target.another_camera and (fault := evidence.contrary()):
            return evidence.mistaken(fault)
        found = outcome(
            "target_moves", "the features move as the camera's motion and a motion of the "
            f"target's own say: {evidence.moves}",
        )  # fmt: skip
        swings = evidence.swings or evidence.gain.hasty
        return evidence.covered(found if swings is None else both(found, swings))


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
