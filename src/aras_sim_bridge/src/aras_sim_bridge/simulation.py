"""The complete simulation: physics world, controlled robots, cameras and sensors.

`Simulation.step` advances all of them by one time step.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Protocol

import numpy as np

from aras_sim_bridge import control_cycle
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
from aras_sim_bridge.sensors import KINDS, PeriodicSensor
from aras_sim_bridge.world import Model, Pose, World
from aras_visual_servo_base.poses import IDENTITY

if TYPE_CHECKING:
    from aras_sim_bridge.control.controllers.joint_state import JointStateController
    from aras_sim_bridge.rendering.renderer import Renderer
    from aras_sim_bridge.world import GraspFix

MOST_LIGHTS = 16  # largest number of lights that illuminate camera images
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
        gui: whether to open PyBullet's window.
        renderer: name of the renderer; all accepted names select the same renderer.
        seed: seed of the noise of cameras and sensors.
        legacy_camera_info: whether camera_info is computed with the formulas of gazebo_ros's camera
            plug-in.
        ground_plane: whether the world contains Gazebo's ground plane.
        lights: lights of the world; the first MOST_LIGHTS illuminate images.
        scene: ambient light, background, sky and shadows.
        exposure: conversion of light to grey levels, one of rendering.EXPOSURES.
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
    """A model with a gazebo_ros_control plugin: its hardware interface and its controllers."""

    name: str
    namespace: str
    model: Model
    hardware: RobotHardware
    manager: ControllerManager
    loop: ControlLoop

    def start(self, controllers: Iterable[str]) -> None:
        """Load these controllers and start them with the next step.

        Raises:
            ControllerError: a controller cannot be loaded; the controllers before it in the list
                stay loaded.
        """
        names = list(controllers)
        for name in names:
            self.manager.load(name)
        self.manager.switch(names, [], STRICT)

    def command(self, controller: str, value: object) -> None:
        """Set the command of a controller, in the controller's units, for the next step.

        Raises:
            ControllerError: the controller does not exist or rejects the value.
        """
        self.manager.get(controller).set_command(value)

    def report_stability(self, step: float) -> str:
        """Return a one-line warning if the running PIDs are unstable with a step of `step` s.

        The text is empty if all are stable; see control/stability.py.
        """
        text = report_stability(self.hardware, self.manager.running, self.model.joint_names,
                       self.model.joints.inverse_inertia, step)
        return f"model '{self.name}': {text}" if text else ""


class CompiledController(Protocol):
    """Controller that can run together with the physics in one compiled function.

    This function makes many control cycles, each with one physics step, without calling Python.
    """

    def start_cycles(self, time_ns: int, until_ns: int) -> JointStateController | None:
        """Prepare the control cycles from `time_ns` to `until_ns` (simulated time, ns).

        Return the joint state controller from which this controller takes joint states in these
        cycles, or None if it takes none.
        """

    def run_cycles(self, *arguments: object) -> tuple[int, int, int]:
        """Run compiled control cycles.

        Arguments and results are those of control_cycle.run_cycles.
        """


class Simulation:
    """A simulated world with models, robots and cameras that the caller advances step by step.

    One `step` follows Gazebo's order: time, controllers, physics, then the cameras and sensors that
    are due. All times are simulated; the simulation reads no clock. Lengths are in m, angles in
    rad.

    The stable interface for programs without ROS consists of:

    - `spawn`, `step`, `time_ns`, `step_ns` and `close`,
    - `robots[name].start` and `robots[name].command`,
    - `robots[name].manager.get(...).on_state` for joint states,
    - `enabled`, `on_frame`, `parent_T_optical` and `sensor.info` of `camera(name)`,
    - `joint_names`, `read_joints` and `link_pose` of a model.

    tests/unit/world/test_simulation_use.py tests this interface.

    Attributes:
        world: physics world.
        robots: controlled models by model name.
        cameras, sensors: cameras and sensors in the order in which they were added.
        grasps: grasp plug-ins (GraspFix) of all models.
        lights: lights by name.
        time_ns: simulated time, ns.
        step_ns: physics step, ns.
        before_images: function that is called before cameras render or deliver images, or None. Its
            argument is the simulated time, ns.
    """

    def __init__(self, config: SimulationConfig | None = None) -> None:
        """Create a simulation whose world contains only the ground plane and the lights.

        Raises:
            SimError: the configuration is invalid.
        """
        self.config = config or SimulationConfig()
        self.world = World(self.config.time_step, self.config.gravity, self.config.gui)
        self.time_ns = 0
        self.step_ns = round(self.config.time_step * 1e9)
        self.robots: dict[str, ControlledModel] = {}
        self.cameras: list[MountedCamera] = []
        self.sensors: list[PeriodicSensor] = []
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
        """Add a model to the world, with its control hardware, cameras and sensors.

        Args:
            description: parsed robot description.
            name: name of the model.
            pose: initial pose in the world.
            namespace: namespace of the robot.
            parameters: ROS parameters below this namespace, as nested mappings.
            joint_positions: initial joint positions by joint name, rad or m.
            cameras: settings by camera name, which override those of the description; the camera
                a/b has the settings cameras["a"]["b"]. A camera with invalid settings is left out,
                and an error is logged.

        Raises:
            SimError: the model cannot be added; the world is unchanged.
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
            # imported late, because few robots have this plug-in
            from aras_sim_bridge.world import GraspFix

            self.grasps += [GraspFix(grasp, model, self.world) for grasp in description.grasps]
        return model

    def delete(self, name: str) -> None:
        """Remove a model with its controllers, cameras and sensors.

        Raises:
            WorldError: the model does not exist.
        """
        model = self.world.model(name)
        robot = self.robots.pop(name, None)
        if robot is not None:
            robot.manager.shutdown()
        self.cameras = [camera for camera in self.cameras if camera.model not in model.bodies]
        self.sensors = [sensor for sensor in self.sensors if sensor.model not in model.bodies]
        self.grasps = [grasp for grasp in self.grasps if grasp.model is not model]
        self.world.delete(name)

    def light(self, name: str) -> Light:
        """Return the light `name`.

        Raises:
            WorldError: the light does not exist; the message lists the existing lights.
        """
        if name not in self.lights:
            known = ", ".join(self.lights) or "none"
            raise WorldError(f"light '{name}' does not exist; existing lights: {known}")
        return self.lights[name]

    def set_light(self, light: Light) -> None:
        """Add a light or replace the light of the same name.

        Only the first MOST_LIGHTS lights illuminate images; a warning is logged for any further
        one.

        Raises:
            WorldError: a value of the light is invalid; the simulation is unchanged.
        """
        is_new = light.name not in self.lights
        self.lights[light.name] = check_light(light)
        if is_new and len(self.lights) > MOST_LIGHTS:
            log.warning(
                "light '%s' has no effect, because only the first %d lights illuminate images; "
                "delete one of these first lights", light.name, MOST_LIGHTS
            )
        if self._renderer is not None:
            self._renderer.light = self.lighting

    def delete_light(self, name: str) -> None:
        """Remove the light `name`.

        Raises:
            WorldError: the light does not exist; the message lists the existing lights.
        """
        del self.lights[self.light(name).name]
        if self._renderer is not None:
            self._renderer.light = self.lighting

    @property
    def lighting(self) -> Lighting:
        """Light in camera images at the present simulated time, from all lights and the scene."""
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
        """Return the light in camera images that consists of these lights and the ambient light.

        If possible, the result describes a single white sun by its fields `direction` and
        `diffuse`. Otherwise it lists all lights in its field `lights`.
        """
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
            until_ns: simulated time, ns. Further steps up to this time are made in the same call if
                a compiled function can make them, which saves time. The call ends before a step
                that involves a camera, a sensor, a listener or a controller in Python. The results
                are identical to those of single steps.
            compiled_controller: controller that runs in the compiled function.
        """
        start_ns, time_ns = self.time_ns, self.time_ns + self.step_ns
        cameras = [camera for camera in self.cameras if camera.enabled]
        sensors = [sensor for sensor in self.sensors if sensor.enabled]
        for listener in (*cameras, *sensors, *self.grasps):
            until_ns = min(until_ns, listener.idle_until_ns)
        cycle_inputs = self._start_cycles(time_ns, max(until_ns, time_ns), compiled_controller)
        if cycle_inputs is None:
            for robot in self.robots.values():
                robot.loop.step(time_ns)
        for listener in (*cameras, *sensors):
            listener.before_step(start_ns, time_ns)
        if cycle_inputs is None:
            self.world.step()
            self.time_ns = time_ns
        else:
            self._run_cycles(max(until_ns, time_ns), *cycle_inputs)
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
            self._renderer.light = self.lighting
        for camera in due:
            camera.after_step(self.time_ns)

    def _start_cycles(
        self, time_ns: int, until_ns: int, compiled_controller: CompiledController | None
    ) -> tuple[ControlledModel, CycleFunction, tuple, np.ndarray, float] | None:
        """Prepare to make several steps in one compiled function.

        Args:
            time_ns: simulated time at the end of the first of these steps, ns.
            until_ns: simulated time up to which steps may be made, ns.
            compiled_controller: controller that runs in the compiled function, or None.

        Returns:
            The arguments of `_run_cycles` after `until_ns`. None if the first step needs Python
            code: there is not exactly one robot, a contact is possible, or a controller or listener
            is written in Python.
        """
        if len(self.robots) != 1:
            return None
        (robot,) = self.robots.values()
        physics = self.world.get_compiled_step(robot.model)
        if physics is None:
            return None
        sampler = (
            None
            if compiled_controller is None
            else compiled_controller.start_cycles(time_ns, until_ns)
        )
        loop_inputs = robot.loop.start_cycles(time_ns, self.step_ns, sampler)
        run_cycles = control_cycle.run_cycles if sampler is None else compiled_controller.run_cycles
        return None if loop_inputs is None else (robot, run_cycles, physics, *loop_inputs)

    def _run_cycles(
        self,
        until_ns: int,
        robot: ControlledModel,
        run_cycles: CycleFunction,
        physics: tuple,
        loops: np.ndarray,
        idle_ns: float,
    ) -> None:
        """Make steps in a compiled function up to `until_ns` or `idle_ns`, whichever is earlier.

        Args:
            until_ns: simulated time, ns.
            robot: the only robot.
            run_cycles: compiled function.
            physics: result of World.get_compiled_step.
            loops: array of the joint loops, see ControlLoop.start_cycles.
            idle_ns: simulated time before which no controller needs Python, ns.

        Raises:
            WorldError: a joint diverges.
        """
        start_ns, step_ns, hardware = self.time_ns, self.step_ns, robot.hardware
        count = min(
            int(min(until_ns, idle_ns) - start_ns) // step_ns,
            self.world.contact_forecast.steps_until_update,
        )
        made, end, diverged = run_cycles(
            count, start_ns, step_ns, loops, hardware.handle_rows, hardware.drive_rows, *physics
        )
        robot.loop.end_cycles(start_ns + (made + (end == control_cycle.NOT_FINITE)) * step_ns)
        self.time_ns = start_ns + (made - (end == control_cycle.DIVERGED)) * step_ns
        if end != control_cycle.ALL_MADE:
            hardware.log_warnings()
        self.world.finish_compiled_steps(
            robot.model, made, diverged, end != control_cycle.BASE_UNSUPPORTED
        )
        if end == control_cycle.NOT_FINITE:
            hardware.apply(self.time_ns)
            robot.model.check_efforts()

    def next_image_ns(self) -> int | None:
        """Return the simulated time, ns, at which a camera has to act next; None if none has to.

        The camera acts at the end of the step that contains this time.
        """
        due = (camera.sensor.due_ns for camera in self.cameras if camera.enabled)
        return min((at_ns for at_ns in due if self.time_ns < at_ns < NEVER), default=None)

    def set_joint_positions(self, name: str, positions: Mapping[str, float]) -> None:
        """Set joint positions (rad or m) of a model and set the joint velocities to zero.

        Mimic joints follow. A joint with a position interface holds its position until the next
        command.

        Raises:
            WorldError: a model or joint is unknown or a number is not finite; the simulation is
                unchanged.
        """
        (self.world.models.get(name) or self.world.model(name)).set_joint_positions(positions)
        if name in self.robots:
            self.robots[name].hardware.hold_positions(positions)

    def reset_world(self) -> None:
        """Move all models back to their initial poses; time and joint positions do not change."""
        self.world.reset_world()
        for robot in self.robots.values():
            robot.loop.reset()

    def reset_simulation(self) -> None:
        """Set the time to 0 and restore the state after spawning.

        Controllers restart and keep their set points.
        """
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
        """Change time step (s), gravity (m/s²) and solver iterations of the physics engine.

        Raises:
            WorldError: a value is invalid; the simulation is unchanged.
        """
        self.world.set_physics(time_step, gravity, solver_iterations)
        self.step_ns = round(time_step * 1e9)

    def close(self) -> None:
        """Release the renderer and the physics engine; further calls have no effect."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
        self.world.close()

    def _check_namespace(self, namespace: str, name: str) -> None:
        """Raise WorldError if another robot already has a controller manager in `namespace`."""
        for robot in self.robots.values():
            if robot.namespace == namespace and robot.name != name:
                raise WorldError(
                    f"model '{name}' cannot use the robot namespace {namespace or '/'}, because "
                    f"model '{robot.name}' uses it; change <robotNamespace> in the "
                    f"gazebo_ros_control plugin of '{name}' (if the plugin has none, change "
                    "robot_namespace in the spawn request)"
                )

    def _make_robot(
        self, model: Model, namespace: str, parameters: Mapping[str, object]
    ) -> ControlledModel | None:
        for plugin in model.description.control_plugins:
            hardware = RobotHardware(model.description, model, parameters, namespace)
            manager = ControllerManager(hardware, parameters, namespace)
            period = plugin.control_period
            period_ns = None if period is None else round(period * 1e9)
            loop = ControlLoop(hardware, manager, self.step_ns, period_ns)
            robot = ControlledModel(model.name, namespace, model, hardware, manager, loop)
            manager.on_started = partial(self._warn_if_unstable, robot)
            return robot
        return None

    def _warn_if_unstable(self, robot: ControlledModel) -> None:
        """Log a warning if PIDs of the started controllers are unstable with the time step."""
        if text := robot.report_stability(self.world.time_step):
            log.warning("%s", text)

    def camera(self, name: str) -> MountedCamera:
        """Return the camera with the topic namespace `name`, for example '/labrob/camera'.

        Raises:
            WorldError: the camera does not exist; the message lists the existing cameras.
        """
        for camera in self.cameras:
            if camera.sensor.config.topic_root == name:
                return camera
        known = ", ".join(camera.sensor.config.topic_root for camera in self.cameras) or "none"
        raise WorldError(f"camera '{name}' does not exist; existing cameras: {known}")

    def add_camera(self, name: str, settings: Mapping[str, object]) -> MountedCamera:
        """Add a camera that is fixed in the world; camera/mounting.py lists the settings.

        Raises:
            CameraError: the settings are invalid or a name is already in use.
        """
        config, pose = configure_world_camera(
            name, settings, self._get_camera_defaults(), self.config.seed
        )
        mounted = MountedCamera(self._make_camera_sensor(config), None, "world", pose)
        self.cameras.append(mounted)
        return mounted

    def _mount(
        self, model: Model, camera: CameraDescription, settings: Mapping[str, object]
    ) -> None:
        """Mount one camera of a description; log an error if its settings are invalid."""
        try:
            config = configure_robot_camera(
                camera, settings, self._get_camera_defaults(), self.config.seed
            )
            mounted = MountedCamera(self._make_camera_sensor(config), model, camera.link)
        except (CameraError, RenderingError) as error:
            log.error("model '%s' is simulated without camera '%s': %s",
                      model.name, camera.name, error)
            return
        self.cameras.append(mounted)
        first = find_simultaneous(mounted, self.cameras)[0].sensor
        if mounted.sensor.rate != first.rate:
            log.warning(
                "camera '%s' has the same shutter as camera '%s', so it exposes at that camera's "
                "%g Hz instead of %g Hz; set the same update_rate for both",
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
                    f"camera '{config.name}' cannot use the ROS name {min(taken)}, because camera "
                    f"'{camera.sensor.config.name}'{owner} uses it; change cameraName or "
                    "robotNamespace of one camera"
                )
        if self._renderer is None:
            self._renderer = create_renderer(
                self.config.renderer, self.world, self.lighting
            )
        sensor = CameraSensor(config, self._renderer)
        sensor.check_time_step(self.step_ns)
        sensor.reset(self.time_ns)
        return sensor
