"""The six controller_manager services of one robot, and the topics of its loaded controllers."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
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

from aras_sim_bridge.control.switching import SwitchRequest
from aras_sim_bridge.controlled_model import ControlledModel
from aras_sim_bridge.errors import ControllerError
from aras_sim_bridge.ros.control.command_subscriber import CommandSubscriber
from aras_sim_bridge.ros.control.topics import ControllerTopics, PidTopics
from aras_sim_bridge.ros.runtime.restart_record import RestartRecord
from aras_sim_bridge.ros.runtime.services import (
    Fields,
    ServiceTable,
    find_handlers,
    service_handler,
)
from aras_sim_bridge.ros.runtime.simulation_thread import SHUTTING_DOWN, SimulationThread
from aras_sim_bridge.simulation import Simulation
from aras_visual_servo_base.names import resolve_name
from aras_visual_servo_ros.parameters import get_namespace

T = TypeVar("T")
SWITCH_TIMEOUT = 10.0  # timeout of a switch request that specifies no timeout (0), s of wall time
POLL_PERIOD = 0.1  # interval of the checks whether simulated time is paused, s of wall time


class ManagerServices:
    """Services in <namespace>/controller_manager/ and topics of the loaded controllers."""

    def __init__(
        self, robot: ControlledModel, thread: SimulationThread, restart_record: RestartRecord
    ) -> None:
        """Advertise the services of `robot`, whose manager runs in `thread`."""
        self._restart_record = restart_record
        self._robot = robot
        self._manager = robot.manager
        self._thread = thread
        self._namespace = robot.namespace.rstrip("/")
        self._topics: dict[str, ControllerTopics] = {}
        self._cleanup = ExitStack()  # closes everything but the topics of controllers
        try:
            self._advertise()
        except Exception:
            self.shutdown()
            raise

    def _advertise(self) -> None:
        pids = self._thread.call(lambda: dict(self._robot.hardware.pids))
        for joint, pid in pids.items():
            namespace = f"{self._namespace}/gazebo_ros_control/pid_gains/{joint}"
            self._cleanup.callback(PidTopics(namespace, pid, self._thread).shutdown)
        plugins = self._robot.model.description.control_plugins
        e_stop_topics = [plugin.e_stop_topic for plugin in plugins if plugin.e_stop_topic]
        if e_stop_topics:
            topic = resolve_name(self._namespace, e_stop_topics[0])
            e_stop = CommandSubscriber(topic, Bool, self._set_e_stop, self._thread)
            self._cleanup.callback(e_stop.shutdown)
        services = ServiceTable(
            f"{self._namespace}/controller_manager",
            self._thread,
            *find_handlers(self),
            call_lock=threading.Lock(),  # like ros_control, serve one call at a time
        )
        self._cleanup.callback(services.shutdown)

    def shutdown(self) -> None:
        """Shut down all services and topics."""
        self._cleanup.close()
        for topics in self._topics.values():
            topics.shutdown()
        self._restart_record.set_controllers(self._namespace, [])
        self._topics.clear()

    def _set_e_stop(self, message: Bool) -> None:
        self._robot.hardware.e_stop = message.data

    @service_handler(ListControllers)
    def list_controllers(self, _simulation: Simulation, _request: ListControllers) -> Fields:
        """Return names, states, types and claimed resources of the loaded controllers."""
        controllers = []
        for entry in self._manager.list():
            claims = [
                HardwareInterfaceResources(claim.hardware_interface, list(claim.resources))
                for claim in entry.controller.claimed_resources
            ]
            controllers.append(ControllerState(entry.name, entry.state, entry.type, claims))
        return {"controller": controllers}

    @service_handler(ListControllerTypes, in_caller_thread=True)
    def list_controller_types(
        self, _thread: SimulationThread, _request: ListControllerTypes
    ) -> Fields:
        """Return the available controller types with the names of their base classes."""
        pairs = self._call_with_parameters(self._manager.list_types)
        return {"types": [a for a, _ in pairs], "base_classes": [b for _, b in pairs]}

    @service_handler(LoadController, in_caller_thread=True)
    def load_controller(self, _thread: SimulationThread, request: LoadController) -> Fields:
        """Load a controller with the current parameters of the parameter server."""
        self._call_with_parameters(lambda: self._manager.load(request.name))
        self._sync_topics()

    @service_handler(UnloadController, in_caller_thread=True)
    def unload_controller(self, thread: SimulationThread, request: UnloadController) -> Fields:
        """Unload a controller and close its topics."""
        thread.call(lambda: self._manager.unload(request.name))
        self._sync_topics()

    @service_handler(ReloadControllerLibraries, in_caller_thread=True)
    def reload_controller_libraries(
        self, _thread: SimulationThread, request: ReloadControllerLibraries
    ) -> Fields:
        """Reload the Python modules of user-defined controllers."""
        self._call_with_parameters(lambda: self._manager.reload_libraries(request.force_kill))
        self._sync_topics()

    @service_handler(SwitchController, in_caller_thread=True)
    def switch_controller(self, thread: SimulationThread, request: SwitchController) -> Fields:
        """Stop and start controllers; respond when the switch is done or has timed out."""
        done = threading.Event()

        def request_switch() -> SwitchRequest:
            switch = self._manager.switch(
                request.start_controllers,
                request.stop_controllers,
                request.strictness,
                request.start_asap,
            )
            switch.on_done = lambda _switch: done.set()
            self._switch_without_update()
            return switch

        switch = thread.call(request_switch)
        limit = request.timeout + 1.0 if request.timeout > 0.0 else SWITCH_TIMEOUT
        too_late = (
            f"the switch was not carried out within {limit:g} s of wall time; try again when the "
            "processor is less busy"
        )
        deadline = time.monotonic() + limit
        while not done.wait(POLL_PERIOD):
            if thread.is_stopping:
                raise ControllerError(SHUTTING_DOWN)
            thread.call(self._switch_without_update)
            if time.monotonic() > deadline:
                thread.call(lambda: switch.finish(too_late))
        if not switch.is_successful:
            raise ControllerError(switch.reason)
        self._restart_record.set_controllers(self._namespace, thread.call(self._manager.list))

    def _switch_without_update(self) -> None:
        """Carry out waiting switches now if simulated time is stopped.

        Otherwise they would wait for the next control update.
        """
        if self._thread.is_time_stopped:
            now = self._thread.simulation.time_ns
            self._robot.hardware.read()
            self._manager.carry_out_switches(now)

    def _call_with_parameters(self, job: Callable[[], T]) -> T:
        """Update the manager's copy of the robot's ROS parameters, and run `job`.

        Both are done in the simulation thread, between two steps.
        """
        parameters = get_namespace(self._namespace or "/")

        def refresh_and_call() -> T:
            self._manager.parameters = parameters
            return job()

        return self._thread.call(refresh_and_call)

    def _sync_topics(self) -> None:
        """Open the topics of newly loaded controllers and close those of unloaded ones."""
        loaded = self._thread.call(self._manager.list)
        self._restart_record.set_controllers(self._namespace, loaded)
        controllers = {entry.name: entry.controller for entry in loaded}
        for name, topics in list(self._topics.items()):
            if controllers.get(name) is not topics.controller:
                topics.shutdown()
                del self._topics[name]
        for name, controller in controllers.items():
            if name not in self._topics:
                self._topics[name] = ControllerTopics(controller, self._namespace, self._thread)
