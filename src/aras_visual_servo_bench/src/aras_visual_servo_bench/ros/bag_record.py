"""From the messages of a bag to the record of a run."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from aras_visual_servo_camera.errors import CalibrationError
from aras_visual_servo_camera.moments import Moments
from aras_visual_servo_camera.undistortion import CameraModel
from aras_visual_servo_controller.arm import Arm
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.loop.state import APPROACHING

from ..errors import BenchError
from ..recording.from_loop import padded
from ..recording.of_run import joint_units
from ..recording.record import Images, Record, milestones, nearest
from ..recording.run import Details, Run, Verdict
from ..targets.geometry import BoxesTarget, PlacedTarget
from .described import Described

if TYPE_CHECKING:
    from .bag import Reader

REACHED_WITHIN = (0.3e-3, float(np.radians(0.3)))  # m and rad of the camera
SERVOED = ("servoing", "converged", "holding", "stopped")


class Messages:
    """The messages that a Reader has collected, as a run."""

    def __init__(self, read: Reader) -> None:
        self._read = read

    def record(self, name: str) -> Record:
        """The record; BenchError where nothing was servoed on."""
        runs = _runs(self._read.states)
        if not runs:
            raise BenchError(
                f"{self._read.path} holds no image that was servoed on: the controller was "
                + (f"{self._read.states[-1].phase}: {self._read.states[-1].reason}".rstrip(": ")
                   if self._read.states else "never heard")
            )  # fmt: skip
        servoed = runs[-1]
        told = Described.of(self._read.described)
        notes, arm, goal = told.notes, told.arm, told.goal
        notes += self._read.notes
        if len(runs) > 1:
            notes.append(f"the bag holds {len(runs)} runs: the arm went to its start, or another "
                         "scheme began, between them; this is the last")  # fmt: skip
        run, details = self._run(servoed, arm, goal, notes)
        scheme = servoed[0].scheme
        units, tolerances = told.features(scheme, len(run.names))
        camera = self._camera()
        lower, upper, speed = told.limits()
        if not self._read.stamps:
            notes.append("the bag holds no pictures")
        record = Record(
            name=name, source=str(self._read.path), run=run, details=details, units=units,
            tolerances=tolerances,
            limits=(lower, upper), speed=speed,
            joint_units=joint_units(arm) if arm is not None else (),
            camera=camera, target=_target(goal), goal=goal, centres=self._centres(run),
            images=Images(*np.array([row[:2] for row in self._read.stamps]).reshape(-1, 2).T),
            pace=np.array(self._read.pace).reshape(-1, 2),
            settings={"scheme": scheme, **told.words()},
            versions=told.given.get("versions", {}), notes=notes, experiment=told.text(),
        )  # fmt: skip
        record.images = Images(
            record.images.stamp, record.images.arrival, tuple(self._read.pictures(milestones(run)))
        )
        return record

    def _camera(self) -> CameraModel | None:
        with contextlib.suppress(CalibrationError):  # the camera node has told
            return None if self._read.info is None else CameraModel.from_message(self._read.info)
        return None

    def _run(
        self, states: list[Any], arm: Arm | None, goal: Goal | None, notes: list[str]
    ) -> tuple[Run, Details]:
        names = next(tuple(m.feature_names) for m in states if len(m.error))
        joint_names = tuple(states[0].joint_names)
        stamp = np.array([m.header.stamp.to_sec() for m in states])
        reports = [self._read.reports.get(m.header.stamp.to_nsec()) for m in states]
        if not any(reports):
            notes.append("the bag holds no diagnosis: outcome and achieved twist are unknown")
        error = _table(states, "error", len(names))
        joint_stamp, measured, speed = self._measured(joint_names)
        if not len(joint_stamp):
            notes.append(f"the bag holds no joint states of {', '.join(joint_names)}")
        poses = self._camera_poses(joint_stamp, measured, arm, joint_names, notes)
        commands = _table(states, "joint_commands", len(joint_names))
        last = next((r for r in reversed(reports) if r is not None), None)
        goal_pose = np.full((4, 4), np.nan)
        if goal is not None and goal.world_T_camera is not None:
            goal_pose = np.array(goal.world_T_camera)
        at = np.searchsorted(joint_stamp, stamp).clip(0, max(len(joint_stamp) - 1, 0))
        none = np.full((len(stamp), len(joint_names)), np.nan)
        sent = np.searchsorted(stamp, joint_stamp, "right") - 1
        commanded = np.where(sent[:, None] >= 0, commands[sent.clip(0)], np.nan)
        details = Details(
            filtered=_filtered(reports, error),
            singular_L=padded(r and r.singular_values_l for r in reports),
            singular_LJ=padded(m.singular_values for m in states),
            manipulability=_column(reports, "manipulability"),
            scale=_column(reports, "scale"),
            computing=_column(reports, "computing"),
        )
        smallest = details.singular_L[:, -1:] if details.singular_L.shape[1] else error[:, :1] * 0
        run = Run(
            stamp=stamp, names=names, features=_table(states, "features", len(names)),
            desired=_table(states, "desired_features", len(names)), error=error,
            asked=np.array([_twist(m.camera_twist) for m in states]),
            achieved=np.array([
                np.full(6, np.nan) if r is None else _twist(r.achieved) for r in reports
            ]),
            pose=poses[at] if len(poses) else np.full((len(stamp), 4, 4), np.nan),
            joints=measured[at] if len(measured) else none,
            phases=tuple(m.phase for m in states),
            outcomes=tuple("" if r is None else r.outcome for r in reports),
            reasons=tuple(m.reason for m in states),
            rank=np.array([-1 if r is None else r.rank for r in reports], int),
            smallest=smallest[:, 0], joint_names=joint_names, joint_stamp=joint_stamp,
            measured=measured, measured_speed=speed, true_joints=measured, true_speed=speed,
            commanded=commanded, true_pose=poses, goal_pose=goal_pose,
            outcome=states[-1].phase if last is None else last.outcome,
            reason=states[-1].reason if last is None else last.reason,
            mend="" if last is None else last.mend,
            verdict=_verdict(goal_pose, poses),
        )  # fmt: skip
        return run, details

    def _measured(self, names: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Stamps (m,), positions and speeds (m, j) of the joint states that hold these joints."""
        stamps, places, speeds = [], [], []
        for message in self._read.joints:
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

    def _centres(self, run: Run) -> np.ndarray:
        """(n, 2) measured centre of gravity at run.stamp, normalised; NaN where there is none."""
        found = np.full((len(run.stamp), 2), np.nan)
        at = {round(1e9 * stamp): i for i, stamp in enumerate(run.stamp.tolist())}
        for key, message in self._read.moments.items():
            i = at.get(key, at.get(round(key)))
            if i is None:
                near = int(np.argmin(np.abs(run.stamp - 1e-9 * key)))
                i = near if abs(run.stamp[near] - 1e-9 * key) < 1e-6 else None
            if i is not None:
                moments = Moments.from_arrays(message.m, message.mu, int(message.order))
                found[i] = moments.xg, moments.yg
        return found


def _runs(states: Sequence[Any]) -> list[list[Any]]:
    """States that were servoed on, from each run's first error on; runs without one are none."""
    runs: list[list[Any]] = [[]]
    for state in states:
        names = runs[-1] and runs[-1][0].feature_names
        if state.phase == APPROACHING or (names and len(state.error) and
                                          state.feature_names != names):  # fmt: skip
            runs.append([])
        if state.phase in SERVOED and (runs[-1] or len(state.error)):
            runs[-1].append(state)
    return [run for run in runs if run]


def _verdict(goal: np.ndarray, poses: np.ndarray) -> Verdict:
    if not np.isfinite(goal).all() or not len(poses) or not np.isfinite(poses[-1]).all():
        return Verdict("", float("nan"), float("nan"))
    return Verdict.of(goal, poses[-1], REACHED_WITHIN)


def _target(goal: Goal | None) -> PlacedTarget | None:
    if goal is None or goal.target is None:
        return None
    return PlacedTarget(BoxesTarget(goal.target), np.eye(4))


def _table(messages: Iterable[Any], field: str, width: int) -> np.ndarray:
    """A field of each message as a row (n, width); NaN where it has another length."""
    none = [float("nan")] * width
    rows = [getattr(m, field) for m in messages]
    return np.array([row if len(row) == width else none for row in rows], float).reshape(-1, width)


def _column(reports: Iterable[Any], field: str) -> np.ndarray:
    values = np.array([np.nan if r is None else getattr(r, field) for r in reports], float)
    return np.where(values == 0.0, np.nan, values) if field == "computing" else values


def _filtered(reports: list[Any], error: np.ndarray) -> np.ndarray:
    """Errors behind the filter (n, k), as measured where none is told."""
    found = error.copy()
    for i, report in enumerate(reports):
        values = getattr(report, "filtered_error", ())
        if len(values) == error.shape[1]:
            found[i] = values
    return found


def _twist(message: Any) -> np.ndarray:
    """(6,) of a geometry_msgs/Twist."""
    return np.array([getattr(part, axis) for part in (message.linear, message.angular)
                     for axis in "xyz"])  # fmt: skip
