"""Find controller managers of a graph, list their controllers, and pick among these."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import rosgraph
import rospy
import rosservice

from controller_manager_msgs.msg import ControllerState
from controller_manager_msgs.srv import (
    ListControllers,
    ListControllersRequest,
)

_SERVICES = {
    name: f"controller_manager_msgs/{kind}"
    for name, kind in (
        ("list_controllers", "ListControllers"),
        ("list_controller_types", "ListControllerTypes"),
        ("load_controller", "LoadController"),
        ("unload_controller", "UnloadController"),
        ("switch_controller", "SwitchController"),
        ("reload_controller_libraries", "ReloadControllerLibraries"),
    )
}


def is_controller_manager(namespace: str) -> bool:
    """Whether `namespace` (/robot/controller_manager) has all services of such a manager."""
    return all(_type_of(rosgraph.names.ns_join(namespace, name)) == kind
               for name, kind in _SERVICES.items())


def _type_of(service: str) -> str | None:
    try:
        return rosservice.get_service_type(service)
    except rosservice.ROSServiceException:
        return None


def get_controller_managers(
    namespace: str = "/", initial_guess: Iterable[str] | None = None
) -> list[str]:
    """Namespaces of the controller managers at or below `namespace`, sorted.

    initial_guess: those of a look before. One that still lists controllers counts without a look
    at its other services.
    """
    below = rosgraph.names.make_global_ns(namespace)
    try:
        services = rosservice.get_service_list()
    except rosservice.ROSServiceException:
        return []
    ending = "/list_controllers"
    places = {name.removesuffix(ending) or "/" for name in services if name.endswith(ending)}
    known = set(initial_guess or ())
    return sorted(place for place in places
                  if rosgraph.names.make_global_ns(place).startswith(below)
                  and (place in known or is_controller_manager(place)))


class ControllerManagerLister:
    """Calling it gives the controller managers below a namespace."""

    def __init__(self, namespace: str = "/") -> None:
        """Look below `namespace`."""
        self._namespace = namespace
        self._found: list[str] = []

    def __call__(self) -> list[str]:
        """Namespaces of the managers that there are now."""
        self._found = get_controller_managers(self._namespace, self._found)
        return list(self._found)


class ControllerLister:
    """Calling it gives the controllers of a manager, [] while nobody answers."""

    def __init__(self, namespace: str = "/controller_manager") -> None:
        """Ask the manager whose services stand in `namespace`."""
        self.namespace = namespace
        name = rosgraph.names.ns_join(namespace, "list_controllers")
        self._service = rospy.ServiceProxy(name, ListControllers)

    def __call__(self) -> list[ControllerState]:
        """The controllers that are loaded now."""
        try:
            return list(self._service.call(ListControllersRequest()).controller)
        except (rospy.ServiceException, rospy.ROSException):
            return []


def get_rosparam_controller_names(namespace: str = "/") -> list[str]:
    """Names of the namespaces in `namespace` whose parameter `type` is a text: what could be
    loaded."""
    values = rospy.get_param(namespace or "/", {})
    values = values if isinstance(values, dict) else {}
    return [name for name, own in values.items()
            if isinstance(own, dict) and isinstance(own.get("type"), str)]


def _filter(
    controllers: Iterable[ControllerState],
    text: Callable[[ControllerState], str],
    wanted: str,
    match_substring: bool,
) -> list[ControllerState]:
    return [one for one in controllers
            if wanted == text(one) or match_substring and wanted in text(one)]


def filter_by_name(
    ctrl_list: Iterable[ControllerState], ctrl_name: str, match_substring: bool = False
) -> list[ControllerState]:
    """Those of a name."""
    return _filter(ctrl_list, lambda one: one.name, ctrl_name, match_substring)


def filter_by_type(
    ctrl_list: Iterable[ControllerState], ctrl_type: str, match_substring: bool = False
) -> list[ControllerState]:
    """Those of a type."""
    return _filter(ctrl_list, lambda one: one.type, ctrl_type, match_substring)


def filter_by_state(
    ctrl_list: Iterable[ControllerState], ctrl_state: str, match_substring: bool = False
) -> list[ControllerState]:
    """Those in a state: 'running', 'stopped'."""
    return _filter(ctrl_list, lambda one: one.state, ctrl_state, match_substring)


def filter_by_hardware_interface(
    ctrl_list: Iterable[ControllerState], hardware_interface: str, match_substring: bool = False
) -> list[ControllerState]:
    """Those that claim something of a hardware interface."""
    return [
        one for one in ctrl_list
        if any(hardware_interface == claim.hardware_interface
               or match_substring and hardware_interface in claim.hardware_interface
               for claim in one.claimed_resources)
    ]  # fmt: skip


def filter_by_resources(
    ctrl_list: Iterable[ControllerState],
    resources: Iterable[str],
    hardware_interface: str | None = None,
    match_any: bool = False,
) -> list[ControllerState]:
    """Those that claim all of some resources (joints), or any of them.

    hardware_interface: count what is claimed of this one only.
    """
    wanted, found = set(resources), []
    for one in ctrl_list:
        claims = [claim for claim in one.claimed_resources
                  if hardware_interface in (None, claim.hardware_interface)]
        claimed = {name for claim in claims for name in claim.resources}
        if claimed & wanted if match_any else claimed >= wanted:
            found.append(one)
    return found
