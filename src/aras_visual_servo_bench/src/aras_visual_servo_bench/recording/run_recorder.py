"""A run of the runner: collected while it goes on, with what it was made of at its end."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from aras_visual_servo_camera.undistortion import CameraModel
from aras_visual_servo_controller.kinematics import Arm
from aras_visual_servo_controller.observation.frame import Frame
from aras_visual_servo_controller.records.run_record import Record
from aras_visual_servo_controller.records.state import APPROACHING, ServoState
from aras_visual_servo_controller.schemes import JointController, Scheme

from ..experiment.experiment import Experiment
from ..plants import Plant
from ..setup.assembly import Assembly
from .run import CameraRecord, Run


class RunRecorder:
    """What was answered to each image, and what each joint state told.

    Attributes:
        records: what the diagnosis reads of each image, and the events between images.
    """

    def __init__(self, joint_count: int, records_films: bool = False) -> None:
        """`joints`: how many there are; `records_films`: keep what other cameras than the control
        camera see."""
        self.records: list[Record] = []
        self._states: list[ServoState] = []
        self._poses: list[np.ndarray] = []
        self._stamps: list[float] = []
        self._joints: list[tuple[np.ndarray, ...]] = []
        self._count, self._command = joint_count, np.full(joint_count, np.nan)
        self._shot: Callable[[Frame, CameraModel], bytes] | None = None
        if records_films:
            from .film import shot

            self._shot = shot
        self._camera_images: dict[str, list[tuple[float, np.ndarray, bytes]]] = {}

    def add_state(self, state: ServoState, pose: np.ndarray) -> None:
        """One answered image; pose: the true one then."""
        self._states.append(state)
        self._poses.append(pose)

    def add_image(self, reading: Frame, pose: np.ndarray, model: CameraModel) -> None:
        """An image of another camera than the control camera; its true pose then, and model."""
        shown = b"" if self._shot is None else self._shot(reading, model)
        self._camera_images.setdefault(reading.name, []).append((reading.stamp, pose, shown))

    def on_command(self, values: np.ndarray) -> None:
        """What was sent last, (n,)."""
        self._command = values

    def on_joints(self, stamp: float, positions: np.ndarray, velocities: np.ndarray) -> None:
        """One joint state, after the latest command: what it tells, (n,) each."""
        self._stamps.append(stamp)
        self._joints.append((positions, velocities, self._command))

    def make_run(self, plant: Plant, experiment: Experiment, parts: Assembly, **end: Any) -> Run:
        """The run, with the poses of this plant; `end`: the fields of a Run that tell its end."""
        columns = np.array(self._joints).reshape(len(self._joints), 3, self._count)
        measured, measured_speed, commanded = columns.swapaxes(0, 1)
        scheme: Scheme | JointController = parts.servo.scheme
        arm = parts.servo.arm
        # A run begins where servoing does: behind the way to the start, if the loop went there.
        ways = [i for i, state in enumerate(self._states) if state.phase == APPROACHING]
        first = ways[-1] + 1 if ways else 0
        states, poses = self._states[first:], self._poses[first:]
        stamp = np.array([state.stamp for state in states])
        limits = tuple(np.asarray(getattr(arm, side, ()), float) for side in ("lower", "upper"))
        run = Run(
            states=tuple(states), pose=np.array(poses).reshape(-1, 4, 4),
            joint_stamp=np.array(self._stamps), measured_positions=measured,
            measured_velocities=measured_speed,
            joint_commands=commanded, true_pose=plant.compute_rest_poses(measured),
            units=tuple(scheme.units or ()),
            tolerances=tuple(float(t) for t in scheme.tolerances), position_limits=limits,
            cameras=self._make_camera_records(parts, stamp, np.array(poses).reshape(-1, 4, 4)),
            target=parts.target, goal=parts.goal, settings=describe_settings(experiment),
            experiment=experiment, **end,
        )  # fmt: skip
        if isinstance(arm, Arm):
            run.speed_limits, run.joint_units = (
                parts.settings.make_limits(arm).velocity,
                find_joint_units(arm),
            )
        if "xg" in run.names and "yg" in run.names:
            run.centres = run.features[:, [run.names.index("xg"), run.names.index("yg")]]
        return run


    def _make_camera_records(
        self, parts: Assembly, stamp: np.ndarray, pose: np.ndarray
    ) -> dict[str, CameraRecord]:
        """What each camera saw, by name; stamp (p,), pose (p, 4, 4) of the control camera."""
        found = {}
        for name, eye in parts.cameras.items():
            if name == parts.rig.control.name:
                found[name] = CameraRecord(parts.plant.camera, stamp, stamp, pose)
                continue
            seen = self._camera_images.get(name, [])
            at = np.array([stamp for stamp, _, _ in seen])
            place = np.array([pose for _, pose, _ in seen]).reshape(-1, 4, 4)
            film = tuple((stamp, shown) for stamp, _, shown in seen if shown)
            found[name] = CameraRecord(eye.true_camera, at, at + eye.delay, place, film=film)
        return found


def describe_settings(experiment: Experiment) -> dict[str, str]:
    """What of an experiment a reader wants to see first, in words; numbers without their units."""
    asked = {key: getattr(experiment, key) for key in (
        "plant", "scheme", "law", "gain", "start", "goal", "camera", "delay", "seed",
    )}  # fmt: skip
    asked["target"] = experiment.target.shape
    return {key: _describe_setting(key, value) for key, value in asked.items() if value is not None}


def _describe_setting(key: str, value: Any) -> str:
    if key == "camera" and not isinstance(value, str):
        return "settings of its own"
    if isinstance(value, tuple):
        if key == "target":
            return f"polygon of {len(value)} corners"
        return f"joints {' '.join(f'{q:g}' for q in value)}"
    return f"{value:g}" if isinstance(value, float) else str(value)


def find_joint_units(arm: Arm) -> tuple[str, ...]:
    """'m' for joints that slide, 'rad' for others."""
    return tuple("m" if slides else "rad" for slides in arm.is_prismatic)
