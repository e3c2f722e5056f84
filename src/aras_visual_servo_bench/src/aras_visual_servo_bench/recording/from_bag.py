"""A run of messages, of a bag or heard on a graph: parsed into the loop's own records."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from aras_visual_servo_camera.errors import CalibrationError
from aras_visual_servo_camera.moments import Moments
from aras_visual_servo_camera.undistortion import CameraModel
from aras_visual_servo_controller.arm import Arm
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.records.state import APPROACHING, ServoState
from aras_visual_servo_controller.ros.read_back import state_of
from aras_visual_servo_controller.seeing.observation import CAMERA

from ..errors import BenchError
from ..targets.geometry import BoxesTarget, PlacedTarget
from .described import Described
from .film import chosen, film, with_pictures
from .from_graph import Heard
from .from_loop import joint_units
from .run import CameraRecord, Run, Verdict
from .tracks import milestones, nearest

SERVOED = ("servoing", "converged", "holding", "stopped")


class Messages:
    """Messages as a run."""

    def __init__(self, read: Heard) -> None:
        self._read = read

    def run(self, name: str) -> Run:
        """The run; BenchError where nothing was servoed on."""
        read = self._read
        every = [state_of(m, read.reports.get(m.header.stamp.to_nsec())) for m in read.states]
        runs = _runs(every)
        if not runs:
            raise BenchError(
                f"{read.path} holds no image that was servoed on: the controller was "
                + (f"{every[-1].phase}: {every[-1].reason}".rstrip(": ") if every
                   else "never heard")
            )  # fmt: skip
        states = runs[-1]
        told = Described.of(read.described)
        notes, arm, goal = told.notes, told.arm, told.goal
        notes += read.notes
        if len(runs) > 1:
            notes.append(f"the bag holds {len(runs)} runs: the arm went to its start, or another "
                         "scheme began, between them; this is the last")  # fmt: skip
        if not any(state.outcome for state in states):
            notes.append("the bag holds no diagnosis: outcome and achieved twist are unknown")
        joint_names = tuple(read.states[-1].joint_names)
        joint_stamp, measured, speed = self._measured(joint_names)
        if not len(joint_stamp):
            notes.append(f"the bag holds no joint states of {', '.join(joint_names)}")
        poses = self._camera_poses(joint_stamp, measured, arm, joint_names, notes)
        stamp = np.array([state.stamp for state in states])
        at = np.searchsorted(joint_stamp, stamp).clip(0, max(len(joint_stamp) - 1, 0))
        goal_pose = np.full((4, 4), np.nan)
        if goal is not None and goal.world_T_camera is not None:
            goal_pose = np.array(goal.world_T_camera)
        last = next((s for s in reversed(states) if s.outcome), states[-1])
        lower, upper, greatest = told.limits()
        if not read.stamps:
            notes.append("the bag holds no pictures")
        exposed, arrived = (np.array([row[i] for row in read.stamps]) for i in range(2))
        run = Run(
            name=name, source=str(read.path), states=tuple(states),
            pose=poses[at] if len(poses) else np.full((len(stamp), 4, 4), np.nan),
            joint_names=joint_names, joint_stamp=joint_stamp, measured=measured,
            measured_speed=speed,
            commanded=_commanded(states, joint_stamp, len(joint_names)), true_pose=poses,
            goal_pose=goal_pose, outcome=last.outcome or last.phase, reason=last.reason,
            remedy=last.remedy, verdict=_verdict(goal, poses), limits=(lower, upper),
            speed=greatest, joint_units=joint_units(arm) if arm is not None else (),
            cameras={CAMERA: CameraRecord(self._camera(), exposed, arrived)},
            target=_target(goal), goal=goal, pace=np.array(read.pace).reshape(-1, 2),
            settings={"scheme": states[0].scheme, **told.words()},
            versions=told.given.get("versions", {}), notes=notes, yaml=told.text(),
        )  # fmt: skip
        units, tolerances = told.features(states[0].scheme, len(run.names))
        if arm is not None and arm.names == joint_names:
            run.arm_places = arm.places(measured)
        run = replace(run, units=units, tolerances=tolerances, centres=self._centres(stamp))
        return self._with_pictures(run, exposed)

    def _with_pictures(self, run: Run, exposed: np.ndarray) -> Run:
        """The run with its milestones' pictures and its film, read in one pass; `exposed`: (p,)."""
        if not len(exposed):
            return run
        shown = set(exposed[nearest(exposed, np.array(milestones(run)))].tolist())
        filmed = set(chosen(exposed[exposed <= run.stamp[-1] + 1e-6], run.began).tolist())
        kept: list[tuple[float, np.ndarray]] = []

        def passing() -> Iterator[tuple[float, np.ndarray]]:
            for stamp, picture in self._read.pictures(sorted(shown | filmed)):
                if stamp in shown:
                    kept.append((stamp, picture))
                if stamp in filmed:
                    yield stamp, picture

        frames = film(passing(), len(filmed))
        return with_pictures(run, kept, frames)

    def _camera(self) -> CameraModel | None:
        with contextlib.suppress(CalibrationError):  # the camera node has told
            return None if self._read.info is None else CameraModel.from_message(self._read.info)
        return None

    def _measured(self, names: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Stamps (m,), positions and speeds (m, j) of the joint states that hold these joints."""
        stamps, places, speeds = [], [], []
        for message in self._read.joints:
            if not message.header.stamp:  # of a node that had not heard the clock
                continue
            at = {name: i for i, name in enumerate(message.name)}
            if not all(name in at and at[name] < len(message.position) for name in names):
                continue
            order = [at[name] for name in names]
            stamps.append(message.header.stamp.to_sec())
            places.append([message.position[i] for i in order])
            known = len(message.velocity) == len(message.name)
            speeds.append([message.velocity[i] if known else np.nan for i in order])
        shape = (-1, len(names))
        return np.array(stamps), np.array(places).reshape(shape), np.array(speeds).reshape(shape)

    def _camera_poses(
        self, stamp: np.ndarray, joints: np.ndarray, arm: Arm | None, names: tuple[str, ...],
        notes: list[str],
    ) -> np.ndarray:  # fmt: skip
        """(m, 4, 4) at the joint states: of the arm that was recorded, or else of tf."""
        if arm is not None and arm.names == names and len(stamp):
            return np.array([arm.pose(q) for q in joints])
        if not self._read.poses or not len(stamp):
            notes.append("the bag holds no transforms of the camera: its path is unknown")
            return np.full((len(stamp), 4, 4), np.nan)
        when = np.array([time for time, _ in self._read.poses])
        return np.array([self._read.poses[i][1] for i in nearest(when, stamp)])

    def _centres(self, stamp: np.ndarray) -> np.ndarray:
        """(n, 2) measured centre of gravity at the stamps (n,), normalised; NaN: there is none."""
        found = np.full((len(stamp), 2), np.nan)
        for key, message in self._read.moments.items():
            near = int(np.argmin(np.abs(stamp - 1e-9 * key)))
            if abs(stamp[near] - 1e-9 * key) < 1e-6:
                moments = Moments.from_arrays(message.m, message.mu, int(message.order))
                found[near] = moments.xg, moments.yg
        return found


def _runs(states: Sequence[ServoState]) -> list[list[ServoState]]:
    """States that were servoed on, from each run's first error on; runs without one are none."""
    runs: list[list[ServoState]] = [[]]
    for state in states:
        names = runs[-1][0].decision.names if runs[-1] else ()
        another = names and state.decision is not None and state.decision.names != names
        if state.phase == APPROACHING or another:
            runs.append([])
        if state.phase in SERVOED and (runs[-1] or state.decision is not None):
            runs[-1].append(state)
    return [run for run in runs if run]


def _commanded(states: Sequence[ServoState], stamps: np.ndarray, joints: int) -> np.ndarray:
    """(m, joints): the latest command at each stamp (m,); NaN before the first."""
    none = np.full(joints, np.nan)
    commands = np.array([none if s.command is None else s.command for s in states])
    sent = np.searchsorted([state.stamp for state in states], stamps, "right") - 1
    return np.where(sent[:, None] >= 0, commands[sent.clip(0)], np.nan)


def _verdict(goal: Goal | None, poses: np.ndarray) -> Verdict:
    known = goal is not None and goal.world_T_camera is not None
    if not known or not len(poses) or not np.isfinite(poses[-1]).all():
        return Verdict("", float("nan"), float("nan"))
    return Verdict.of(goal.world_T_camera, poses[-1], goal.distance)


def _target(goal: Goal | None) -> PlacedTarget | None:
    if goal is None or goal.target is None:
        return None
    return PlacedTarget(BoxesTarget(goal.target), np.eye(4))
