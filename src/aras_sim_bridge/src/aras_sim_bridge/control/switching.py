"""Requests of switch_controller, and the rules of ros_control for them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from aras_sim_bridge.control.controllers.base import ClaimedResources, Controller
from aras_sim_bridge.errors import ControllerError

BEST_EFFORT = 1
STRICT = 2

INITIALIZED = "initialized"
RUNNING = "running"
STOPPED = "stopped"
ABORTED = "aborted"


@dataclass(frozen=True, slots=True)
class ControllerInfo:
    """Information on one controller for list_controllers."""

    name: str
    state: str
    type: str
    claimed_resources: tuple[ClaimedResources, ...]


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


class LoadedController:
    """A loaded controller with its name, type and state."""

    __slots__ = ("name", "type_name", "controller", "state", "running")

    def __init__(self, name: str, type_name: str, controller: Controller) -> None:
        self.name = name
        self.type_name = type_name
        self.controller = controller
        self.state = INITIALIZED
        self.running = False

    def set_state(self, state: str) -> None:
        """Set the state."""
        self.state = state
        self.running = state == RUNNING


def plan_switch(
    request: SwitchRequest,
    entries: Mapping[str, LoadedController],
    order: Sequence[LoadedController],
) -> tuple[list[LoadedController], list[LoadedController]]:
    """Return the controllers to stop and the controllers to start.

    Args:
        entries: loaded controllers by name.
        order: the same controllers in the order of updates.

    Raises:
        ControllerError: the rules of ros_control do not allow the switch.
    """
    strict = request.strictness == STRICT
    stops = _find_entries(request.stop, entries, strict, "stop")
    starts = _find_entries(request.start, entries, strict, "start")
    for entry in stops:
        if entry in starts and entry.running:
            raise ControllerError(
                f"controller '{entry.name}' is running and cannot be both stopped and started in "
                f"one switch"
            )
        if strict and not entry.running:
            raise ControllerError(
                f"cannot stop controller '{entry.name}': it is {entry.state}, not running"
            )
    stops = [entry for entry in stops if entry.running]
    for entry in starts:
        if strict and entry.running:
            raise ControllerError(f"cannot start controller '{entry.name}': it is running already")
    _check_claims([e for e in order if (e.running and e not in stops) or e in starts])
    if request.start_asap:
        starts = [entry for entry in starts if not entry.running]
    return stops, starts


def _find_entries(
    names: Sequence[str], entries: Mapping[str, LoadedController], strict: bool, verb: str
) -> list[LoadedController]:
    found = []
    for name in names:
        if name in entries:
            found.append(entries[name])
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
