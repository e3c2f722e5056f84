"""A run of messages, of a bag or heard on a graph: parsed into the loop's own records."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from aras_visual_servo_camera.errors import CalibrationError
from aras_visual_servo_camera.moments import Moments
from aras_visual_servo_camera.undistortion import CameraModel
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.kinematics import Arm
from aras_visual_servo_controller.observation.observation import CAMERA
from aras_visual_servo_controller.records.state import APPROACHING, ServoState
from aras_visual_servo_controller.ros.read_back import read_state

from ..errors import BenchError
from ..targets.geometry import BoxesTarget, PlacedTarget
from .film import encode_film, select_frames, with_images
from .graph_recording import GraphRecording
from .image_tracks import find_milestones, find_nearest
from .recorded_experiment import RecordedExperiment
from .run import CameraRecord, Run, Verdict
from .run_recorder import find_joint_units

SERVOING_PHASES = ("servoing", "converged", "holding", "stopped")


class MessageRunBuilder:
    """Messages as a run."""

    def __init__(self, recording: GraphRecording) -> None:
        self._recording = recording

    def build_run(self, name: str) -> Run:
        """The run; BenchError where nothing was servoed on."""
        read = self._recording
        every = [read_state(m, read.reports.get(m.header.stamp.to_nsec())) for m in read.states]
        runs = _split_runs(every)
        if not runs:
            raise BenchError(
                f"{read.path} holds no image that was servoed on: the controller was "
                + (f"{every[-1].phase}: {every[-1].reason}".rstrip(": ") if every
                   else "never heard")
            )  # fmt: skip
        states = runs[-1]
        told = RecordedExperiment.from_text(read.experiment_text)
        notes, arm, goal = told.notes, told.arm, told.goal
        notes += read.notes
        if len(runs) > 1:
            notes.append(f"the bag holds {len(runs)} runs: the arm went to its start, or another "
                         "scheme began, between them; this is the last")  # fmt: skip
        if not any(state.outcome for state in states):
            notes.append("the bag holds no diagnosis: outcome and achieved twist are unknown")
        joint_names = tuple(read.states[-1].joint_names)
        joint_stamp, measured, speed = self._read_joint_states(joint_names)
        if not len(joint_stamp):
            notes.append(f"the bag holds no joint states of {', '.join(joint_names)}")
        poses = self._compute_camera_poses(joint_stamp, measured, arm, joint_names, notes)
        stamp = np.array([state.stamp for state in states])
        at = np.searchsorted(joint_stamp, stamp).clip(0, max(len(joint_stamp) - 1, 0))
        goal_pose = np.full((4, 4), np.nan)
        if goal is not None and goal.world_T_camera is not None:
            goal_pose = np.array(goal.world_T_camera)
        last = next((s for s in reversed(states) if s.outcome), states[-1])
        lower, upper, greatest = told.read_limits()
        if not read.stamps:
            notes.append("the bag holds no pictures")
        exposed, arrived = (np.array([row[i] for row in read.stamps]) for i in range(2))
        run = Run(
            name=name, source=str(read.path), states=tuple(states),
            pose=poses[at] if len(poses) else np.full((len(stamp), 4, 4), np.nan),
            joint_names=joint_names, joint_stamp=joint_stamp, measured_positions=measured,
            measured_velocities=speed,
            joint_commands=_find_commands(states, joint_stamp, len(joint_names)), true_pose=poses,
            goal_pose=goal_pose, outcome=last.outcome or last.phase, reason=last.reason,
            remedy=last.remedy, verdict=_compute_verdict(goal, poses),
            position_limits=(lower, upper),
            speed_limits=greatest, joint_units=find_joint_units(arm) if arm is not None else (),
            cameras={CAMERA: CameraRecord(self._find_camera(), exposed, arrived)},
            target=_make_target(goal), goal=goal,
            real_time_factors=np.array(read.real_time_factors).reshape(-1, 2),
            settings={"scheme": states[0].scheme, **told.describe_settings()},
            versions=told.content.get("versions", {}), notes=notes, yaml=told.make_yaml(),
        )  # fmt: skip
        units, tolerances = told.read_features(states[0].scheme, len(run.names))
        if arm is not None and arm.names == joint_names:
            run.joint_origins = arm.joint_origins(measured)
        run = replace(run, units=units, tolerances=tolerances, centres=self._read_centres(stamp))
        return self._with_images(run, exposed)

    def _with_images(self, run: Run, exposure_stamps: np.ndarray) -> Run:
        """The run with its milestones' pictures and its film, read in one pass; `exposure_stamps`:
        (p,).
        """
        if not len(exposure_stamps):
            return run
        shown = set(
            exposure_stamps[find_nearest(exposure_stamps, np.array(find_milestones(run)))].tolist()
        )
        filmed = set(
            select_frames(
                exposure_stamps[exposure_stamps <= run.stamp[-1] + 1e-6], run.start_stamp
            ).tolist()
        )
        kept: list[tuple[float, np.ndarray]] = []

        def pass_frames() -> Iterator[tuple[float, np.ndarray]]:
            for stamp, picture in self._recording.read_images(sorted(shown | filmed)):
                if stamp in shown:
                    kept.append((stamp, picture))
                if stamp in filmed:
                    yield stamp, picture

        frames = encode_film(pass_frames(), len(filmed))
        return with_images(run, kept, frames)

    def _find_camera(self) -> CameraModel | None:
        with contextlib.suppress(CalibrationError):  # the camera node has told
            return (
                None
                if self._recording.info is None
                else CameraModel.from_message(self._recording.info)
            )
        return None

    def _read_joint_states(
        self, names: tuple[str, ...]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Stamps (m,), positions and speeds (m, j) of the joint states that hold these joints."""
        stamps, places, speeds = [], [], []
        for message in self._recording.joints:
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

    def _compute_camera_poses(
        self, stamp: np.ndarray, joints: np.ndarray, arm: Arm | None, names: tuple[str, ...],
        notes: list[str],
    ) -> np.ndarray:  # fmt: skip
        """(m, 4, 4) at the joint states: of the arm that was recorded, or else of tf."""
        if arm is not None and arm.names == names and len(stamp):
            return np.array([arm.pose(q) for q in joints])
        if not self._recording.poses or not len(stamp):
            notes.append("the bag holds no transforms of the camera: its path is unknown")
            return np.full((len(stamp), 4, 4), np.nan)
        when = np.array([time for time, _ in self._recording.poses])
        return np.array([self._recording.poses[i][1] for i in find_nearest(when, stamp)])

    def _read_centres(self, stamp: np.ndarray) -> np.ndarray:
        """(n, 2) measured centre of gravity at the stamps (n,), normalised; NaN: there is none."""
        found = np.full((len(stamp), 2), np.nan)
        for key, message in self._recording.moments.items():
            near = int(np.argmin(np.abs(stamp - 1e-9 * key)))
            if abs(stamp[near] - 1e-9 * key) < 1e-6:
                moments = Moments.from_arrays(message.m, message.mu, int(message.order))
                found[near] = moments.xg, moments.yg
        return found


def _split_runs(states: Sequence[ServoState]) -> list[list[ServoState]]:
    """States that were servoed on, from each run's first error on; runs without one are none."""
    runs: list[list[ServoState]] = [[]]
    for state in states:
        names = runs[-1][0].scheme_output.names if runs[-1] else ()
        another = names and state.scheme_output is not None and state.scheme_output.names != names
        if state.phase == APPROACHING or another:
            runs.append([])
        if state.phase in SERVOING_PHASES and (runs[-1] or state.scheme_output is not None):
            runs[-1].append(state)
    return [run for run in runs if run]


def _find_commands(states: Sequence[ServoState], stamps: np.ndarray, joints: int) -> np.ndarray:
    """(m, joints): the latest command at each stamp (m,); NaN before the first."""
    none = np.full(joints, np.nan)
    commands = np.array([none if s.command is None else s.command for s in states])
    sent = np.searchsorted([state.stamp for state in states], stamps, "right") - 1
    return np.where(sent[:, None] >= 0, commands[sent.clip(0)], np.nan)


def _compute_verdict(goal: Goal | None, poses: np.ndarray) -> Verdict:
    known = goal is not None and goal.world_T_camera is not None
    if not known or not len(poses) or not np.isfinite(poses[-1]).all():
        return Verdict("", float("nan"), float("nan"))
    return Verdict.compare(goal.world_T_camera, poses[-1], goal.distance)


def _make_target(goal: Goal | None) -> PlacedTarget | None:
    if goal is None or goal.target is None:
        return None
    return PlacedTarget(BoxesTarget(goal.target), np.eye(4))
