"""Simulated arm with Bullet physics, ros_control controllers and rendered images."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from aras_sim_bridge.description import (
    CameraDescription,
    RobotDescription,
    parse_urdf,
    world_file,
)
from aras_sim_bridge.description.camera_types import CameraPlugin
from aras_sim_bridge.description.types import is_present
from aras_sim_bridge.description.world_file import WorldFile
from aras_sim_bridge.errors import SimError
from aras_sim_bridge.rendering import EXPOSURES
from aras_sim_bridge.simulation import Simulation, SimulationConfig
from aras_sim_bridge.world.labels import list_links_by_label
from aras_sim_bridge.world.model import Model
from aras_sim_bridge.world.overlaps import find_overlaps
from aras_visual_servo_base.poses import (
    Pose,
    exponential,
    inverse,
    logarithm,
    matrix_from_xyz_rpy,
    optical_pose,
    relative_pose,
    xyz_rpy_from_matrix,
)
from aras_visual_servo_camera.errors import SegmentationError
from aras_visual_servo_camera.label_segmentation import LabelSegmentation
from aras_visual_servo_controller.observation.frame import NANOSECONDS, Frame

from ..errors import ExperimentError
from ..experiment import cameras
from ..experiment.robots import ROBOT, Robot, find_camera_name
from ..targets.geometry import PlacedTarget, PoseHistory
from .base import CAMERA, JointListener, JointReading, Plant, Reading
from .exposures import collect_vibrations, make_exposure_schedules
from .imaging import ImagingSettings

if TYPE_CHECKING:
    from aras_visual_servo_controller.runner.loop_runner import LoopRunner

TARGET, OCCLUDER = "target", "occluder"
HIDDEN_POSE = Pose((0.0, 0.0, -1e4), (0.0, 0.0, 0.0, 1.0))
NO_CAMERAS: Mapping[str, Mapping[str, Any]] = {}


@dataclass(frozen=True, eq=False)
class TargetModel:
    """Model in the simulated world that shows a target, or an occluder on a target.

    target: the target with its motion; an occluder moves with it.
    urdf: file with the visuals of the model.
    offset: position x, y, z (m) of the model's origin in the target frame.
    visible_times: intervals (start, end) in which the model is visible, s; None: always.
    name: name of the model.
    """

    target: PlacedTarget
    urdf: Path
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    visible_times: tuple[tuple[float, float], ...] | None = None
    name: str = TARGET

    @property
    def is_static(self) -> bool:
        """True if the model is always visible and does not move."""
        return self.visible_times is None and self.target.motion.is_static

    def compute_pose(self, time: float) -> Pose:
        """Compute the world pose of the model at `time` (s); an invisible model is far away."""
        if not is_present(self.visible_times, time):
            return HIDDEN_POSE
        world_T_target = self.target.world_T_target(time)
        return Pose.from_matrix(world_T_target @ matrix_from_xyz_rpy(self.offset, (0.0,) * 3))


@dataclass(frozen=True, eq=False)
class TargetLink:
    """Target that is a link of a model in the world; the plant adds its poses to `pose_history`."""

    model: str
    link: str
    pose_history: PoseHistory


class DynamicArm(Plant):
    """Robot arm that is simulated with Bullet, with 1 000 physics steps per second.

    Attributes:
        simulation: the simulation, with the models `robot` and `target`; extensions can use it.
        peak_speed: maximum speed (n,) of each joint over all steps; None if it is not recorded.
    """

    def __init__(
        self,
        robot: Robot,
        camera: Mapping[str, Any],
        joints: Mapping[str, float],
        seed: int = 0,
        renderer: str = "auto",
        record_peak_speeds: bool = False,
        target_models: Sequence[TargetModel] = (),
        imaging_settings: Sequence[ImagingSettings] = (),
        surroundings: WorldFile = WorldFile(),  # noqa: B008 (frozen)
        name: str = "",
        other_cameras: Mapping[str, Mapping[str, Any]] = NO_CAMERAS,
        exposure: str = EXPOSURES[0],
        labelled_link: str = "",
        tracked_link: TargetLink | None = None,
    ) -> None:
        """Spawn the robot and start its controllers and cameras.

        Args:
            robot: robot of the experiment.
            camera: settings of the control camera; they override those in the description.
            joints: initial position of each joint, by name, rad or m.
            seed: seed of all random numbers.
            renderer: renderer of the camera images.
            record_peak_speeds: whether to record each joint's maximum speed, for `peak_speed`.
            target_models: targets and occluders to spawn in the world.
            imaging_settings: settings of each camera, the control camera first, if features are
                exact; empty: images are rendered.
            surroundings: world around the robot: models, lights and scene.
            name: name of the control camera; '': the only camera of the robot description.
            other_cameras: settings of the other cameras, by name; `robot` gives their frames.
            exposure: conversion of light into grey levels, one of EXPOSURES.
            labelled_link: model or 'model::link' to mark as the target in label images; '': none.
            tracked_link: the target, if it is a link of a model in the world; else None.

        Raises:
            ExperimentError: the robot, its cameras or the world cannot be simulated.
        """
        description = robot.parse_description()
        mounted = [c for c in description.cameras if robot.spec.camera in ("", find_camera_name(c))]
        if robot.spec.camera and not mounted:
            known = ", ".join(map(find_camera_name, description.cameras)) or "none"
            raise ExperimentError(
                f"robot.camera: the robot has no camera '{robot.spec.camera}'; it has: {known}"
            )
        self.control_camera_name, self._other_cameras = name or CAMERA, other_cameras
        first = mounted[0] if mounted else _make_default_camera(robot.find_optical_frame(""))
        if not (name or mounted and robot.has_camera_on(first.link)):
            # add a camera sensor, because the robot description has none at the optical frame
            name = CAMERA
        self._link = first.link
        own: dict[str, Any] = {}
        for part in reversed(find_camera_name(first).split("/")):
            own = {part: own or dict(camera)}
        # Raise an error if settings are invalid; the simulator would only omit the camera.
        for settings in (camera, *other_cameras.values()):
            cameras.make_camera_model(settings)
        if name:
            described = [_rename_camera(first, new, robot) for new in (name, *other_cameras)]
            own, self._link = {name: dict(camera), **other_cameras}, described[0].link
            description = replace(description, cameras=tuple(described))
        else:
            name = find_camera_name(first)
        self._arm = robot.make_arm(self.control_camera_name)
        self.joint_names = self._arm.names
        controllers, kind = robot.find_controllers(self.joint_names)
        self.outputs = frozenset((kind,))
        self._controllers = list(controllers.values())
        self._readings: list[Reading] = []
        # targets and occluders whose poses `advance` sets at every step
        self._moving_models: list[tuple[TargetModel, Model]] = []
        self.peak_speed = np.zeros(len(self.joint_names)) if record_peak_speeds else None
        self._exposures = [] if not imaging_settings else make_exposure_schedules(
            imaging_settings[0], imaging_settings[1:], np.random.default_rng(seed), seed
        )
        self.vibrations = collect_vibrations(*imaging_settings)
        self.simulation = Simulation(
            SimulationConfig(
                renderer=renderer, seed=seed, lights=surroundings.lights, scene=surroundings.scene,
                ground_plane=surroundings.ground_plane, exposure=exposure,
            )
        )
        try:
            world_file.populate(self.simulation.spawn, surroundings)
            self._spawn(robot, description, name, own, joints)
            for target_model in target_models:
                model = self.simulation.spawn(
                    _parse_target(target_model.urdf), target_model.name,
                    target_model.compute_pose(0.0),
                )  # fmt: skip
                if not target_model.is_static:
                    self._moving_models.append((target_model, model))
            self._tracked_link = tracked_link
            if tracked_link is not None:
                self._record_target_pose()
            self._labels = None
            if labelled_link:
                self._labels = LabelSegmentation(labelled_link)
                self._labels.set_links(list_links_by_label(self.simulation.world.models))
                self._labels.find_target_labels()
        except (SimError, SegmentationError) as error:
            self.close()
            raise ExperimentError(str(error)) from error

    def _spawn(
        self, robot: Robot, description: Any, camera: str, settings: Mapping[str, Any],
        joints: Mapping[str, float],
    ) -> None:
        simulation, spec = self.simulation, robot.spec
        simulation.spawn(
            description, ROBOT, namespace=spec.namespace, parameters=robot.parameters,
            joint_positions=joints, cameras=settings,
        )  # fmt: skip
        self._robot = simulation.robots[ROBOT]
        self._model = self._robot.model
        self._rows = [self._model.joint_names.index(name) for name in self.joint_names]
        self._robot.start([spec.joint_states, *self._controllers])
        # Switch the controllers on before the first step, as the ROS service does at time 0.
        # Commands then act from the first step, and joint states have the same stamps as on ROS.
        self._robot.hardware.read()
        self._robot.manager.carry_out_switches(simulation.time_ns)
        self._joint_states, self._compiled_controller = spec.joint_states, None
        self._robot.manager.get(spec.joint_states).on_state = self._on_joints
        self._command_kind = [self._robot.manager.get(name) for name in self._controllers]
        mounted = simulation.camera(f"/{camera}")
        sensors = {name: simulation.camera(f"/{name}") for name in self._other_cameras}
        for name, spawned in {self.control_camera_name: mounted, **sensors}.items():
            spawned.on_frame, spawned.enabled = partial(self._on_frame, name), not self._exposures
            if spawned.sensor.vibration is not None and not self._exposures:
                self.vibrations = {**self.vibrations, name: spawned.sensor.vibration}
        self._link_T_camera = np.array(mounted.parent_T_optical)
        self._carrier = robot.find_target_frame(self.control_camera_name)
        self.camera = cameras.read_camera_model(mounted.sensor.info)

    @property
    def time_ns(self) -> int:
        """Simulated time, ns."""
        return self.simulation.time_ns

    def advance(self, until_ns: int) -> list[Reading]:
        """Simulate until the next measurement, or until `until_ns`; see Plant.advance."""
        simulation, readings = self.simulation, self._readings
        step = partial(simulation.step, compiled_controller=self._compiled_controller)
        if self.peak_speed is not None:
            step = self._step_recording_speeds
        if self._moving_models:
            step = partial(self._step_moving_targets, step)
        if self._exposures:
            step = partial(self._step_exposing, step)
        if self._tracked_link is not None:
            step = partial(self._step_tracking, step)
        while not readings and simulation.time_ns < until_ns:
            step(until_ns)
        self._readings = []
        return readings

    def command(self, kind: str, values: Sequence[float]) -> None:
        """Command all joints; see Plant.command."""
        if kind not in self.outputs:
            raise ExperimentError(
                f"the robot's controllers accept {', '.join(self.outputs)} commands, not {kind}"
            )
        for controller, value in zip(self._command_kind, values, strict=True):
            controller.set_command(value)

    def attach_loop(
        self, driver: LoopRunner, listener: JointListener, read_end_ns: Callable[[], float]
    ) -> None:
        """Process joint states in compiled code; see Plant.attach_loop."""
        from .compiled_arm_controller import CompiledArmController

        (kind,) = self.outputs
        self._compiled_controller = CompiledArmController(
            driver, listener, self._robot, self._joint_states, self.joint_names,
            partial(self.command, kind), read_end_ns,
        )  # fmt: skip

    def read_rest_pose(self) -> np.ndarray:
        """Return world_T_camera (4, 4) from the simulated link poses, without vibration.

        If the arm carries the target, the pose is given in the frame of the link that carries it.
        """
        pose = self._model.link_pose(self._link).matrix() @ self._link_T_camera
        if not self._carrier:
            return pose
        return relative_pose(self._model.link_pose(self._carrier).matrix(), pose)

    def compute_rest_poses(self, positions: np.ndarray) -> np.ndarray:
        """Compute camera poses from the robot description; see Plant.compute_rest_poses."""
        return self._model.pose().matrix() @ self._arm.poses(positions)

    def joint_origins(self, positions: np.ndarray) -> np.ndarray:
        """Compute the joint origins from the robot description; see Plant.joint_origins."""
        world_T_base = self._model.pose().matrix()
        return self._arm.joint_origins(positions) @ world_T_base[:3, :3].T + world_T_base[:3, 3]

    def read_joints(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the simulated positions (n,) and velocities (n,); see Plant.read_joints."""
        positions, velocities = self._model.read_joints()[:2]
        return np.array(positions)[self._rows], np.array(velocities)[self._rows]

    def find_collision(self) -> tuple[str, str] | None:
        """Return a link that collided in the last simulation step, and the model that it hit."""
        for overlap in find_overlaps(self.simulation.world, self._model):
            return overlap.link, overlap.model
        return None

    def close(self) -> None:
        """Close the simulation."""
        self.simulation.close()

    def _record_target_pose(self) -> None:
        """Record the current pose of the target, which is a link of a model in the world."""
        tracked = self._tracked_link
        pose = self.simulation.world.models[tracked.model].link_pose(tracked.link)
        tracked.pose_history.add(self.time_ns / NANOSECONDS, pose.matrix())

    def _step_tracking(self, step: Callable[[int], None], until_ns: int) -> None:
        """Make steps, and record the target's pose before and after a step with an exposure."""
        image_ns = self.simulation.next_image_ns()
        step(until_ns if image_ns is None else min(until_ns, image_ns - 1))
        self._record_target_pose()

    def _step_recording_speeds(self, until_ns: int) -> None:
        self.simulation.step()
        np.maximum(self.peak_speed, np.abs(self.read_joints()[1]), out=self.peak_speed)

    def _step_moving_targets(self, step: Callable[[int], None], until_ns: int) -> None:
        """Set moving targets and occluders to their poses at the end of the step, then step."""
        time_ns = self.simulation.time_ns + self.simulation.step_ns
        for target, model in self._moving_models:
            model.set_pose(target.compute_pose(time_ns / NANOSECONDS))
        step(time_ns)

    def _step_exposing(self, step: Callable[[int], None], until_ns: int) -> None:
        """Make a step; make the exposures that are due in it, at interpolated camera poses."""
        due, simulation = min(e.due_ns for e in self._exposures), self.simulation
        start = simulation.time_ns
        end = start + simulation.step_ns
        if end < due:
            step(min(until_ns, due - simulation.step_ns))
            return
        before = self.read_rest_pose()
        step(end)
        motion = logarithm(relative_pose(before, self.read_rest_pose()))
        for exposure in self._exposures:
            while exposure.due_ns <= end:
                fraction = (exposure.due_ns - start) / simulation.step_ns
                pose = before @ exponential(fraction * motion)
                if (frame := exposure.expose(pose)) is not None:
                    self._readings.append(frame)

    def _on_joints(self, state: Any) -> None:
        self._readings.append(
            JointReading(state.stamp_ns, tuple(state.names), state.positions, state.velocities)
        )

    def _on_frame(self, camera: str, frame: Any) -> None:
        mask = None
        if self._labels is not None and frame.segmentation is not None:
            mask = self._labels.make_mask(frame.segmentation)
        self._readings.append(Frame(
            frame.stamp_ns, frame.image, frame.encoding, frame.depth, name=camera, target_mask=mask,
        ))  # fmt: skip


@lru_cache(maxsize=64)
def _parse_target(urdf: Path) -> RobotDescription:
    return parse_urdf(urdf.read_text(encoding="utf-8"))


def _rename_camera(camera: CameraDescription, name: str, robot: Robot) -> CameraDescription:
    """Copy the description of the robot's camera, with another camera's name and optical frame."""
    # A camera without a plug-in gets one, because the plug-in stores the camera's name.
    plugin = replace(
        camera.plugin or CameraPlugin(), camera_name=name, robot_namespace="", trigger_topic=""
    )
    renamed = replace(camera, name=name, plugin=plugin, shutter="")
    frame = robot.find_optical_frame(name)
    if frame == robot.find_optical_frame("") and robot.has_camera_on(camera.link):
        return renamed
    return replace(renamed, link=frame, pose=_compute_sensor_pose())


def _make_default_camera(frame: str) -> CameraDescription:
    """Make a camera with SDF's default settings, for a robot description without a camera."""
    return CameraDescription(
        CAMERA, frame, _compute_sensor_pose(), "camera", 0.0, 1.047, 320, 240, "R8G8B8", 0.1, 100.0
    )


def _compute_sensor_pose() -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the pose of a sensor frame (x forward, z up) in its optical frame, m and rad."""
    xyz, rpy = xyz_rpy_from_matrix(inverse(optical_pose(np.eye(4))))
    return tuple(xyz), tuple(rpy)
