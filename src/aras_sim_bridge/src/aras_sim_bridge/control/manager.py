"""controller_manager: loads, switches, lists and runs the controllers of one robot.

One thread, the simulation's, owns the manager: every method except the properties of a
SwitchRequest is to be called from it. Loading and unloading take effect at once; a switch is
checked at once and carried out at the end of the next update(), so a request made while the
simulation is paused simply stays open: nothing here blocks.
"""

from collections.abc import Callable, Mapping, Sequence

from aras_sim_bridge import parameters as params
from aras_sim_bridge.control.controllers import Registry
from aras_sim_bridge.control.controllers.base import Context, Controller
from aras_sim_bridge.control.controllers.registry import BASE_CLASS
from aras_sim_bridge.control.hardware import RobotHardware
from aras_sim_bridge.control.statistics import ControllerStatistics
from aras_sim_bridge.control.switching import (
    ABORTED,
    BEST_EFFORT,
    RUNNING,
    STOPPED,
    STRICT,
    ControllerInfo,
    Entry,
    SwitchRequest,
    plan_switch,
)
from aras_sim_bridge.errors import ControllerError

CLASSES = "controller_classes"


def _ignore(text: str) -> None:
    """Stand-in for a logger."""


class ControllerManager:
    """Controllers of one robot, updated in the order they were loaded.

    `parameters` is the nested mapping of the robot's namespace, or a function that returns it as
    it is now. `warn` and `error` take lines for the log. `clock_ns`, a function such as
    time.perf_counter_ns, turns the statistics on.
    """

    def __init__(
        self,
        hardware: RobotHardware,
        parameters: Mapping | Callable[[], Mapping] | None = None,
        namespace: str = "",
        warn: Callable[[str], None] = _ignore,
        error: Callable[[str], None] = _ignore,
    ) -> None:
        self.hardware = hardware
        self.parameters = parameters if parameters is not None else {}
        self.namespace = namespace.rstrip("/")
        self.registry = Registry()
        self.clock_ns: Callable[[], int] | None = None
        self._warn = warn
        self._error = error
        self._entries: dict[str, Entry] = {}
        self._order: list[Entry] = []
        self._pending: list[SwitchRequest] = []
        self._was_stopped = False
        self._time_ns = 0

    def _mapping(self) -> Mapping:
        return self.parameters() if callable(self.parameters) else self.parameters

    def _classes(self, parameters: Mapping) -> Mapping:
        classes = parameters.get(CLASSES) or {}
        if not isinstance(classes, Mapping):
            raise ControllerError(
                f"parameter {self.namespace}/{CLASSES} must map type names to "
                f"'package.module:Class', found {classes!r}"
            )
        return classes

    def load(self, name: str, parameters: Mapping | None = None) -> Controller:
        """Make and initialise the controller `name` from the parameters under its name.

        `parameters`, if given, stand for the robot's whole namespace in this call. Raises
        ControllerError, leaving everything as it was, if the name is taken, its type is missing or
        unknown, or its init fails.
        """
        if name in self._entries:
            raise ControllerError(f"controller '{name}' is already loaded")
        root = self._mapping() if parameters is None else parameters
        own = params.lookup(root, name) if name else None
        where = f"{self.namespace}/{name}"
        if not isinstance(own, Mapping) or not isinstance(own.get("type"), str) or not own["type"]:
            raise ControllerError(
                f"cannot load controller '{name}': parameter {where}/type is missing; load its "
                f"YAML file into {self.namespace or '/'} first"
            )
        type_name = own["type"]
        try:
            controller = self.registry.find(type_name, self._classes(root))()
            # A user's init may forget to call the base's.
            controller.context = context = self._context(name, root)
            controller.init(self.hardware, own, context)
        except ControllerError as error:
            raise ControllerError(f"cannot load controller '{name}': {error}") from error
        # A user's class may fail in any way; that must not stop the simulation.
        except Exception as error:
            raise ControllerError(
                f"cannot load controller '{name}': {type_name} raised "
                f"{type(error).__name__}: {error}"
            ) from error
        entry = Entry(name, type_name, controller)
        self._entries[name] = entry
        self._order = [*self._order, entry]
        return controller

    def _context(self, name: str, root: Mapping) -> Context:
        return Context(
            name, self.namespace, self.hardware.description, root, self._warn, self._error
        )

    def unload(self, name: str) -> None:
        """Forget the controller. Raises ControllerError if it is not loaded or running."""
        entry = self._entries.get(name)
        if entry is None:
            raise ControllerError(f"cannot unload controller '{name}': it is not loaded")
        if entry.running:
            raise ControllerError(
                f"cannot unload controller '{name}': it is running; stop it first"
            )
        del self._entries[name]
        self._order = [other for other in self._order if other is not entry]

    def get(self, name: str) -> Controller:
        """The loaded controller `name`. Raises ControllerError if there is none."""
        if name not in self._entries:
            raise ControllerError(f"controller '{name}' is not loaded")
        return self._entries[name].controller

    def list(self) -> Sequence[ControllerInfo]:
        """Loaded controllers in the order of their updates."""
        return [
            ControllerInfo(e.name, e.state, e.type_name, e.controller.claimed_resources)
            for e in self._order
        ]

    def list_types(self) -> Sequence[tuple[str, str]]:
        """Known (type, base class) pairs, by name."""
        return [(t, BASE_CLASS) for t in self.registry.types(self._classes(self._mapping()))]

    def reload_libraries(self, force_kill: bool = False) -> None:
        """Import the users' controller classes anew; loaded controllers are in the way.

        With `force_kill` they are stopped and unloaded first. Raises ControllerError otherwise.
        """
        if self._entries and not force_kill:
            raise ControllerError(
                f"cannot reload the controller classes: {', '.join(self._entries)} are loaded; "
                f"unload them or ask for force_kill"
            )
        self.shutdown()
        self.registry.reload(self._classes(self._mapping()))

    def shutdown(self) -> None:
        """Stop and unload every controller, the last loaded first; open switches are refused."""
        for entry in reversed(self._order):
            if entry.running:
                self._stop(entry, self._time_ns)
        self._entries.clear()
        self._order = []
        pending, self._pending = self._pending, []
        for request in pending:
            request.cancel("all controllers were unloaded")

    def request_switch(
        self,
        start: Sequence[str],
        stop: Sequence[str],
        strictness: int = BEST_EFFORT,
        start_asap: bool = False,
    ) -> SwitchRequest:
        """Ask to stop and start controllers at the end of the next update.

        Refused at once (done, not ok, with a reason) where the rules of ros_control say so. A
        request made while another is open waits its turn and is checked then.
        """
        if strictness == 0:
            self._warn("switch_controller: strictness 0 is taken as BEST_EFFORT (1)")
            strictness = BEST_EFFORT
        request = SwitchRequest(start, stop, strictness, start_asap)
        if strictness not in (BEST_EFFORT, STRICT):
            request.cancel(f"strictness must be 1 (BEST_EFFORT) or 2 (STRICT), got {strictness}")
            return request
        self._pending = [r for r in self._pending if not r.done]
        if not self._pending:
            try:
                plan_switch(request, self._entries, self._order)
            except ControllerError as error:
                request.cancel(str(error))
                return request
        self._pending.append(request)
        return request

    def switch(
        self,
        start: Sequence[str],
        stop: Sequence[str],
        strictness: int = BEST_EFFORT,
        start_asap: bool = False,
    ) -> SwitchRequest:
        """As request_switch, but raises ControllerError where that refuses at once."""
        request = self.request_switch(start, stop, strictness, start_asap)
        if request.done and not request.ok:
            raise ControllerError(request.reason)
        return request

    def update(self, time_ns: int, period: float) -> None:
        """One control cycle at `time_ns`, `period` s after the last one.

        After an emergency stop was released every running controller is stopped and started
        first. A controller that raises is taken out (state 'aborted') and its joints' effort and
        velocity commands are zeroed; the others go on.
        """
        self._time_ns = time_ns
        if self.hardware.e_stop:
            self._was_stopped = True
        elif self._was_stopped:
            self._was_stopped = False
            for entry in self._order:
                if entry.running and self._stop(entry, time_ns):
                    self._start(entry, time_ns)
        clock_ns = self.clock_ns
        for entry in self._order:
            if entry.running:
                begin = 0 if clock_ns is None else clock_ns()
                try:
                    entry.controller.update(time_ns, period)
                except Exception as error:
                    self._abort(entry, "update", error)
                if clock_ns is not None:
                    entry.timer.add(clock_ns() - begin, time_ns, period)
        if self._pending:
            self.carry_out(time_ns)

    def reset(self) -> None:
        """The clock or the robot was put back: controllers forget commands not yet acted on."""
        for entry in self._order:
            try:
                entry.controller.reset()
            except Exception as error:
                self._abort(entry, "reset", error)

    def carry_out(self, time_ns: int) -> None:
        """Carry out the open switches now: at the end of an update, or while time stands still."""
        pending, self._pending = self._pending, []
        for request in pending:
            if request.done:
                continue
            try:
                # Checked again: something may have been unloaded since the request.
                stops, starts = plan_switch(request, self._entries, self._order)
            except ControllerError as error:
                request.cancel(str(error))
                continue
            for entry in stops:
                self._stop(entry, time_ns)
            failed = [entry.name for entry in starts if not self._start(entry, time_ns)]
            request.finish(not failed, f"failed to start: {', '.join(failed)}" if failed else "")

    def _start(self, entry: Entry, time_ns: int) -> bool:
        try:
            entry.controller.starting(time_ns)
        except Exception as error:
            self._abort(entry, "starting", error)
            return False
        entry.enter(RUNNING)
        return True

    def _stop(self, entry: Entry, time_ns: int) -> bool:
        try:
            entry.controller.stopping(time_ns)
        except Exception as error:
            self._abort(entry, "stopping", error)
            return False
        entry.enter(STOPPED)
        return True

    def _abort(self, entry: Entry, verb: str, error: Exception) -> None:
        entry.enter(ABORTED)
        for joint in entry.controller.joints:
            handle = self.hardware.handles.get(joint)
            if handle is not None:
                handle.effort_command = 0.0
                handle.velocity_command = 0.0
        self._error(
            f"controller '{entry.name}' raised {type(error).__name__} in {verb}(): {error}; it is "
            f"aborted and its joints {', '.join(entry.controller.joints) or '(none)'} are released"
        )

    def statistics(self) -> Sequence[ControllerStatistics]:
        """Update times of the loaded controllers, measured while `clock_ns` is set."""
        return [e.timer.statistics(e.name, e.type_name, e.running) for e in self._order]
