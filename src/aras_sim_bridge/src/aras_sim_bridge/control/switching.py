"""Requests of switch_controller, and the rules of ros_control for them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from aras_sim_bridge.control.controllers.base import Controller
from aras_sim_bridge.errors import ControllerError

BEST_EFFORT = 1
STRICT = 2

INITIALIZED = "initialized"
RUNNING = "running"
STOPPED = "stopped"
ABORTED = "aborted"


class SwitchRequest:
    """A request to switch controllers.

    Attributes:
        is_done: whether the request was carried out, rejected or cancelled.
        is_successful: whether the request was carried out; otherwise `reason` says why not.
        on_done: function that is called with the request when it is done, or None.
    """

    def __init__(
        self, start: Sequence[str], stop: Sequence[str], strictness: int, start_asap: bool
    ) -> None:
        self.start = tuple(dict.fromkeys(start))
        self.stop = tuple(dict.fromkeys(stop))
        self.strictness = strictness
        self.start_asap = start_asap
        self.on_done: Callable[[SwitchRequest], None] | None = None
        self.is_successful = False
        self.reason = ""
        self.is_done = False

    def finish(self, reason: str = "") -> None:
        """End the request unless it is done; `reason` is '' or says why it was not carried out."""
        if self.is_done:
            return
        self.is_successful, self.reason = not reason, reason
        self.is_done = True
        if self.on_done is not None:
            self.on_done(self)


@dataclass(slots=True, eq=False)
class LoadedController:
    """A loaded controller with its name, type and state, as list_controllers reports them."""

    name: str
    type: str
    controller: Controller
    state: str = INITIALIZED

    @property
    def is_running(self) -> bool:
        """Whether the control loop updates the controller."""
        return self.state == RUNNING


def plan_switch(
    request: SwitchRequest, loaded: Mapping[str, LoadedController]
) -> tuple[list[LoadedController], list[LoadedController]]:
    """Return the controllers to stop and the controllers to start.

    Args:
        loaded: loaded controllers by name, in the order of updates.

    Raises:
        ControllerError: the rules of ros_control do not allow the switch.
    """
    strict = request.strictness == STRICT
    stops = _find_entries(request.stop, loaded, strict, "stop")
    starts = _find_entries(request.start, loaded, strict, "start")
    for entry in stops:
        if entry in starts and entry.is_running:
            raise ControllerError(
                f"controller '{entry.name}' is running and cannot be both stopped and started in "
                f"one switch"
            )
        if strict and not entry.is_running:
            raise ControllerError(
                f"cannot stop controller '{entry.name}': it is {entry.state}, not running"
            )
    stops = [entry for entry in stops if entry.is_running]
    for entry in starts:
        if strict and entry.is_running:
            raise ControllerError(f"cannot start controller '{entry.name}': it is running already")
    _check_claims(
        [e for e in loaded.values() if (e.is_running and e not in stops) or e in starts]
    )
    if request.start_asap:
        starts = [entry for entry in starts if not entry.is_running]
    return stops, starts


def _find_entries(
    names: Sequence[str], loaded: Mapping[str, LoadedController], strict: bool, verb: str
) -> list[LoadedController]:
    found = []
    for name in names:
        if name in loaded:
            found.append(loaded[name])
        elif strict:
            raise ControllerError(f"cannot {verb} controller '{name}': it is not loaded")
    return found


def _check_claims(entries: Sequence[LoadedController]) -> None:
    """Check that no joint is claimed by two controllers, even through different interfaces.

    Raises:
        ControllerError: a joint is claimed twice.
    """
    owners: dict[str, list[str]] = {}
    for entry in entries:
        for joint in sorted({r for c in entry.controller.claimed_resources for r in c.resources}):
            owners.setdefault(joint, []).append(entry.name)
    conflicts = [
        f"'{joint}' by {', '.join(names)}" for joint, names in owners.items() if len(names) > 1
    ]
    if conflicts:
        raise ControllerError(
            f"resource conflict, joints claimed more than once: {'; '.join(conflicts)}. Stop all "
            "but one of these controllers"
        )
