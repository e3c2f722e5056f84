"""The six controller_manager services of one robot, and the topics of what it has loaded."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import TypeVar

import rospy
from controller_manager_msgs.msg import ControllerState, HardwareInterfaceResources
from controller_manager_msgs.srv import (
    ListControllers,
    ListControllersResponse,
    ListControllerTypes,
    ListControllerTypesResponse,
    LoadController,
    LoadControllerResponse,
    ReloadControllerLibraries,
    ReloadControllerLibrariesResponse,
    SwitchController,
    SwitchControllerResponse,
    UnloadController,
    UnloadControllerResponse,
)
from genpy import Message
from std_msgs.msg import Bool

from aras_sim_bridge.control.controllers import Controller
from aras_sim_bridge.control.switching import SwitchRequest
from aras_sim_bridge.errors import ControllerError
from aras_sim_bridge.ros.control.command_topic import CommandTopic
from aras_sim_bridge.ros.control.topics import ControllerTopics, PidTopics
from aras_sim_bridge.ros.runtime.services import ServiceTable
from aras_sim_bridge.ros.runtime.simulation_thread import SHUTTING_DOWN, SimulationThread
from aras_sim_bridge.simulation import Robot

T = TypeVar("T")
SWITCH_TIMEOUT = 10.0  # seconds of wall time, where the request sets no limit (timeout 0)


def robot_parameters(namespace: str) -> dict[str, object]:
    """Return what the parameter server holds below a robot's namespace."""
    values = rospy.get_param(namespace or "/", {})
    return values if isinstance(values, dict) else {}


class ManagerServices:
    """Serves <namespace>/controller_manager/ and keeps the controllers' topics in step."""

    def __init__(self, robot: Robot, thread: SimulationThread) -> None:
        """Advertise the services of `robot`, whose manager runs in `thread`."""
        self._robot = robot
        self._manager = robot.manager
        self._thread = thread
        self._namespace = robot.namespace.rstrip("/")
        self._lock = threading.Lock()  # ros_control answers one call at a time
        self._topics: dict[str, ControllerTopics] = {}
        self._joint_pids: list[PidTopics] = []
        self._e_stop: CommandTopic | None = None
        self._services = ServiceTable(f"{self._namespace}/controller_manager", thread)
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
        for name, service, handler in (
            ("list_controllers", ListControllers, self._list),
            ("list_controller_types", ListControllerTypes, self._types),
            ("load_controller", LoadController, self._load),
            ("unload_controller", UnloadController, self._unload),
            ("switch_controller", SwitchController, self._switch),
            ("reload_controller_libraries", ReloadControllerLibraries, self._reload),
        ):
            self._services.add(name, service, self._serially(handler), outside=True)

    def shutdown(self) -> None:
        """Take services and topics off the graph."""
        self._services.shutdown()
        if self._e_stop is not None:
            self._e_stop.shutdown()
        for topics in [*self._topics.values(), *self._joint_pids]:
            topics.shutdown()
        self._topics.clear()

    def _serially(self, handler: Callable[[Message], Message]) -> Callable[[Message], Message]:
        def serve(request: Message) -> Message:
            with self._lock:
                return handler(request)

        return serve

    def _subscribe_e_stop(self) -> CommandTopic | None:
        plugins = self._robot.model.description.control_plugins
        topic = next((plugin.e_stop_topic for plugin in plugins if plugin.e_stop_topic), None)
        if topic is None:
            return None
        if not topic.startswith("/"):
            topic = f"{self._namespace}/{topic}"

        def take(message: Bool) -> None:
            self._robot.hardware.e_stop = message.data

        return CommandTopic(topic, Bool, take, self._thread)

    def _list(self, _request: ListControllers) -> ListControllersResponse:
        response = ListControllersResponse()
        for info in self._thread.call(self._manager.list):
            claims = [
                HardwareInterfaceResources(claim.hardware_interface, list(claim.resources))
                for claim in info.claimed_resources
            ]
            response.controller.append(ControllerState(info.name, info.state, info.type, claims))
        return response

    def _types(self, _request: ListControllerTypes) -> ListControllerTypesResponse:
        pairs = self._with_parameters(self._manager.list_types)
        return ListControllerTypesResponse([a for a, _ in pairs], [b for _, b in pairs])

    def _load(self, request: LoadController) -> LoadControllerResponse:
        self._with_parameters(lambda: self._manager.load(request.name))
        self._sync()
        return LoadControllerResponse(True)

    def _unload(self, request: UnloadController) -> UnloadControllerResponse:
        self._thread.call(lambda: self._manager.unload(request.name))
        self._sync()
        return UnloadControllerResponse(True)

    def _reload(self, request: ReloadControllerLibraries) -> ReloadControllerLibrariesResponse:
        self._with_parameters(lambda: self._manager.reload_libraries(request.force_kill))
        self._sync()
        return ReloadControllerLibrariesResponse(True)

    def _switch(self, request: SwitchController) -> SwitchControllerResponse:
        done = threading.Event()

        def ask() -> SwitchRequest:
            switch = self._manager.switch(
                request.start_controllers,
                request.stop_controllers,
                request.strictness,
                request.start_asap,
            )
            switch.on_done = lambda _switch: done.set()
            if self._thread.held:
                # No update will come to carry it out; nothing moves, so it can be done here.
                now = self._thread.simulation.time_ns
                self._robot.hardware.read(now, 0.0)
                self._manager.carry_out(now)
            if switch.done:
                done.set()
            return switch

        switch = self._thread.call(ask)
        limit = request.timeout + 1.0 if request.timeout > 0.0 else SWITCH_TIMEOUT
        if not self._wait(done, limit):
            reason = (
                f"not carried out within {limit:g} s of wall time; does simulated time run "
                "(is the simulation paused, or the machine overloaded)?"
            )
            self._thread.call(lambda: switch.finish(reason))
        if not switch.ok:
            raise ControllerError(switch.reason)
        return SwitchControllerResponse(True)

    def _wait(self, done: threading.Event, limit: float) -> bool:
        """Return whether done was set within limit [s of wall time]; ends with the simulation."""
        deadline = time.monotonic() + limit
        while not done.wait(0.1):
            if self._thread.stopping:
                raise ControllerError(SHUTTING_DOWN)
            if time.monotonic() > deadline:
                return False
        return True

    def _with_parameters(self, job: Callable[[], T]) -> T:
        """Run job between two steps, after the manager got the robot's parameters anew."""
        parameters = robot_parameters(self._namespace)

        def refreshed() -> T:
            self._manager.parameters = parameters
            return job()

        return self._thread.call(refreshed)

    def _sync(self) -> None:
        """Open and close topics so that they are those of the controllers now loaded."""

        def loaded() -> dict[str, Controller]:
            return {info.name: self._manager.get(info.name) for info in self._manager.list()}

        controllers = self._thread.call(loaded)
        for name, topics in list(self._topics.items()):
            if controllers.get(name) is not topics.controller:
                topics.shutdown()
                del self._topics[name]
        for name, controller in controllers.items():
            if name not in self._topics:
                self._topics[name] = ControllerTopics(controller, self._namespace, self._thread)
