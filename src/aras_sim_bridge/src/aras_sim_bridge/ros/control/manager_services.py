"""The six controller_manager services of one robot, and the topics of what it has loaded."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import TypeVar

from controller_manager_msgs.msg import ControllerState, HardwareInterfaceResources
from controller_manager_msgs.srv import (
    ListControllers,
    ListControllerTypes,
    LoadController,
    ReloadControllerLibraries,
    SwitchController,
    UnloadController,
)
from std_msgs.msg import Bool

from aras_sim_bridge.control.controllers import Controller
from aras_sim_bridge.control.switching import SwitchRequest
from aras_sim_bridge.errors import ControllerError
from aras_sim_bridge.ros.control.command_topic import CommandTopic
from aras_sim_bridge.ros.control.topics import ControllerTopics, PidTopics
from aras_sim_bridge.ros.runtime.record import Record
from aras_sim_bridge.ros.runtime.services import Fields, ServiceTable, handlers_in, serves
from aras_sim_bridge.ros.runtime.simulation_thread import SHUTTING_DOWN, SimulationThread
from aras_sim_bridge.simulation import ControlledModel, Simulation
from aras_visual_servo_base.names import resolve_name
from aras_visual_servo_ros.parameters import namespace_of

T = TypeVar("T")
SWITCH_TIMEOUT = 10.0  # seconds of wall time, where the request sets no limit (timeout 0)
LOOK_PERIOD = 0.1  # seconds of wall time between two looks whether time was stopped meanwhile


class ManagerServices:
    """Serves <namespace>/controller_manager/ and keeps the controllers' topics in step."""

    def __init__(self, robot: ControlledModel, thread: SimulationThread, record: Record) -> None:
        """Advertise the services of `robot`, whose manager runs in `thread`."""
        self._record = record
        self._robot = robot
        self._manager = robot.manager
        self._thread = thread
        self._namespace = robot.namespace.rstrip("/")
        self._topics: dict[str, ControllerTopics] = {}
        self._joint_pids: list[PidTopics] = []
        self._e_stop: CommandTopic | None = None
        self._services: ServiceTable | None = None
        try:
            self._advertise()
        except Exception:
            self.shutdown()
            raise

    def _advertise(self) -> None:
        pids = self._thread.call(lambda: dict(self._robot.hardware.pids))
        for joint, pid in pids.items():
            namespace = f"{self._namespace}/gazebo_ros_control/pid_gains/{joint}"
            self._joint_pids.append(PidTopics(namespace, pid, self._thread))
        self._e_stop = self._subscribe_e_stop()
        self._services = ServiceTable(
            f"{self._namespace}/controller_manager",
            self._thread,
            *handlers_in(self),
            turn=threading.Lock(),  # ros_control answers one call at a time
        )

    def shutdown(self) -> None:
        """Take services and topics off the graph."""
        if self._services is not None:
            self._services.shutdown()
        if self._e_stop is not None:
            self._e_stop.shutdown()
        for topics in [*self._topics.values(), *self._joint_pids]:
            topics.shutdown()
        self._record.controllers(self._namespace, [])
        self._topics.clear()

    def _subscribe_e_stop(self) -> CommandTopic | None:
        plugins = self._robot.model.description.control_plugins
        topic = next((plugin.e_stop_topic for plugin in plugins if plugin.e_stop_topic), None)
        if topic is None:
            return None

        def take(message: Bool) -> None:
            self._robot.hardware.e_stop = message.data

        return CommandTopic(resolve_name(self._namespace, topic), Bool, take, self._thread)

    @serves(ListControllers)
    def list_controllers(self, _simulation: Simulation, _request: ListControllers) -> Fields:
        """Names, states, types and claims."""
        controllers = []
        for info in self._manager.list():
            claims = [
                HardwareInterfaceResources(claim.hardware_interface, list(claim.resources))
                for claim in info.claimed_resources
            ]
            controllers.append(ControllerState(info.name, info.state, info.type, claims))
        return {"controller": controllers}

    @serves(ListControllerTypes, outside=True)
    def list_controller_types(
        self, _thread: SimulationThread, _request: ListControllerTypes
    ) -> Fields:
        """Type strings, each with the name of its base class."""
        pairs = self._with_parameters(self._manager.list_types)
        return {"types": [a for a, _ in pairs], "base_classes": [b for _, b in pairs]}

    @serves(LoadController, outside=True)
    def load_controller(self, _thread: SimulationThread, request: LoadController) -> Fields:
        """Make a controller by the parameters as they are now."""
        self._with_parameters(lambda: self._manager.load(request.name))
        self._sync()

    @serves(UnloadController, outside=True)
    def unload_controller(self, thread: SimulationThread, request: UnloadController) -> Fields:
        """Forget a controller."""
        thread.call(lambda: self._manager.unload(request.name))
        self._sync()

    @serves(ReloadControllerLibraries, outside=True)
    def reload_controller_libraries(
        self, _thread: SimulationThread, request: ReloadControllerLibraries
    ) -> Fields:
        """Import the users' classes anew."""
        self._with_parameters(lambda: self._manager.reload_libraries(request.force_kill))
        self._sync()

    @serves(SwitchController, outside=True)
    def switch_controller(self, thread: SimulationThread, request: SwitchController) -> Fields:
        """Stop and start controllers; answered when it is done, or not done in time."""
        done = threading.Event()

        def ask() -> SwitchRequest:
            switch = self._manager.switch(
                request.start_controllers,
                request.stop_controllers,
                request.strictness,
                request.start_asap,
            )
            switch.on_done = lambda _switch: done.set()
            self._carry_out_if_held()
            return switch

        switch = thread.call(ask)
        limit = request.timeout + 1.0 if request.timeout > 0.0 else SWITCH_TIMEOUT
        too_late = f"not carried out within {limit:g} s of wall time; is the machine busy?"
        deadline = time.monotonic() + limit
        while not done.wait(LOOK_PERIOD):
            if thread.stopping:
                raise ControllerError(SHUTTING_DOWN)
            thread.call(self._carry_out_if_held)
            if time.monotonic() > deadline:
                thread.call(lambda: switch.finish(too_late))
        if not switch.ok:
            raise ControllerError(switch.reason)
        self._record.controllers(self._namespace, thread.call(self._manager.list))

    def _carry_out_if_held(self) -> None:
        """Do what is open while time stands still: no update will come, and nothing moves."""
        if self._thread.held:
            now = self._thread.simulation.time_ns
            self._robot.hardware.read()
            self._manager.carry_out(now)

    def _with_parameters(self, job: Callable[[], T]) -> T:
        """Run job between two steps, after the manager got the robot's parameters anew."""
        parameters = namespace_of(self._namespace or "/")

        def refreshed() -> T:
            self._manager.parameters = parameters
            return job()

        return self._thread.call(refreshed)

    def _sync(self) -> None:
        """Open and close topics so that they are those of the controllers now loaded."""

        def loaded() -> dict[str, Controller]:
            return {info.name: self._manager.get(info.name) for info in self._manager.list()}

        controllers = self._thread.call(loaded)
        self._record.controllers(self._namespace, self._thread.call(self._manager.list))
        for name, topics in list(self._topics.items()):
            if controllers.get(name) is not topics.controller:
                topics.shutdown()
                del self._topics[name]
        for name, controller in controllers.items():
            if name not in self._topics:
                self._topics[name] = ControllerTopics(controller, self._namespace, self._thread)
