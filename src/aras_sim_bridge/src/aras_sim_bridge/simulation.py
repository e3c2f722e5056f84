"""The complete simulation: physics world, controlled robots, cameras and sensors.

`Simulation.step` advances all of them by one time step.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from aras_sim_bridge.camera import CameraConfig, CameraSensor
from aras_sim_bridge.camera.config import derive_seed
from aras_sim_bridge.camera.mounting import (
    MountedCamera,
    check_names,
    configure_robot_camera,
    configure_world_camera,
)
from aras_sim_bridge.camera.sensor import NEVER
from aras_sim_bridge.controlled_model import (
    CompiledController,
    ControlledModel,
    check_control_plugin,
)
from aras_sim_bridge.description import CameraDescription, Light, RobotDescription
from aras_sim_bridge.description.lights import check_light
from aras_sim_bridge.description.types import SUN, SceneSettings
from aras_sim_bridge.errors import CameraError, RenderingError, SimError, WorldError
from aras_sim_bridge.lighting import MOST_LIGHTS, make_lighting
from aras_sim_bridge.rendering import EXPOSURES, Lighting, create_renderer
from aras_sim_bridge.sensors import KINDS, PeriodicSensor
from aras_sim_bridge.world import Model, Pose, World
from aras_visual_servo_base.poses import IDENTITY

if TYPE_CHECKING:
    from aras_sim_bridge.rendering.renderer import Renderer
    from aras_sim_bridge.world import GraspFix

log = logging.getLogger(__name__)


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
        self._camera_defaults = {"legacy_camera_info": self.config.legacy_camera_info}
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
        namespace = namespace.rstrip("/")
        check_control_plugin(description, name, namespace, self.robots.values())
        model = self.world.spawn(description, name, pose, joint_positions)
        if description.control_plugins:
            try:
                self.robots[name] = ControlledModel.create(
                    model, namespace, parameters or {}, self.world
                )
            except SimError:
                self.world.delete(name)
                raise
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
            log.warning("light '%s' has no effect, because only the first %d lights illuminate "
                        "images; delete one of these first lights", light.name, MOST_LIGHTS)
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
        config = self.config
        return make_lighting(
            self.lights.values(), config.scene, config.exposure, self.time_ns / 1e9
        )

    def step(
        self, until_ns: int = 0, compiled_controller: CompiledController | None = None
    ) -> None:
        """Simulate one time step in Gazebo's order: time, controllers, physics, sensors.

        Args:
            until_ns: simulated time, ns. Further steps up to this time are made in the same call if
                a compiled function can make them. The call ends after a step in which a camera
                acts, and before one that involves a sensor, a listener or a controller in Python.
                The results are identical to those of single steps.
            compiled_controller: controller that runs in the compiled function.
        """
        start_ns, time_ns = self.time_ns, self.time_ns + self.step_ns
        cameras, idle_ns = [], NEVER
        for camera in self.cameras:
            if camera.enabled:
                cameras.append(camera)
                idle_ns = min(idle_ns, camera.idle_until_ns)
        sensors = [sensor for sensor in self.sensors if sensor.enabled] if self.sensors else ()
        for listener in (*sensors, *self.grasps):
            until_ns = min(until_ns, listener.idle_until_ns)
        # Cameras may act between compiled steps, unless Bullet makes its steps only afterwards.
        until_ns = min(until_ns, idle_ns + (0 if self.world.has_bullet_steps else self.step_ns))
        robots = list(self.robots.values())
        cycles = None if len(robots) != 1 else robots[0].start_cycles(
            self.world, time_ns, max(until_ns, time_ns), self.step_ns, compiled_controller
        )  # fmt: skip
        if cycles is None:
            for robot in robots:
                robot.loop.step(time_ns)
        for listener in (*sensors, *(cameras if cycles is None else ())):
            listener.before_step(start_ns, time_ns)
        if cycles is None:
            self.world.step()
            self.time_ns = time_ns
        else:
            self.time_ns = cycles.run(start_ns, idle_ns, cameras)
            cycles.finish(self.time_ns)
        for sensor in sensors:
            sensor.after_step(self.time_ns)
        for sensor in sensors:
            sensor.model.applied_forces.clear()
        for grasp in self.grasps:
            grasp.after_step(self.time_ns)
        due = [camera for camera in cameras if camera.sensor.due_ns <= self.time_ns]
        if due and self.before_images is not None:
            self.before_images(self.time_ns)
        for light in self.lights.values() if due else ():
            if light.lit_intervals is not None:
                self._renderer.light = self.lighting
                break
        for camera in due:
            camera.after_step(self.time_ns)

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
            name, settings, self._camera_defaults, self.config.seed
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
                camera, settings, self._camera_defaults, self.config.seed
            )
            mounted = MountedCamera(self._make_camera_sensor(config), model, camera.link)
        except (CameraError, RenderingError) as error:
            log.error("model '%s' is simulated without camera '%s': %s",
                      model.name, camera.name, error)
            return
        self.cameras.append(mounted)
        mounted.adopt_rate(self.cameras, self.time_ns, self.step_ns)

    def _make_camera_sensor(self, config: CameraConfig) -> CameraSensor:
        check_names(config, self.cameras)
        if self._renderer is None:
            self._renderer = create_renderer(self.config.renderer, self.world, self.lighting)
        sensor = CameraSensor(config, self._renderer)
        sensor.check_time_step(self.step_ns)
        sensor.reset(self.time_ns)
        return sensor
