"""The whole: physics world, robots with controllers, cameras, and one step() for all of it."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from aras_sim_bridge.camera import CameraConfig, CameraSensor, Frame
from aras_sim_bridge.control_loop import ControlLoop
from aras_sim_bridge.controller_manager import ControllerManager
from aras_sim_bridge.description import RobotDescription
from aras_sim_bridge.errors import DescriptionError, RenderingError, SimError
from aras_sim_bridge.hardware import RobotHardware
from aras_sim_bridge.rendering import COLOURS, Light, MaterialTable, Renderer, create_renderer
from aras_sim_bridge.world import Model, Pose, World
from aras_sim_bridge.world.poses import IDENTITY

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class SimulationConfig:
    """time_step: s. gravity: m/s². seed: of the sensors' noise.

    sun_direction: from the sun to the ground, world frame.
    """

    time_step: float = 0.001
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.8)
    gui: bool = False
    renderer: str = "auto"
    seed: int = 0
    legacy_camera_info: bool = False
    ground_plane: bool = True
    sun_direction: tuple[float, float, float] = (-0.5, 0.1, -0.9)


@dataclass(frozen=True)
class Robot:
    """A model under ros_control: one control plugin's hardware and controllers."""

    name: str
    namespace: str
    model: Model
    hardware: RobotHardware
    manager: ControllerManager
    loop: ControlLoop


class MountedCamera:
    """A camera on a link. It draws while `enabled` and hands its frames to `on_frame`."""

    def __init__(self, sensor: CameraSensor, model: Model, link: str) -> None:
        self.sensor = sensor
        self.model = model
        self.link = link
        self.enabled = False
        self.on_frame: Callable[[Frame], None] | None = None

    def before_step(self, time_ns: int, after_ns: int) -> None:
        """Remember the world where an exposure falls between two ticks."""
        if self.sensor.needs_before(after_ns):
            self.sensor.before_step(self._pose(), time_ns)

    def after_step(self, time_ns: int) -> None:
        """Expose if it is time."""
        if not self.sensor.due(time_ns):
            return
        frame = self.sensor.capture(self._pose(), time_ns)
        if frame is not None and self.on_frame is not None:
            self.on_frame(frame)

    def _pose(self) -> np.ndarray:
        return np.array(self.model.link_pose(self.link).matrix())


class Simulation:
    """Models, robots and cameras of one world; simulated time only.

    Attributes:
        world: physics. robots: by model name. cameras: in spawn order.
        time_ns: simulated time. step_ns: the physics step.
    """

    def __init__(self, config: SimulationConfig | None = None) -> None:
        """A world with nothing but the ground; SimError where the config is impossible."""
        self.config = config or SimulationConfig()
        self.world = World(self.config.time_step, self.config.gravity, self.config.gui)
        self.time_ns = 0
        self.step_ns = round(self.config.time_step * 1e9)
        self.robots: dict[str, Robot] = {}
        self.cameras: list[MountedCamera] = []
        self._materials = MaterialTable()
        self._renderer: Renderer | None = None
        if self.config.ground_plane:
            self._colour(self.world.spawn_ground_plane())

    def spawn(
        self,
        description: RobotDescription,
        name: str,
        pose: Pose = IDENTITY,
        namespace: str = "",
        parameters: Mapping[str, Any] | None = None,
        joint_positions: Mapping[str, float] | None = None,
        cameras: Mapping[str, Any] | None = None,
    ) -> Model:
        """Put a model into the world, with its controllers' hardware and its cameras.

        Args:
            namespace: the robot's, without trailing slash; parameters: what ROS has below it.
            cameras: settings laid over the sensors', nested by the parts of the camera's name.

        Raises:
            SimError: saying what is wrong; the world is as before then.
        """
        if len(description.control_plugins) > 1:
            raise DescriptionError(
                f"model '{name}' has {len(description.control_plugins)} gazebo_ros_control plugins;"
                " keep one"
            )
        model = self.world.spawn(description, name, pose, joint_positions)
        try:
            robot = self._robot(model, namespace.rstrip("/"), parameters or {})
            mounted = [self._camera(model, c, cameras or {}) for c in description.cameras]
        except SimError:
            self.world.delete(name)
            raise
        self._colour(model)
        if robot is not None:
            self.robots[name] = robot
        self.cameras.extend(mounted)
        return model

    def delete(self, name: str) -> None:
        """Take a model out, with its controllers and cameras; WorldError when there is none."""
        model = self.world.model(name)
        robot = self.robots.pop(name, None)
        if robot is not None:
            robot.manager.shutdown()
        self.cameras = [camera for camera in self.cameras if camera.model is not model]
        self._materials.forget(model.body_id)
        self.world.delete(name)

    def step(self) -> None:
        """One tick in Gazebo's order: time, controllers, physics, sensors."""
        time_ns = self.time_ns + self.step_ns
        for robot in self.robots.values():
            robot.loop.step(time_ns)
        cameras = [camera for camera in self.cameras if camera.enabled]
        for camera in cameras:
            camera.before_step(self.time_ns, time_ns)
        self.world.step()
        self.time_ns = time_ns
        for camera in cameras:
            camera.after_step(time_ns)

    def reset_world(self) -> None:
        """Models back to their spawn poses; time and joint angles stay."""
        self.world.reset_world()
        for robot in self.robots.values():
            robot.loop.reset()

    def reset_simulation(self) -> None:
        """Everything as spawned, at time 0; controllers keep running."""
        self.world.reset_simulation()
        self.time_ns = 0
        for model in self.world.models.values():
            self._colour(model)
        if self._renderer is not None:
            self._renderer.forget()
        for robot in self.robots.values():
            robot.loop.reset()
            robot.hardware.reset(forget_turns=True)
        for camera in self.cameras:
            camera.sensor.reset(0)

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

    def _robot(self, model: Model, namespace: str, parameters: Mapping[str, Any]) -> Robot | None:
        for plugin in model.description.control_plugins:
            hardware = RobotHardware(
                model.description, model, parameters, namespace, log.warning
            )
            manager = ControllerManager(hardware, parameters, namespace, log.warning, log.error)
            period = plugin.control_period
            period_ns = None if period is None else round(period * 1e9)
            loop = ControlLoop(hardware, manager, self.step_ns, period_ns)
            return Robot(model.name, namespace, model, hardware, manager, loop)
        return None

    def _camera(self, model: Model, camera: Any, presets: Mapping[str, Any]) -> MountedCamera:
        name = camera.plugin.camera_name if camera.plugin is not None else camera.name
        overrides: dict[str, Any] = {"legacy_camera_info": self.config.legacy_camera_info}
        overrides |= _below(presets, name)
        settings = CameraConfig.from_description(camera, overrides)
        if self._renderer is None:
            self._renderer = create_renderer(
                self.config.renderer,
                self.world.client,
                self._materials,
                Light(self.config.sun_direction),
            )
            log.info("cameras are drawn by %s", self._renderer.name)
        sensor = CameraSensor(settings, self._renderer)
        sensor.check_time_step(self.step_ns)
        sensor.reset(self.time_ns)
        return MountedCamera(sensor, model, camera.link)

    def _colour(self, model: Model) -> None:
        """Give the renderer Gazebo's colours; links without a material are white."""
        colours = {}
        for index, name in model.materials.items():
            if name not in COLOURS:
                raise RenderingError(
                    f"model '{model.name}': there is no material '{name}'; use Gazebo/White, "
                    "Gazebo/Black and the like"
                )
            colours[index] = COLOURS[name]
        self._materials.set_body(model.body_id, colours)


def _below(tree: Mapping[str, Any], path: str) -> Mapping[str, Any]:
    """The mapping at 'a/b' of a nested one; empty where there is none."""
    node: Any = tree
    for part in path.strip("/").split("/"):
        node = node.get(part) if isinstance(node, Mapping) else None
    return node if isinstance(node, Mapping) else {}
