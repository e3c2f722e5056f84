"""The simulated arm: Bullet's physics, ros_control's controllers, rendered pictures."""

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
from aras_sim_bridge.description.types import within
from aras_sim_bridge.description.world_file import WorldFile
from aras_sim_bridge.errors import SimError
from aras_sim_bridge.rendering import EXPOSURES
from aras_sim_bridge.simulation import Simulation, SimulationConfig
from aras_sim_bridge.world.labels import links_by_label
from aras_sim_bridge.world.model import Model
from aras_sim_bridge.world.overlaps import overlaps
from aras_visual_servo_base.poses import (
    Pose,
    exponential,
    inverse,
    logarithm,
    optical,
    relative,
    to_xyz_rpy,
    transform,
)
from aras_visual_servo_camera.errors import SegmentationError
from aras_visual_servo_camera.labels import TargetLabels
from aras_visual_servo_controller.seeing.frame import Frame

from ..asked import cameras
from ..asked.robots import ROBOT, Robot, camera_name
from ..errors import ExperimentError
from ..targets.geometry import Course, PlacedTarget
from .base import CAMERA, JointListener, JointReading, Plant, Reading
from .sight import Sight, exposures, vibrations

if TYPE_CHECKING:
    from aras_visual_servo_controller.driving.driver import Driver

TARGET, OCCLUDER = "target", "occluder"
NS = 1_000_000_000
OUT_OF_SIGHT = Pose((0.0, 0.0, -1e4), (0.0, 0.0, 0.0, 1.0))
NO_OTHERS: Mapping[str, Mapping[str, Any]] = {}


@dataclass(frozen=True, eq=False)
class ShownTarget:
    """A target that is a model of its own in the simulated world, or what lies on it.

    placed: where it lies. urdf: what is drawn of it.
    lies_at: x, y, z (m) of the model's origin in the target's frame.
    times: from when and until when it is there, s; None: always. name: of the model.
    """

    placed: PlacedTarget
    urdf: Path
    lies_at: tuple[float, float, float] = (0.0, 0.0, 0.0)
    times: tuple[tuple[float, float], ...] | None = None
    name: str = TARGET

    @property
    def still(self) -> bool:
        """Whether it is always there, in one place."""
        return self.times is None and self.placed.motion.still

    def pose(self, time: float) -> Pose:
        """The model's in the world at `time` (s); out of sight while it is not there."""
        if not within(self.times, time):
            return OUT_OF_SIGHT
        world_T_target = self.placed.world_T_target(time)
        return Pose.from_matrix(world_T_target @ transform(self.lies_at, (0.0,) * 3))


@dataclass(frozen=True, eq=False)
class Followed:
    """A link of a model of the world that is the target; its poses are noted in `course`."""

    model: str
    link: str
    course: Course


class BulletArm(Plant):
    """The robot in the bridge's Simulation, spawned at its start; one thousand steps a second."""

    def __init__(
        self,
        robot: Robot,
        camera: Mapping[str, Any],
        joints: Mapping[str, float],
        seed: int = 0,
        renderer: str = "auto",
        traced: bool = False,
        shown: Sequence[ShownTarget] = (),
        sights: Sequence[Sight] = (),
        around: WorldFile = WorldFile(),  # noqa: B008 (frozen)
        name: str = "",
        others: Mapping[str, Mapping[str, Any]] = NO_OTHERS,
        exposure: str = EXPOSURES[0],
        label: str = "",
        followed: Followed | None = None,
    ) -> None:
        """Spawn the robot at these joints, controllers and camera running.

        Args:
            camera: settings of the control camera, laid over the description's camera.
            joints: positions by name, rad or m.
            traced: keep every step's joint velocities, for `peak_speed`.
            shown: what is put into the world: the target, unless the robot brings its own, and what
                lies on it.
            sights: see in place of the cameras, the control camera first, from where the physics
                has that at each exposure; nothing is drawn then. None: the cameras.
            around: what stands and shines around the robot.
            name: of the control camera; '': the robot's own, the only one.
            others: settings of the other cameras, by name; `robot` says where they sit.
            exposure: how the light becomes grey levels, one of EXPOSURES.
            label: model, or 'model::link', of which the label images tell the pixels; '': none do.
            followed: the target, where it is a link of the world's.

        Raises:
            ExperimentError: what of it is impossible.
        """
        description = robot.description()
        mounted = [c for c in description.cameras if robot.spec.camera in ("", camera_name(c))]
        if robot.spec.camera and not mounted:
            known = ", ".join(map(camera_name, description.cameras)) or "none"
            raise ExperimentError(f"the robot has no camera '{robot.spec.camera}'; it has: {known}")
        self._name, self._others = name or CAMERA, others
        self.control = self._name
        first = mounted[0] if mounted else _bare(robot.frame(""))
        if not (name or mounted and robot.carries_camera(first.link)):
            name = CAMERA  # it sits at a frame of the description that has no sensor there
        self._link = first.link
        own: dict[str, Any] = {}
        for part in reversed(camera_name(first).split("/")):
            own = {part: own or dict(camera)}
        for settings in (camera, *others.values()):
            cameras.model_of(settings)  # the simulator would go on without an impossible camera
        if name:
            described = [_seated(first, eye, robot) for eye in (name, *others)]
            own, self._link = {name: dict(camera), **others}, described[0].link
            description = replace(description, cameras=tuple(described))
        else:
            name = camera_name(first)
        self._arm = robot.arm(self._name)
        self.joint_names = self._arm.names
        controllers, kind = robot.controllers(self.joint_names)
        self.outputs = frozenset((kind,))
        self._controllers = list(controllers.values())
        self._readings: list[Reading] = []
        self._carried: list[tuple[ShownTarget, Model]] = []
        self._peak = np.zeros(len(self.joint_names)) if traced else None
        self._exposures = [] if not sights else exposures(
            sights[0], sights[1:], np.random.default_rng(seed), seed
        )
        self.vibrations = vibrations(*sights)
        self._simulation = Simulation(
            SimulationConfig(
                renderer=renderer, seed=seed, lights=around.lights, scene=around.scene,
                ground_plane=around.ground_plane, exposure=exposure,
            )
        )
        try:
            world_file.populate(self._simulation.spawn, around)
            self._spawn(robot, description, name, own, joints)
            for one in shown:
                self._place(one)
            self._followed = followed
            self._follow()
            self._labels = None
            if label:
                self._labels = TargetLabels(label)
                self._labels.name(links_by_label(self._simulation.world.models))
                self._labels.numbers()
        except (SimError, SegmentationError) as error:
            self.close()
            raise ExperimentError(str(error)) from error

    def _spawn(
        self,
        robot: Robot,
        description: Any,
        camera: str,
        settings: Mapping[str, Any],
        joints: Mapping[str, float],
    ) -> None:
        simulation, spec = self._simulation, robot.spec
        simulation.spawn(
            description, ROBOT, namespace=spec.namespace, parameters=robot.parameters,
            joint_positions=joints, cameras=settings,
        )  # fmt: skip
        self._robot = simulation.robots[ROBOT]
        self._model = self._robot.model
        self._rows = [self._model.joint_names.index(name) for name in self.joint_names]
        self._robot.start([spec.joint_states, *self._controllers])
        # As the switching service does while time stands still: so controllers run, and commands
        # count, from the first step on, and joint states come in the graph's rhythm.
        self._robot.hardware.read()
        self._robot.manager.carry_out(simulation.time_ns)
        self._joint_states, self._answers = spec.joint_states, None
        self._robot.manager.get(spec.joint_states).on_state = self._on_joints
        self._commanded = [self._robot.manager.get(name) for name in self._controllers]
        mounted = simulation.camera(f"/{camera}")
        for name, one in {self._name: mounted, **{
            name: simulation.camera(f"/{name}") for name in self._others
        }}.items():
            one.on_frame, one.enabled = partial(self._on_frame, name), not self._exposures
            if one.sensor.vibration is not None and not self._exposures:
                self.vibrations = {**self.vibrations, name: one.sensor.vibration}
        self._link_T_camera = np.array(mounted.parent_T_optical)
        self._carrier = robot.target_frame(self._name)
        self.camera = cameras.model_of_info(mounted.sensor.info)

    def _place(self, target: ShownTarget) -> None:
        """Put a target into the world; one that moves is where it belongs at every step."""
        described = _target_description(target.urdf)
        model = self._simulation.spawn(described, target.name, target.pose(0.0))
        if not target.still:
            self._carried.append((target, model))

    @property
    def time_ns(self) -> int:
        """Simulated time, ns."""
        return self._simulation.time_ns

    @property
    def simulation(self) -> Simulation:
        """The simulated world, with the models `robot` and `target`: for grippers and whatever an
        experiment does not do itself."""
        return self._simulation

    def advance(self, until_ns: int) -> list[Reading]:
        """Step until something was measured or `until_ns` is reached."""
        simulation, readings = self._simulation, self._readings
        step = partial(simulation.step, answers=self._answers)
        if self._peak is not None:
            step = self._traced_step
        if self._carried:
            step = partial(self._carrying_step, step)
        if self._exposures:
            step = partial(self._exposing_step, step)
        while not readings and simulation.time_ns < until_ns:
            step(until_ns)
            self._follow()
        self._readings = []
        return readings

    def command(self, kind: str, values: Sequence[float]) -> None:
        """Command all joints."""
        if kind not in self.outputs:
            raise ExperimentError(
                f"the robot's controllers take {', '.join(self.outputs)} commands, not {kind}"
            )
        for controller, value in zip(self._commanded, values, strict=True):
            controller.set_command(value)

    def join(
        self, driver: Driver, listener: JointListener, last_ns: Callable[[], float]
    ) -> None:
        """See Plant.join."""
        from .answers import ArmAnswers  # here, because many plants are no arms

        (kind,) = self.outputs
        self._answers = ArmAnswers(
            driver, listener, self._robot, self._joint_states, self.joint_names,
            partial(self.command, kind), last_ns,
        )  # fmt: skip

    def at_rest(self) -> np.ndarray:
        """world_T_camera (4, 4) from the physics; in the target's link where the arm moves that."""
        pose = self._model.link_pose(self._link).matrix() @ self._link_T_camera
        if not self._carrier:
            return pose
        return relative(self._model.link_pose(self._carrier).matrix(), pose)

    def poses(self, positions: np.ndarray) -> np.ndarray:
        """See Plant.poses; by the true robot's description, which spares Bullet being asked in
        between."""
        return self._model.pose().matrix() @ self._arm.poses(positions)

    def places(self, positions: np.ndarray) -> np.ndarray:
        """See Plant.places."""
        world_T_base = self._model.pose().matrix()
        return self._arm.places(positions) @ world_T_base[:3, :3].T + world_T_base[:3, 3]

    def joints(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities from the physics."""
        positions, velocities = self._model.read_joints()[:2]
        return np.array(positions)[self._rows], np.array(velocities)[self._rows]

    def touched(self) -> tuple[str, str] | None:
        """See Plant.touched; at the last step."""
        for found in overlaps(self._simulation.world, self._model):
            return found.link, found.model
        return None

    @property
    def peak_speed(self) -> np.ndarray | None:
        """Greatest speed (n,) of each joint at any step; None where it is not traced."""
        return self._peak

    def close(self) -> None:
        """End the simulation."""
        self._simulation.close()

    def _follow(self) -> None:
        """Note where the target is that the simulation moves."""
        if self._followed is None:
            return
        pose = self._simulation.world.models[self._followed.model].link_pose(self._followed.link)
        self._followed.course.add(self.time_ns / NS, pose.matrix())

    def _traced_step(self, until_ns: int) -> None:
        self._simulation.step()
        np.maximum(self._peak, np.abs(self.joints()[1]), out=self._peak)

    def _carrying_step(self, step: Callable[[int], None], until_ns: int) -> None:
        """A step that ends with the target, and what lies on it, where they belong then."""
        simulation = self._simulation
        time_ns = simulation.time_ns + simulation.step_ns
        for target, model in self._carried:
            model.set_pose(target.pose(time_ns / NS))
        step(time_ns)

    def _exposing_step(self, step: Callable[[int], None], until_ns: int) -> None:
        """A step in whose course `sights` may look: from between the poses at its ends."""
        due, simulation = min(one.due_ns for one in self._exposures), self._simulation
        began = simulation.time_ns
        ended = began + simulation.step_ns
        if ended < due:
            step(min(until_ns, due - simulation.step_ns))
            return
        before = self.at_rest()
        step(ended)
        moved = logarithm(relative(before, self.at_rest()))
        for one in self._exposures:
            while one.due_ns <= ended:
                pose = before @ exponential((one.due_ns - began) / simulation.step_ns * moved)
                if (seen := one.expose(pose)) is not None:
                    self._readings.append(seen)

    def _on_joints(self, state: Any) -> None:
        self._readings.append(
            JointReading(state.stamp_ns, tuple(state.names), state.positions, state.velocities)
        )

    def _on_frame(self, camera: str, frame: Any) -> None:
        labelled = None
        if self._labels is not None and frame.segmentation is not None:
            labelled = self._labels.mask(frame.segmentation)
        self._readings.append(Frame(
            frame.stamp_ns, frame.image, frame.encoding, frame.depth, name=camera,
            labelled=labelled,
        ))  # fmt: skip


@lru_cache(maxsize=64)
def _target_description(urdf: Path) -> RobotDescription:
    return parse_urdf(urdf.read_text(encoding="utf-8"))


def _seated(camera: CameraDescription, name: str, robot: Robot) -> CameraDescription:
    """The described camera under another name, where that one sits."""
    plugin = None if camera.plugin is None else replace(
        camera.plugin, camera_name=name, robot_namespace="", trigger_topic=""
    )
    seated = replace(camera, name=name, plugin=plugin, shutter="")
    frame = robot.frame(name)
    if frame == robot.frame("") and robot.carries_camera(camera.link):
        return seated
    return replace(seated, link=frame, pose=_in_optical_frame())


def _bare(frame: str) -> CameraDescription:
    """A camera at an optical frame of a robot without a camera, as SDF has it by default."""
    return CameraDescription(
        CAMERA, frame, _in_optical_frame(), "camera", 0.0, 1.047, 320, 240, "R8G8B8", 0.1, 100.0
    )


def _in_optical_frame() -> tuple[tuple[float, ...], tuple[float, ...]]:
    """xyz (m) and rpy (rad) in an optical frame of a sensor, which looks along its +x, z up."""
    xyz, rpy = to_xyz_rpy(inverse(optical(np.eye(4))))
    return tuple(xyz), tuple(rpy)
