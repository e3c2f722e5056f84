"""Models with controllers, and their control cycles in compiled code."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from aras_sim_bridge import control_cycle
from aras_sim_bridge.control.hardware import RobotHardware
from aras_sim_bridge.control.loop import ControlLoop
from aras_sim_bridge.control.manager import ControllerManager
from aras_sim_bridge.control.stability import report_stability
from aras_sim_bridge.control.switching import STRICT
from aras_sim_bridge.description import RobotDescription
from aras_sim_bridge.errors import DescriptionError, WorldError
from aras_sim_bridge.world import Model, World

if TYPE_CHECKING:
    from aras_sim_bridge.control.controllers.joint_state import JointStateController

log = logging.getLogger(__name__)


class StepListener(Protocol):
    """Object, such as a camera, that may store the state before a step."""

    def before_step(self, time_ns: int, after_ns: int) -> None:
        """Prepare for the step from `time_ns` to `after_ns` (simulated time, ns)."""


class CompiledController(Protocol):
    """Controller that can run together with the physics in one compiled function.

    This function makes many control cycles, each with one physics step, without calling Python.
    """

    def start_cycles(
        self, time_ns: int, until_ns: int, step_ns: int
    ) -> JointStateController | None:
        """Prepare the control cycles from `time_ns` to `until_ns` (simulated time, ns).

        Return the joint state controller from which this controller takes joint states in these
        cycles, or None if it takes none; the other methods are then not called.
        """

    def run_cycles(self, *arguments: object) -> tuple[int, int, int]:
        """Run a part of the prepared cycles in compiled code.

        Arguments and results are those of control_cycle.run_cycles.
        """

    def end_cycles(self) -> None:
        """Apply the results of the cycles; called once after the last `run_cycles`."""


@dataclass(frozen=True, eq=False)
class ControlledModel:
    """A model with a gazebo_ros_control plugin: its hardware interface and its controllers."""

    name: str
    namespace: str
    model: Model
    hardware: RobotHardware
    manager: ControllerManager
    loop: ControlLoop

    @classmethod
    def create(
        cls, model: Model, namespace: str, parameters: Mapping[str, object], world: World
    ) -> ControlledModel:
        """Create the hardware interface and the controller manager of a model in a world.

        Args:
            model: model with exactly one gazebo_ros_control plugin.
            namespace: ROS namespace of the controllers.
            parameters: parameters below `namespace`, as nested mappings.
            world: world that contains the model.

        Raises:
            HardwareError: transmissions, limits or gains are invalid.
        """
        hardware = RobotHardware(model.description, model, parameters, namespace)
        manager = ControllerManager(hardware, parameters, namespace)
        (plugin,) = model.description.control_plugins
        period = plugin.control_period
        period_ns = None if period is None else round(period * 1e9)
        loop = ControlLoop(hardware, manager, round(world.time_step * 1e9), period_ns)
        robot = cls(model.name, namespace, model, hardware, manager, loop)

        def warn_if_unstable() -> None:
            if text := robot.report_stability(world.time_step):
                log.warning("%s", text)

        manager.on_started = warn_if_unstable
        return robot

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

    def start_cycles(
        self, world: World, time_ns: int, until_ns: int, step_ns: int,
        controller: CompiledController | None,
    ) -> CompiledCycles | None:
        """Prepare to make several physics steps of `step_ns` in one compiled function.

        Args:
            world: world that contains this model and no other controlled model.
            time_ns: simulated time at the end of the first of these steps, ns.
            until_ns: simulated time up to which steps may be made, ns.
            controller: controller that runs in the compiled function, or None.

        Returns:
            The cycles. None if the first step needs Python code: a contact is possible, or a
            controller or listener is written in Python.
        """
        physics = world.get_compiled_step(self.model)
        if physics is None:
            return None
        sampler = None
        if controller is not None:
            sampler = controller.start_cycles(time_ns, until_ns, step_ns)
        loops = self.loop.start_cycles(time_ns, step_ns, sampler)
        if loops is None:
            return None
        if sampler is None:
            controller = None
        return CompiledCycles(self, world, step_ns, until_ns, controller, physics, *loops)


@dataclass
class CompiledCycles:
    """Control cycles of one robot, each with one physics step, in one compiled function.

    Attributes:
        step_ns: physics step, ns.
        until_ns: simulated time up to which steps may be made, ns.
        controller: controller that runs in the compiled function, or None.
        physics: result of World.get_compiled_step.
        loops: array of the joint loops, see ControlLoop.start_cycles.
        idle_ns: simulated time before which no controller needs Python, ns.
    """

    robot: ControlledModel
    world: World
    step_ns: int
    until_ns: int
    controller: CompiledController | None
    physics: tuple
    loops: np.ndarray
    idle_ns: float

    def run(self, start_ns: int, quiet_ns: int, cameras: Iterable[StepListener]) -> int:
        """Make steps from `start_ns` to the earlier of `until_ns` and `idle_ns`.

        Return the simulated time, ns, at the end of the last step. Call `finish` afterwards.

        Args:
            quiet_ns: simulated time, ns, until which no camera acts; at most one step may follow.
            cameras: cameras that are prepared for this last step.
        """
        hardware, step_ns, controller = self.robot.hardware, self.step_ns, self.controller
        function = control_cycle.run_cycles if controller is None else controller.run_cycles
        last = min(
            int(min(self.until_ns, self.idle_ns) - start_ns) // step_ns,
            self.world.contact_forecast.steps_until_update,
        )
        # A camera that exposes at the end of a step, at quiet_ns + 1, needs no earlier poses.
        quiet = min(max((quiet_ns + 1 - start_ns) // step_ns, 0), last)
        self._made, self._end, self._diverged = 0, control_cycle.ALL_MADE, -1
        for goal in (quiet, last):
            count, time_ns = goal - self._made, start_ns + self._made * step_ns
            if count == 0:
                continue
            if goal > quiet:
                for camera in cameras:
                    camera.before_step(time_ns, time_ns + step_ns)
            made, self._end, self._diverged = function(
                count, time_ns, step_ns, self.loops, hardware.handle_rows, hardware.drive_rows,
                *self.physics,
            )
            self._made += made
            if made < count or self._end != control_cycle.ALL_MADE:
                break
        if controller is not None:
            controller.end_cycles()
        controlled = self._made + (self._end == control_cycle.NOT_FINITE)
        self.robot.loop.end_cycles(start_ns + controlled * step_ns)
        return start_ns + (self._made - (self._end == control_cycle.DIVERGED)) * step_ns

    def finish(self, time_ns: int) -> None:
        """Finish the last step in Python; `time_ns` is the result of `run`.

        Raises:
            WorldError: a joint diverges.
        """
        hardware, model, end = self.robot.hardware, self.robot.model, self._end
        if end != control_cycle.ALL_MADE:
            hardware.log_warnings()
        self.world.finish_compiled_steps(
            model, self._made, self._diverged, end != control_cycle.BASE_UNSUPPORTED
        )
        if end == control_cycle.NOT_FINITE:
            hardware.apply(time_ns)
            model.check_efforts()


def check_control_plugin(
    description: RobotDescription, name: str, namespace: str, robots: Iterable[ControlledModel]
) -> None:
    """Check that a new model can have a controller manager if it has a gazebo_ros_control plugin.

    Args:
        name, namespace: name and namespace of the new model.
        robots: existing models with controllers.

    Raises:
        DescriptionError: the model has several such plugins.
        WorldError: another robot has a controller manager in this namespace.
    """
    plugins = description.control_plugins
    if len(plugins) > 1:
        raise DescriptionError(
            f"model '{name}' has {len(plugins)} gazebo_ros_control plugins; keep one"
        )
    for robot in robots if plugins else ():
        if robot.namespace == namespace and robot.name != name:
            raise WorldError(
                f"model '{name}' cannot use the robot namespace {namespace or '/'}, because "
                f"model '{robot.name}' uses it; change <robotNamespace> in the "
                f"gazebo_ros_control plugin of '{name}' (if the plugin has none, change "
                "robot_namespace in the spawn request)"
            )
