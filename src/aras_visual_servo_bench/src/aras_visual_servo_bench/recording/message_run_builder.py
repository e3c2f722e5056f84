"""Build a Run from the messages of a bag or of a ROS graph."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_camera.errors import InvalidIntrinsicsError
from aras_visual_servo_camera.moments import Moments
from aras_visual_servo_controller.errors import MeasurementError
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.kinematics import Arm
from aras_visual_servo_controller.observation.observation import CAMERA
from aras_visual_servo_controller.records.state import APPROACHING, ServoState
from aras_visual_servo_controller.ros.recorded_messages import read_state

from ..errors import BenchError
from ..targets.geometry import PlacedTarget, PlatesTarget
from .camera_record import CameraRecord
from .film import encode_film, select_frames, with_images
from .graph_recording import GraphRecording
from .image_tracks import find_milestones, find_nearest
from .recorded_experiment import RecordedExperiment
from .run import Run
from .run_recorder import find_joint_units
from .verdict import Verdict

SERVOING_PHASES = ("servoing", "converged", "holding", "stopped")


class MessageRunBuilder:
    """Builder of a Run from recorded messages."""

    def __init__(self, recording: GraphRecording) -> None:
        self._recording = recording

    def build_run(self, name: str) -> Run:
        """Build the last run of the recording.

        Raises:
            BenchError: the controller has not processed any image.
        """
        recording = self._recording
        all_states = [
            read_state(m, recording.reports.get(m.header.stamp.to_nsec()))
            for m in recording.states
        ]
        runs = split_runs(all_states)
        if not runs:
            raise BenchError(
                f"{recording.path} has no image that the controller processed: "
                + (f"the controller's last phase is {all_states[-1].phase}: "
                   f"{all_states[-1].reason}".rstrip(": ")
                   if all_states else
                   "there are no messages of the controller; start it and record again")
            )  # fmt: skip
        states = runs[-1]
        recorded = RecordedExperiment.from_text(recording.experiment_text)
        notes, arm, goal = recorded.notes, recorded.arm, recorded.goal
        notes += recording.notes
        if len(runs) > 1:
            notes.append(f"the bag has {len(runs)} runs, separated by motions to the start or "
                         "changes of the scheme; this is the last one")  # fmt: skip
        if not any(state.outcome for state in states):
            notes.append("the bag has no diagnosis: outcome and achieved twist are unknown")
        joint_names = tuple(recording.states[-1].joint_names)
        joint_stamp, measured, speed = self._read_joint_states(joint_names, arm, notes)
        if not len(joint_stamp):
            notes.append(f"the bag has no joint states of {', '.join(joint_names)}")
        poses = self._compute_camera_poses(joint_stamp, measured, arm, joint_names, notes)
        stamp = np.array([state.stamp for state in states])
        indices = np.searchsorted(joint_stamp, stamp).clip(0, max(len(joint_stamp) - 1, 0))
        goal_pose = np.full((4, 4), np.nan)
        if goal is not None and goal.world_T_camera is not None:
            goal_pose = np.array(goal.world_T_camera)
        last = next((s for s in reversed(states) if s.outcome), states[-1])
        lower, upper, max_speed = recorded.read_limits()
        if not recording.stamps:
            notes.append("the bag has no images")
        camera = None
        # ignore invalid intrinsics, because the camera node has already reported them
        with contextlib.suppress(InvalidIntrinsicsError):
            if recording.info is not None:
                camera = CameraModel.from_message(recording.info)
        exposed, arrived = (np.array([row[i] for row in recording.stamps]) for i in range(2))
        run = Run(
            name=name, source=str(recording.path), states=tuple(states),
            pose=poses[indices] if len(poses) else np.full((len(stamp), 4, 4), np.nan),
            joint_names=joint_names, joint_stamp=joint_stamp, measured_positions=measured,
            measured_velocities=speed,
            joint_commands=_find_commands(states, joint_stamp, len(joint_names)), true_pose=poses,
            goal_pose=goal_pose, outcome=last.outcome or last.phase, reason=last.reason,
            remedy=last.remedy, verdict=_compute_verdict(goal, poses),
            position_limits=(lower, upper),
            speed_limits=max_speed, joint_units=find_joint_units(arm) if arm is not None else (),
            cameras={CAMERA: CameraRecord(camera, exposed, arrived)},
            target=_make_target(goal), goal=goal,
            real_time_factors=np.array(recording.real_time_factors).reshape(-1, 2),
            settings={"scheme": states[0].scheme, **recorded.describe_settings()},
            versions=recorded.content.get("versions", {}), notes=notes, yaml=recorded.make_yaml(),
        )  # fmt: skip
        units, tolerances = recorded.read_features(states[0].scheme, len(run.names))
        if arm is not None and arm.names == joint_names:
            run.joint_origins = arm.joint_origins(measured)
        run = replace(run, units=units, tolerances=tolerances, centres=self._read_centres(stamp))
        return self._with_images(run, exposed)

    def _with_images(self, run: Run, exposure_stamps: np.ndarray) -> Run:
        """Return a copy of the run with the images that a report shows, and with its film.

        Both are read in one pass over the bag.

        exposure_stamps: stamps (p,) of all images, s.
        """
        if not len(exposure_stamps):
            return run
        nearest = find_nearest(exposure_stamps, np.array(find_milestones(run)))
        milestones = set(exposure_stamps[nearest].tolist())
        during = exposure_stamps[exposure_stamps <= run.stamp[-1] + 1e-6]
        film_stamps = set(select_frames(during, run.start_stamp).tolist())
        images: list[tuple[float, np.ndarray]] = []

        def read_frames() -> Iterator[tuple[float, np.ndarray]]:
            for stamp, image in self._recording.read_images(sorted(milestones | film_stamps)):
                if stamp in milestones:
                    images.append((stamp, image))
                if stamp in film_stamps:
                    yield stamp, image

        frames = encode_film(read_frames(), len(film_stamps))
        return with_images(run, images, frames)

    def _read_joint_states(
        self, names: tuple[str, ...], arm: Arm | None, notes: list[str]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Read the joint states that contain all joints in `names`.

        Joint states with impossible positions are omitted, and a note with their number is added to
        `notes`.

        Returns:
            Stamps (m,), s; positions (m, j), rad or m; velocities (m, j), rad/s or m/s.
        """
        stamps, positions, velocities, faults = [], [], [], []
        has_limits = arm is not None and arm.names == names
        for message in self._recording.joints:
            # a stamp of 0 means that the publisher did not know the simulated time yet
            if not message.header.stamp:
                continue
            indices = {name: i for i, name in enumerate(message.name)}
            if not all(n in indices and indices[n] < len(message.position) for n in names):
                continue
            order = [indices[name] for name in names]
            q = np.array([message.position[i] for i in order])
            try:
                if has_limits:
                    arm.check(q)
                elif not np.isfinite(q).all():
                    raise MeasurementError(f"the measured positions are {q.tolist()}")
            except MeasurementError as error:
                faults.append(str(error))
                continue
            stamps.append(message.header.stamp.to_sec())
            positions.append(q)
            known = len(message.velocity) == len(message.name)
            velocities.append([message.velocity[i] if known else np.nan for i in order])
        if faults:
            notes.append(
                f"joint states that were left out because of impossible positions: {len(faults)} "
                f"({faults[0]}); probably a second node publishes joint states"
            )
        shape = (-1, len(names))
        positions, velocities = (np.array(rows).reshape(shape) for rows in (positions, velocities))
        return np.array(stamps), positions, velocities

    def _compute_camera_poses(
        self, stamp: np.ndarray, joints: np.ndarray, arm: Arm | None, names: tuple[str, ...],
        notes: list[str],
    ) -> np.ndarray:  # fmt: skip
        """Compute the camera pose (m, 4, 4) at each joint state.

        The poses are computed with the kinematics of the recorded arm; if it is unknown, they are
        taken from tf.
        """
        if arm is not None and arm.names == names and len(stamp):
            return np.array([arm.pose(q) for q in joints])
        if not self._recording.poses or not len(stamp):
            notes.append("the bag has no transforms of the camera: its path is unknown")
            return np.full((len(stamp), 4, 4), np.nan)
        times = np.array([time for time, _ in self._recording.poses])
        return np.array([self._recording.poses[i][1] for i in find_nearest(times, stamp)])

    def _read_centres(self, stamp: np.ndarray) -> np.ndarray:
        """Return the measured centre of gravity (n, 2) at each stamp; NaN if there is none.

        stamp: stamps (n,) of the images, s.
        """
        centres = np.full((len(stamp), 2), np.nan)
        for key, message in self._recording.moments.items():
            near = int(np.argmin(np.abs(stamp - 1e-9 * key)))
            if abs(stamp[near] - 1e-9 * key) < 1e-6:
                moments = Moments.from_arrays(message.m, message.mu, int(message.order))
                centres[near] = moments.xg, moments.yg
        return centres


def split_runs(states: Sequence[ServoState]) -> list[list[ServoState]]:
    """Split the states of the loop into runs.

    A run starts with the first state that has a measured error. It ends before a state in which the
    arm moves to a start or the scheme has other features. States outside the runs are omitted.
    """
    runs: list[list[ServoState]] = [[]]
    for state in states:
        names = runs[-1][0].scheme_output.names if runs[-1] else ()
        is_new = names and state.scheme_output is not None and state.scheme_output.names != names
        if state.phase == APPROACHING or is_new:
            runs.append([])
        if state.phase in SERVOING_PHASES and (runs[-1] or state.scheme_output is not None):
            runs[-1].append(state)
    return [run for run in runs if run]


def _find_commands(states: Sequence[ServoState], stamps: np.ndarray, joints: int) -> np.ndarray:
    """Return the joint command (m, joints) at the time of each of m joint states.

    It is the latest command at this time; NaN before the first command.

    stamps: stamps (m,) of the joint states, s.
    """
    none = np.full(joints, np.nan)
    commands = np.array([none if s.command is None else s.command for s in states])
    latest = np.searchsorted([state.stamp for state in states], stamps, "right") - 1
    return np.where(latest[:, None] >= 0, commands[latest.clip(0)], np.nan)


def _compute_verdict(goal: Goal | None, poses: np.ndarray) -> Verdict:
    known = goal is not None and goal.world_T_camera is not None
    if not known or not len(poses) or not np.isfinite(poses[-1]).all():
        return Verdict("", float("nan"), float("nan"))
    return Verdict.compare(goal.world_T_camera, poses[-1], goal.distance)


def _make_target(goal: Goal | None) -> PlacedTarget | None:
    if goal is None or goal.target is None:
        return None
    return PlacedTarget(PlatesTarget(goal.target), np.eye(4))
