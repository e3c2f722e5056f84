"""The whole: physics world, robots with controllers, cameras, and one step() for all of it."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Protocol

import numpy as np

from aras_sim_bridge import cycle
from aras_sim_bridge.camera import CameraConfig, CameraSensor
from aras_sim_bridge.camera.config import derive_seed
from aras_sim_bridge.camera.mounting import (
    MountedCamera,
    configure_robot_camera,
    configure_world_camera,
    find_simultaneous,
)
from aras_sim_bridge.camera.sensor import NEVER
from aras_sim_bridge.control.hardware import RobotHardware
from aras_sim_bridge.control.loop import ControlLoop
from aras_sim_bridge.control.manager import ControllerManager
from aras_sim_bridge.control.stability import report_stability
from aras_sim_bridge.control.switching import STRICT
from aras_sim_bridge.description import CameraDescription, Light, RobotDescription
from aras_sim_bridge.description.lights import check_light
from aras_sim_bridge.description.types import SUN, SceneSettings, is_present
from aras_sim_bridge.errors import (
    CameraError,
    DescriptionError,
    RenderingError,
    SimError,
    WorldError,
)
from aras_sim_bridge.rendering import EXPOSURES, Lighting, create_renderer
from aras_sim_bridge.sensors import KINDS, RateSensor
from aras_sim_bridge.world import Model, Pose, World
from aras_visual_servo_base.poses import IDENTITY

if TYPE_CHECKING:
    from aras_sim_bridge.control.controllers.joint_state import JointStateController
    from aras_sim_bridge.rendering.renderer import Renderer
    from aras_sim_bridge.world import GraspFix

MOST_LIGHTS = 16  # that pictures are lit by
DARK = (0.0, 0.0, 0.0, 1.0)
NO_LIGHT = Light("none", diffuse=DARK)
log = logging.getLogger(__name__)
CycleFunction = Callable[..., tuple[int, int, int]]


@dataclass(frozen=True)
class SimulationConfig:
    """Settings of a simulation: physics, light and noise.

    Attributes:
        time_step: physics step, s.
        gravity: (x, y, z) in the world, m/s².
        gui: whether PyBullet's window opens.
        renderer: name of the renderer; all names mean one.
        seed: of the noise of cameras and sensors.
        legacy_camera_info: whether camera_info is that of the original's camera plugin.
        ground_plane: whether Gazebo's ground plane is in the world.
        lights: of the world; images are lit by the first MOST_LIGHTS.
        scene: ambient light, background, sky and shadows.
        exposure: how light becomes grey levels, one of rendering.EXPOSURES.
    """

    time_step: float = 0.001
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.8)
    gui: bool = False
    renderer: str = "auto"
    seed: int = 0
    legacy_camera_info: bool = False
    ground_plane: bool = True
    lights: tuple[Light, ...] = (SUN,)
    scene: SceneSettings = SceneSettings()
    exposure: str = EXPOSURES[0]


@dataclass(frozen=True, eq=False)
class ControlledModel:
    """A model under ros_control: one control plugin's hardware and controllers."""

    name: str
    namespace: str
    model: Model
    hardware: RobotHardware
    manager: ControllerManager
    loop: ControlLoop

    def start(self, controllers: Iterable[str]) -> None:
        """Load these controllers and let them run from the next step on.

        Raises:
            ControllerError: one cannot be loaded; those loaded before it stay so.
        """
        names = list(controllers)
        for name in names:
            self.manager.load(name)
        self.manager.switch(names, [], STRICT)

    def command(self, controller: str, value: object) -> None:
        """Hand `value` to a controller, in its own units; it acts in the next step.

        Raises:
            ControllerError: no such controller, or a value that it cannot use.
        """
        self.manager.get(controller).set_command(value)

    def report_stability(self, step: float) -> str:
        """One line where steps of `step` s make the running PIDs unstable; see stability."""
        text = report_stability(self.hardware, self.manager.running, self.model.joint_names,
                       self.model.joints.inverse_inertia, step)
        return f"model '{self.name}': {text}" if text else ""


class CompiledController(Protocol):
    """Answers what a controller samples with commands, in compiled cycles."""

    def start_cycles(self, time_ns: int, until_ns: int) -> JointStateController | None:
        """The controller whose samples cycles at these times (ns) answer; None: they do not."""

    def run_cycles(self, *arguments: object) -> tuple[int, int, int]:
        """As cycle.cycles, which ends where Python has to look."""


class Simulation:
    """A simulated world with its models, robots and cameras, stepped by its caller.

    One `step` follows Gazebo's order: time, controllers, physics, then the cameras and sensors that
    are due. Time is simulated time alone; no clock is read. Lengths
    are in m, angles in rad.

    Programs without ROS use `spawn`, `robots[name].start` and `.command`,
    `robots[name].manager.get(...).on_state` for joint states, `camera(name)` with its `enabled`,
    `on_frame`, `parent_T_optical` and `sensor.info`, `step`, `time_ns`, `step_ns`, the model's
    `joint_names`, `read_joints` and `link_pose`, and `close`. These stay as they are;
    tests/unit/world/test_simulation_use.py tests them.

    Attributes:
        world: physics. robots: by model name. cameras, sensors, grasps: in spawn order. lights: by
            name.
        time_ns: simulated time. step_ns: the physics step.
        before_pictures: called with the simulated time [ns] when cameras are about to draw or to
            deliver, or None.
    """

    def __init__(self, config: SimulationConfig | None = None) -> None:
        """Make a world with nothing but the ground.

        Raises:
            SimError: the config is impossible.
        """
        self.config = config or SimulationConfig()
        self.world = World(self.config.time_step, self.config.gravity, self.config.gui)
        self.time_ns = 0
        self.step_ns = round(self.config.time_step * 1e9)
        self.robots: dict[str, ControlledModel] = {}
        self.cameras: list[MountedCamera] = []
        self.sensors: list[RateSensor] = []
        self.grasps: list[GraspFix] = []
        self.before_images: Callable[[int], None] | None = None
        self._renderer: Renderer | None = None
        self.lights: dict[str, Light] = {}
        for light in self.config.lights:
            self.set_light(light)
        if self.config.ground_plane:
            self.world.spawn_ground_plane()

    def spawn(
        self,
        description: RobotDescription,
        name: str,
        pose: Pose = IDENTITY,
        namespace: str = "",
        parameters: Mapping[str, object] | None = None,
        joint_positions: Mapping[str, float] | None = None,
        cameras: Mapping[str, object] | None = None,
    ) -> Model:
        """Put a model into the world, with its controllers' hardware and its cameras.

        Args:
            namespace: the robot's, without trailing slash; parameters: what ROS has below it.
            cameras: settings laid over the sensors', nested by the parts of the camera's name. An
                impossible camera is left out and logged; the model is spawned all the same.

        Raises:
            SimError: saying what is wrong; the world is as before then.
        """
        if len(description.control_plugins) > 1:
            raise DescriptionError(
                f"model '{name}' has {len(description.control_plugins)} gazebo_ros_control plugins;"
                " keep one"
            )
        namespace = namespace.rstrip("/")
        if description.control_plugins:
            self._check_namespace(namespace, name)
        model = self.world.spawn(description, name, pose, joint_positions)
        try:
            robot = self._make_robot(model, namespace, parameters or {})
        except SimError:
            self.world.delete(name)
            raise
        if robot is not None:
            self.robots[name] = robot
        for body in model.bodies:
            for camera in body.description.cameras:
                self._mount(body, camera, cameras or {})
            for sensor in body.description.sensors:
                seed = derive_seed(self.config.seed, f"{name} {sensor.kind} {sensor.topic}")
                self.sensors.append(KINDS[sensor.kind](sensor, body, self.world, seed))
        if description.grasps:
            from aras_sim_bridge.world import GraspFix  # which few robots have

            self.grasps += [GraspFix(grasp, model, self.world) for grasp in description.grasps]
        return model

    def delete(self, name: str) -> None:
        """Take a model out, with its controllers and cameras; WorldError when there is none."""
        model = self.world.model(name)
        robot = self.robots.pop(name, None)
        if robot is not None:
            robot.manager.shutdown()
        self.cameras = [one for one in self.cameras if one.model not in model.bodies]
        self.sensors = [one for one in self.sensors if one.model not in model.bodies]
        self.grasps = [one for one in self.grasps if one.model is not model]
        self.world.delete(name)

    def light(self, name: str) -> Light:
        """The light called `name`; WorldError naming those that exist."""
        if name not in self.lights:
            known = ", ".join(self.lights) or "none"
            raise WorldError(f"light '{name}' does not exist; there are: {known}")
        return self.lights[name]

    def set_light(self, light: Light) -> None:
        """Add a light or change the one of its name; one too many is kept and logged.

        Raises:
            WorldError: a number that no light has; nothing is changed then.
        """
        new = light.name not in self.lights
        self.lights[light.name] = check_light(light)
        if new and len(self.lights) > MOST_LIGHTS:
            log.warning(
                "light '%s' is one too many: pictures are lit by the first %d, which are not to be "
                "deleted for it to count", light.name, MOST_LIGHTS
            )
        if self._renderer is not None:
            self._renderer.light = self._compute_lighting()

    def delete_light(self, name: str) -> None:
        """Take a light away; WorldError naming those that exist."""
        del self.lights[self.light(name).name]
        if self._renderer is not None:
            self._renderer.light = self._compute_lighting()

    def _compute_lighting(self) -> Lighting:
        """The light that cameras see by now."""
        lights = tuple(self.lights.values())[:MOST_LIGHTS]
        now = tuple(
            light
            if is_present(light.lit_intervals, self.time_ns / 1e9)
            else replace(light, diffuse=DARK)
            for light in lights
        )
        light = self._combine_lights(lights)
        return (
            light
            if now == lights
            else replace(self._combine_lights(now), reference_white_level=light.white_level)
        )

    def _combine_lights(self, lights: tuple[Light, ...]) -> Lighting:
        """Of these lights: where one white sun without shadows is all, as that."""
        scene = self.config.scene
        ambient = max(scene.ambient[:3])
        tint = tuple(part / (ambient or 1.0) for part in scene.ambient[:3])
        around = Lighting(diffuse=0.0, ambient=ambient, tint=tint, background=scene.background,
                     sky=scene.sky, exposure=self.config.exposure, shadows=scene.shadows)
        shadows = scene.shadows != "none" and any(light.cast_shadows for light in lights)
        if len(set(tint)) == 1 and len(lights) <= 1 and not shadows:
            if not lights:
                return around
            (light,) = lights
            if light.kind == "directional" and len(set(light.diffuse[:3])) == 1:
                return replace(around, direction=light.direction, diffuse=light.diffuse[0])
        return replace(around, lights=lights or (NO_LIGHT,))

    def step(
        self, until_ns: int = 0, compiled_controller: CompiledController | None = None
    ) -> None:
        """Simulate one time step in Gazebo's order: time, controllers, physics, sensors.

        Args:
            until_ns: simulated time, ns. As many steps as end up to then are made in one compiled
                call, but none beyond the next one that a camera, a listener or a controller in
                Python takes part in. The result is the same as of single steps.
            answers: what reads the joints in that call, and commands them.
        """
        began_ns, time_ns = self.time_ns, self.time_ns + self.step_ns
        cameras = [camera for camera in self.cameras if camera.enabled]
        sensors = [sensor for sensor in self.sensors if sensor.enabled]
        for looks in (*cameras, *sensors, *self.grasps):
            until_ns = min(until_ns, looks.idle_until_ns)
        begun = self._start_cycles(time_ns, max(until_ns, time_ns), compiled_controller)
        if begun is None:
            for robot in self.robots.values():
                robot.loop.step(time_ns)
        for looks in (*cameras, *sensors):
            looks.before_step(began_ns, time_ns)
        if begun is None:
            self.world.step()
            self.time_ns = time_ns
        else:
            self._run_cycles(max(until_ns, time_ns), *begun)
        for sensor in sensors:
            sensor.after_step(self.time_ns)
        for sensor in sensors:
            sensor.model.applied_forces.clear()
        for grasp in self.grasps:
            grasp.after_step(self.time_ns)
        due = [camera for camera in cameras if camera.sensor.is_due(self.time_ns)]
        if due and self.before_images is not None:
            self.before_images(self.time_ns)
        if due and any(light.lit_intervals is not None for light in self.lights.values()):
            self._renderer.light = self._compute_lighting()
        for camera in due:
            camera.after_step(self.time_ns)

    def _start_cycles(
        self, time_ns: int, until_ns: int, compiled_controller: CompiledController | None
    ) -> tuple[ControlledModel, CycleFunction, tuple, np.ndarray, float] | None:
        """The one robot, if it moves alone and Python takes no part in the tick that ends at
        `time_ns`; what makes its cycles, and what World.alone and ControlLoop.begin answer."""
        if len(self.robots) != 1:
            return None
        (robot,) = self.robots.values()
        physics = self.world.get_compiled_step(robot.model)
        if physics is None:
            return None
        sampled = (
            None
            if compiled_controller is None
            else compiled_controller.start_cycles(time_ns, until_ns)
        )
        begun = robot.loop.start_cycles(time_ns, self.step_ns, sampled)
        cycles = cycle.run_cycles if sampled is None else compiled_controller.run_cycles
        return None if begun is None else (robot, cycles, physics, *begun)

    def _run_cycles(
        self,
        until_ns: int,
        robot: ControlledModel,
        cycles: CycleFunction,
        physics: tuple,
        loops: np.ndarray,
        idle_ns: float,
    ) -> None:
        """Compiled ticks up to `until_ns`, or `idle_ns`; WorldError where one diverges."""
        began_ns, step_ns, hardware = self.time_ns, self.step_ns, robot.hardware
        count = min(
            int(min(until_ns, idle_ns) - began_ns) // step_ns, self.world.steps_until_contact
        )
        made, end, bad = cycles(
            count, began_ns, step_ns, loops, hardware.handle_rows, hardware.drive_rows, *physics
        )
        robot.loop.end_cycles(began_ns + (made + (end == cycle.NOT_FINITE)) * step_ns)
        self.time_ns = began_ns + (made - (end == cycle.DIVERGED)) * step_ns
        if end != cycle.ALL_MADE:
            hardware.log_warnings()
        self.world.finish_compiled_steps(robot.model, made, bad, end != cycle.BASE_UNSUPPORTED)
        if end == cycle.NOT_FINITE:
            hardware.apply(self.time_ns)
            robot.model.check_efforts()

    def next_image_ns(self) -> int | None:
        """When a camera next has something to do, ns; None: none has. The step that contains it
        ends later, by less than a step."""
        due = (camera.sensor.due_ns for camera in self.cameras if camera.enabled)
        return min((at_ns for at_ns in due if self.time_ns < at_ns < NEVER), default=None)

    def set_joint_positions(self, name: str, positions: Mapping[str, float]) -> None:
        """Put joints of a model at `positions` (rad or m), at rest; mimicking ones follow.

        A joint that takes position commands stays there until it gets one.

        Raises:
            WorldError: unknown model or joint, or a number that is not finite; nothing is changed.
        """
        (self.world.models.get(name) or self.world.model(name)).set_joint_positions(positions)
        if name in self.robots:
            self.robots[name].hardware.hold_positions(positions)

    def reset_world(self) -> None:
        """Models back to their spawn poses; time and joint angles stay."""
        self.world.reset_world()
        for robot in self.robots.values():
            robot.loop.reset()

    def reset_simulation(self) -> None:
        """Everything as spawned, at time 0; controllers begin anew towards their set points."""
        self.world.reset_simulation()
        self.time_ns = 0
        for robot in self.robots.values():
            robot.loop.restart()
        for camera in self.cameras:
            camera.sensor.reset(0)
        for listener in (*self.sensors, *self.grasps):
            listener.reset()

    def set_physics(
        self, time_step: float, gravity: tuple[float, float, float], solver_iterations: int
    ) -> None:
        """Change the engine's settings; WorldError, and nothing changed, when impossible."""
        self.world.set_physics(time_step, gravity, solver_iterations)
        self.step_ns = round(time_step * 1e9)

    def close(self) -> None:
        """Give everything back; safe to call twice."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
        self.world.close()

    def _check_namespace(self, namespace: str, name: str) -> None:
        """WorldError where a robot has the controller manager of `namespace` already."""
        for robot in self.robots.values():
            if robot.namespace == namespace and robot.name != name:
                raise WorldError(
                    f"model '{name}': its robot namespace {namespace or '/'} is that of model "
                    f"'{robot.name}', whose controllers are served there; give it another one: "
                    "<robotNamespace> of its gazebo_ros_control plugin, or robot_namespace of the "
                    "request where the plugin has none"
                )

    def _make_robot(
        self, model: Model, namespace: str, parameters: Mapping[str, object]
    ) -> ControlledModel | None:
        for plugin in model.description.control_plugins:
            hardware = RobotHardware(
                model.description, model, parameters, namespace, log.warning
            )
            manager = ControllerManager(hardware, parameters, namespace, log.warning, log.error)
            period = plugin.control_period
            period_ns = None if period is None else round(period * 1e9)
            loop = ControlLoop(hardware, manager, self.step_ns, period_ns)
            robot = ControlledModel(model.name, namespace, model, hardware, manager, loop)
            manager.on_started = partial(self._warn_if_unstable, robot)
            return robot
        return None

    def _warn_if_unstable(self, robot: ControlledModel) -> None:
        """Say where the PIDs of the controllers that were started will not hold their joints."""
        if text := robot.report_stability(self.world.time_step):
            log.warning("%s", text)

    def camera(self, name: str) -> MountedCamera:
        """The camera whose topics stand below `name` ('/labrob/camera').

        Raises:
            WorldError: there is none; names those that exist.
        """
        for camera in self.cameras:
            if camera.sensor.config.topic_root == name:
                return camera
        known = ", ".join(camera.sensor.config.topic_root for camera in self.cameras) or "none"
        raise WorldError(f"camera '{name}' does not exist; there are: {known}")

    def add_camera(self, name: str, settings: Mapping[str, object]) -> MountedCamera:
        """Put a camera into the world, fixed; see mounting.world_camera. Raises CameraError."""
        config, pose = configure_world_camera(
            name, settings, self._get_camera_defaults(), self.config.seed
        )
        mounted = MountedCamera(self._make_camera_sensor(config), None, "world", pose)
        self.cameras.append(mounted)
        return mounted

    def _mount(
        self, model: Model, camera: CameraDescription, settings: Mapping[str, object]
    ) -> None:
        """Mount one camera of a description. One that is impossible must not cost the robot."""
        try:
            config = configure_robot_camera(
                camera, settings, self._get_camera_defaults(), self.config.seed
            )
            mounted = MountedCamera(self._make_camera_sensor(config), model, camera.link)
        except (CameraError, RenderingError) as error:
            log.error("model '%s' goes without its camera '%s': %s", model.name, camera.name, error)
            return
        self.cameras.append(mounted)
        first = find_simultaneous(mounted, self.cameras)[0].sensor
        if mounted.sensor.rate != first.rate:
            log.warning(
                "camera '%s' exposes together with camera '%s', at its %g Hz instead of %g Hz",
                camera.name, first.config.name, first.rate, mounted.sensor.rate,
            )
            mounted.sensor.set_rate(first.rate, self.time_ns, self.step_ns)

    def _get_camera_defaults(self) -> dict[str, object]:
        return {"legacy_camera_info": self.config.legacy_camera_info}

    def _make_camera_sensor(self, config: CameraConfig) -> CameraSensor:
        for camera in self.cameras:
            taken = config.names & camera.sensor.config.names
            if taken:
                owner = f" of model '{camera.model.name}'" if camera.model is not None else ""
                raise CameraError(
                    f"camera '{config.name}': camera '{camera.sensor.config.name}'{owner} has the "
                    f"name {min(taken)} already; give one of them another cameraName or "
                    "robotNamespace"
                )
        if self._renderer is None:
            self._renderer = create_renderer(
                self.config.renderer, self.world, self._compute_lighting()
            )
        sensor = CameraSensor(config, self._renderer)
        sensor.check_time_step(self.step_ns)
        sensor.reset(self.time_ns)
        return sensor
