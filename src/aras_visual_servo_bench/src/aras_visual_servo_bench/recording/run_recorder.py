"""Recorder that collects the data of a run while it is simulated."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_controller.kinematics import Arm
from aras_visual_servo_controller.observation.frame import Frame
from aras_visual_servo_controller.records.run_record import Record
from aras_visual_servo_controller.records.state import APPROACHING, ServoState
from aras_visual_servo_controller.schemes import JointController, Scheme

from ..experiment.experiment import Experiment
from ..plants import Plant
from ..setup.assembly import Assembly
from .camera_record import CameraRecord
from .run import Run


class RunRecorder:
    """Recorder of the loop's states, the joint states and the images of a run.

    Attributes:
        records: input of the diagnosis of the run: one record for each image, and one for each
            event between images.
    """

    def __init__(self, joint_count: int, records_films: bool = False) -> None:
        """Prepare the recorder.

        Args:
            joint_count: number of joints.
            records_films: whether to record the images of the other cameras, too.
        """
        self.records: list[Record] = []
        self._states: list[ServoState] = []
        self._poses: list[np.ndarray] = []
        self._stamps: list[float] = []
        # Joint states (m, 3, n): positions, velocities, and the latest command.
        self._joints: list[np.ndarray] = []
        self._count, self._command = joint_count, np.full(joint_count, np.nan)
        self._records_films = records_films
        self._camera_images: dict[str, list[tuple[float, np.ndarray, bytes]]] = {}

    def add_state(self, state: ServoState, pose: np.ndarray) -> None:
        """Add the state of the loop after an image, and the true camera pose (4, 4)."""
        self._states.append(state)
        self._poses.append(pose)

    def add_image(self, reading: Frame, pose: np.ndarray, model: CameraModel) -> None:
        """Add an image of one of the other cameras (not of the control camera).

        Args:
            reading: frame of the camera.
            pose: true world_T_camera (4, 4) of the camera at the exposure.
            model: true intrinsics of the camera.
        """
        jpeg = b""
        if self._records_films:
            from .film import encode_frame, make_image  # loads OpenCV, which only films need

            jpeg = encode_frame(make_image(reading, model))
        self._camera_images.setdefault(reading.name, []).append((reading.stamp, pose, jpeg))

    def on_command(self, values: np.ndarray) -> None:
        """Store the latest joint command (n,)."""
        self._command = values

    def on_joints(self, stamp: float, positions: np.ndarray, velocities: np.ndarray) -> None:
        """Add a joint state: positions (n,), velocities (n,), and the latest command."""
        self._stamps.append(stamp)
        self._joints.append(np.array([[positions, velocities, self._command]]))

    def on_updates(self, stamps: Sequence[float], samples: np.ndarray) -> None:
        """Add m joint states (m, 3, n) with their commands; see JointListener."""
        self._stamps.extend(stamps)
        self._joints.append(samples)
        if len(stamps):
            self._command = samples[-1, 2]

    def make_run(self, plant: Plant, experiment: Experiment, parts: Assembly, **end: Any) -> Run:
        """Make the record of the run; the plant computes the camera poses.

        end: other fields of the Run, such as outcome and verdict.
        """
        columns = np.concatenate([np.empty((0, 3, self._count)), *self._joints])
        positions, velocities, commands = columns.swapaxes(0, 1)
        scheme: Scheme | JointController = parts.servo.scheme
        arm = parts.servo.arm
        # If the loop first moved the arm to a start, the recorded run starts after this motion.
        approach = [i for i, state in enumerate(self._states) if state.phase == APPROACHING]
        first = approach[-1] + 1 if approach else 0
        states, poses = self._states[first:], self._poses[first:]
        stamp = np.array([state.stamp for state in states])
        limits = tuple(np.asarray(getattr(arm, side, ()), float) for side in ("lower", "upper"))
        run = Run(
            states=tuple(states), pose=np.array(poses).reshape(-1, 4, 4),
            joint_stamp=np.array(self._stamps), measured_positions=positions,
            measured_velocities=velocities, joint_commands=commands,
            true_pose=plant.compute_rest_poses(positions),
            units=tuple(scheme.units or ()),
            tolerances=tuple(float(t) for t in scheme.tolerances), position_limits=limits,
            cameras=self._make_camera_records(parts, stamp, np.array(poses).reshape(-1, 4, 4)),
            target=parts.target, goal=parts.goal, settings=describe_settings(experiment),
            experiment=experiment, **end,
        )  # fmt: skip
        if isinstance(arm, Arm):
            run.speed_limits = parts.settings.make_limits(arm).velocity
            run.joint_units = find_joint_units(arm)
        if "xg" in run.names and "yg" in run.names:
            run.centres = run.features[:, [run.names.index("xg"), run.names.index("yg")]]
        return run

    def _make_camera_records(
        self, parts: Assembly, stamp: np.ndarray, pose: np.ndarray
    ) -> dict[str, CameraRecord]:
        """Make the record of each camera, by name.

        Args:
            parts: objects of the run.
            stamp: stamps (p,) of the images of the control camera, s.
            pose: world_T_camera (p, 4, 4) of the images of the control camera.
        """
        records = {}
        for name, camera in parts.cameras.items():
            if name == parts.rig.control.name:
                records[name] = CameraRecord(parts.plant.camera, stamp, stamp, pose)
                continue
            images = self._camera_images.get(name, [])
            stamps = np.array([stamp for stamp, _, _ in images])
            poses = np.array([pose for _, pose, _ in images]).reshape(-1, 4, 4)
            film = tuple((stamp, jpeg) for stamp, _, jpeg in images if jpeg)
            records[name] = CameraRecord(
                camera.true_camera, stamps, stamps + camera.delay, poses, film=film
            )
        return records


def describe_settings(experiment: Experiment) -> dict[str, str]:
    """Return the main settings of an experiment as text, by name; numbers have no unit."""
    settings = {key: getattr(experiment, key) for key in (
        "plant", "scheme", "law", "gain", "start", "goal", "camera", "delay", "seed",
    )}  # fmt: skip
    settings["target"] = experiment.target.shape
    return {
        key: _describe_setting(key, value) for key, value in settings.items() if value is not None
    }


def _describe_setting(key: str, value: Any) -> str:
    if key == "camera" and not isinstance(value, str):
        return "own settings"
    if isinstance(value, tuple):
        if key == "target":
            return f"polygon of {len(value)} corners"
        return f"joints {' '.join(f'{q:g}' for q in value)}"
    return f"{value:g}" if isinstance(value, float) else str(value)


def find_joint_units(arm: Arm) -> tuple[str, ...]:
    """Return the unit of each joint: 'm' for prismatic joints, 'rad' for revolute ones."""
    return tuple("m" if is_prismatic else "rad" for is_prismatic in arm.is_prismatic)
