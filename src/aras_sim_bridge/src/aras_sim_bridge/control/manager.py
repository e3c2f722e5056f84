"""Controller manager, which loads, switches, lists and runs the controllers of one robot.

All methods must be called in the simulation thread. Loading and unloading take effect immediately.
A switch is checked immediately and carried out at the end of the next update(). While the
simulation is paused, a switch request therefore stays pending; no method waits for it.
"""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence

from aras_sim_bridge.control.controllers.base import Controller, ControllerContext
from aras_sim_bridge.control.controllers.registry import BASE_CLASS, ControllerTypes
from aras_sim_bridge.control.hardware import RobotHardware
from aras_sim_bridge.control.switching import (
    ABORTED,
    BEST_EFFORT,
    RUNNING,
    STOPPED,
    STRICT,
    LoadedController,
    SwitchRequest,
    plan_switch,
)
from aras_sim_bridge.errors import ControllerError
from aras_visual_servo_base.names import USER_FAULTS
from aras_visual_servo_base.setting_values import find_value

CLASSES_PARAMETER = "controller_classes"
log = logging.getLogger(__name__)


def _flatten(classes: Mapping, above: str = "") -> Iterator[tuple[str, object]]:
    """Yield the type name and the 'package.module:Class' of each class in nested parameters.

    A type name consists of all keys that lead to the class, joined by slashes. `above` is the part
    of the name that leads to `classes`.
    """
    for name, path in classes.items():
        if isinstance(path, Mapping):
            yield from _flatten(path, f"{above}{name}/")
        else:
            yield f"{above}{name}", path


class ControllerManager:
    """Controllers of one robot, updated in the order in which they were loaded.

    Attributes:
        parameters: nested mapping of the parameters in the robot's namespace; the caller replaces
            it when parameters change.
        running: running controllers in the order of their updates.
        on_started: function that is called after a switch that started controllers, or None.
    """

    def __init__(
        self,
        hardware: RobotHardware,
        parameters: Mapping | None = None,
        namespace: str = "",
    ) -> None:
        self.hardware = hardware
        self.parameters = parameters or {}
        self.namespace = namespace.rstrip("/")
        self.registry = ControllerTypes()
        self._loaded: dict[str, LoadedController] = {}  # in the order of loading
        self._pending: list[SwitchRequest] = []
        self._has_e_stopped = False
        self._time_ns = 0
        self.running: tuple[LoadedController, ...] = ()
        self.on_started: Callable[[], None] | None = None

    def _list_classes(self) -> Mapping:
        """Return the 'package.module:Class' of users' controllers, by type name.

        The parameter server stores a type name with a slash as a nested mapping.
        """
        classes = self.parameters.get(CLASSES_PARAMETER) or {}
        if not isinstance(classes, Mapping):
            raise ControllerError(
                f"parameter {self.namespace}/{CLASSES_PARAMETER} must map type names to "
                f"'package.module:Class', found {classes!r}"
            )
        return dict(_flatten(classes))

    def load(self, name: str) -> Controller:
        """Create and initialise the controller `name` from the parameters under its name.

        Raises:
            ControllerError: the controller is already loaded, its type is missing or unknown, or
                its init fails; no controller is loaded.
        """
        if name in self._loaded:
            raise ControllerError(f"controller '{name}' is already loaded")
        given = find_value(self.parameters, name) if name else None
        where = f"{self.namespace}/{name}"
        type_name = given.get("type") if isinstance(given, Mapping) else None
        if not isinstance(type_name, str) or not type_name:
            raise ControllerError(
                f"cannot load controller '{name}': parameter {where}/type is missing; load its "
                f"YAML file into {self.namespace or '/'} first"
            )
        try:
            controller = self.registry.find(type_name, self._list_classes())()
            # Set the context here, because a user's `init` may omit the call of the base class's
            # `init`, which would set the context.
            controller.context = context = ControllerContext(
                name, self.namespace, self.hardware.description, self.parameters
            )
            controller.init(self.hardware, given, context)
        except ControllerError as error:
            raise ControllerError(f"cannot load controller '{name}': {error}") from error
        except USER_FAULTS as error:
            raise ControllerError(
                f"cannot load controller '{name}': {type_name} raised "
                f"{type(error).__name__}: {error}"
            ) from error
        self._loaded[name] = LoadedController(name, type_name, controller)
        return controller

    def unload(self, name: str) -> None:
        """Unload a controller. Raises ControllerError if it is not loaded or still running."""
        if name not in self._loaded:
            raise ControllerError(f"cannot unload controller '{name}': it is not loaded")
        if self._loaded[name].is_running:
            raise ControllerError(
                f"cannot unload controller '{name}': it is running; stop it first"
            )
        del self._loaded[name]

    def get(self, name: str) -> Controller:
        """Return the loaded controller `name`. Raises ControllerError if it is not loaded."""
        if name not in self._loaded:
            raise ControllerError(f"controller '{name}' is not loaded")
        return self._loaded[name].controller

    def list(self) -> Sequence[LoadedController]:
        """Return the loaded controllers in the order of their updates."""
        return tuple(self._loaded.values())

    def list_types(self) -> Sequence[tuple[str, str]]:
        """Return the known (type, base class) pairs, sorted by name."""
        return [(t, BASE_CLASS) for t in self.registry.list_types(self._list_classes())]

    def reload_libraries(self, force_kill: bool = False) -> None:
        """Reload the modules of users' controller classes.

        Args:
            force_kill: whether to stop and unload all controllers first.

        Raises:
            ControllerError: controllers are loaded and `force_kill` is False.
        """
        if self._loaded and not force_kill:
            raise ControllerError(
                f"cannot reload the controller classes: {', '.join(self._loaded)} are loaded; "
                f"unload them or set force_kill"
            )
        self.shutdown()
        self.registry.reload(self._list_classes())

    def shutdown(self) -> None:
        """Reject pending switches; stop and unload all controllers in reverse order of loading."""
        for entry in reversed(self.running):
            self._change_state(entry, STOPPED, self._time_ns)
        self._loaded.clear()
        self.running = ()
        pending, self._pending = self._pending, []
        for request in pending:
            request.finish("all controllers were unloaded")

    def switch(
        self,
        start: Sequence[str],
        stop: Sequence[str],
        strictness: int = BEST_EFFORT,
        start_asap: bool = False,
    ) -> SwitchRequest:
        """Request to stop and start controllers at the end of the next update.

        While another request is pending, a new one is queued and checked later.

        Raises:
            ControllerError: the rules of ros_control do not allow the switch.
        """
        if strictness == 0:
            log.warning(
                "switch_controller: strictness 0 is interpreted as BEST_EFFORT (1); set 1 or 2"
            )
            strictness = BEST_EFFORT
        if strictness not in (BEST_EFFORT, STRICT):
            raise ControllerError(
                f"strictness must be 1 (BEST_EFFORT) or 2 (STRICT), got {strictness}"
            )
        request = SwitchRequest(start, stop, strictness, start_asap)
        self._pending = [r for r in self._pending if not r.is_done]
        if not self._pending:
            plan_switch(request, self._loaded)
        self._pending.append(request)
        return request

    def update(self, time_ns: int, period: float) -> None:
        """Run one control cycle at `time_ns`, `period` s after the last one.

        After the release of an emergency stop, all running controllers are stopped and started
        first. If a controller raises, its state becomes 'aborted', the effort and velocity commands
        of its joints become 0, and the other controllers continue.
        """
        self._time_ns = time_ns
        if self.hardware.e_stop:
            self._has_e_stopped = True
        elif self._has_e_stopped:
            self._has_e_stopped = False
            for entry in self.running:
                if self._change_state(entry, STOPPED, time_ns):
                    self._change_state(entry, RUNNING, time_ns)
        for entry in self.running:
            self.run(entry, time_ns, period)
        if self._pending:
            self.carry_out_switches(time_ns)

    def run(self, entry: LoadedController, time_ns: int, period: float) -> None:
        """Update one controller; abort it if it raises."""
        try:
            entry.controller.update(time_ns, period)
        except USER_FAULTS as error:
            self._abort(entry, "update", error)

    @property
    def is_busy(self) -> bool:
        """Whether the next update also switches controllers or handles an emergency stop."""
        return bool(self._pending) or self._has_e_stopped or self.hardware.e_stop

    def reset(self, restart: bool = False) -> None:
        """Reset the controllers after the clock or the robot was reset.

        Pending commands are discarded; with `restart` the PIDs are reset, too.
        """
        for entry in self.list():
            controller = entry.controller
            try:
                controller.reset()
                if restart:
                    controller.restart(0)
            except USER_FAULTS as error:
                self._abort(entry, "reset", error)

    def carry_out_switches(self, time_ns: int) -> None:
        """Carry out the pending switches, at the end of an update or while the clock is paused."""
        pending, self._pending = self._pending, []
        for request in pending:
            if request.is_done:
                continue
            try:
                # Check the request again: after it was accepted, one of its controllers may have
                # been unloaded.
                stops, starts = plan_switch(request, self._loaded)
            except ControllerError as error:
                request.finish(str(error))
                continue
            for entry in stops:
                self._change_state(entry, STOPPED, time_ns)
            failed = [e.name for e in starts if not self._change_state(e, RUNNING, time_ns)]
            if len(failed) < len(starts) and self.on_started is not None:
                self.on_started()
            request.finish(f"failed to start: {', '.join(failed)}" if failed else "")

    def _change_state(self, entry: LoadedController, state: str, time_ns: int) -> bool:
        """Start or stop a controller; return whether this succeeded."""
        verb = "starting" if state == RUNNING else "stopping"
        try:
            getattr(entry.controller, verb)(time_ns)
        except USER_FAULTS as error:
            self._abort(entry, verb, error)
            return False
        self._set_state(entry, state)
        return True

    def _set_state(self, entry: LoadedController, state: str) -> None:
        entry.state = state
        self.running = tuple(e for e in self._loaded.values() if e.is_running)

    def _abort(self, entry: LoadedController, verb: str, error: BaseException) -> None:
        self._set_state(entry, ABORTED)
        for joint in entry.controller.joints:
            handle = self.hardware.handles.get(joint)
            if handle is not None:
                handle.effort_command = 0.0
                handle.velocity_command = 0.0
        log.error(
            f"controller '{entry.name}' raised {type(error).__name__} in {verb}(): {error}; it is "
            f"aborted and its joints {', '.join(entry.controller.joints) or '(none)'} are released"
        )
