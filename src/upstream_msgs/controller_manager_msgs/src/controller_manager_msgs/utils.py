"""Find controller managers in the ROS graph, and list and filter their controllers."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import rosgraph
import rospy
import rosservice

from controller_manager_msgs.msg import ControllerState
from controller_manager_msgs.srv import ListControllers, ListControllersRequest

_SERVICES = {  # type of each service in the package controller_manager_msgs
    "list_controllers": "ListControllers", "list_controller_types": "ListControllerTypes",
    "load_controller": "LoadController", "unload_controller": "UnloadController",
    "switch_controller": "SwitchController",
    "reload_controller_libraries": "ReloadControllerLibraries",
}  # fmt: skip


def is_controller_manager(namespace: str) -> bool:
    """Return whether a namespace (e.g. /robot/controller_manager) has all services of a manager."""
    try:
        return all(
            rosservice.get_service_type(rosgraph.names.ns_join(namespace, name))
            == f"controller_manager_msgs/{kind}" for name, kind in _SERVICES.items()
        )  # fmt: skip
    except rosservice.ROSServiceException:
        return False


def get_controller_managers(
    namespace: str = "/", initial_guess: Iterable[str] | None = None
) -> list[str]:
    """Return the sorted namespaces of the controller managers at or below `namespace`.

    initial_guess: namespaces that an earlier call returned. If a manager there still lists
        controllers, its other services are not checked again.
    """
    below = rosgraph.names.make_global_ns(namespace)
    try:
        services = rosservice.get_service_list()
    except rosservice.ROSServiceException:
        return []
    suffix = "/list_controllers"
    managers = {name.removesuffix(suffix) or "/" for name in services if name.endswith(suffix)}
    known = set(initial_guess or ())
    return sorted(manager for manager in managers
                  if rosgraph.names.make_global_ns(manager).startswith(below)
                  and (manager in known or is_controller_manager(manager)))


class ControllerManagerLister:
    """Callable that returns the controller managers below a namespace."""

    def __init__(self, namespace: str = "/") -> None:
        """Create a lister for the managers at or below `namespace`."""
        self._namespace = namespace
        self._found: list[str] = []

    def __call__(self) -> list[str]:
        """Return the namespaces of the controller managers that are running now."""
        self._found = get_controller_managers(self._namespace, self._found)
        return list(self._found)


class ControllerLister:
    """Callable that returns the controllers of a manager, or [] if it does not respond."""

    def __init__(self, namespace: str = "/controller_manager") -> None:
        """Create a lister for the manager whose services are in `namespace`."""
        self.namespace = namespace
        name = rosgraph.names.ns_join(namespace, "list_controllers")
        self._service = rospy.ServiceProxy(name, ListControllers)

    def __call__(self) -> list[ControllerState]:
        """Return the loaded controllers."""
        try:
            return list(self._service.call(ListControllersRequest()).controller)
        except (rospy.ServiceException, rospy.ROSException):
            return []


def get_rosparam_controller_names(namespace: str = "/") -> list[str]:
    """Return the names of the controllers whose parameters are in `namespace`.

    A name is that of a controller if the parameter <namespace>/<name>/type is a string.
    """
    values = rospy.get_param(namespace or "/", {})
    values = values if isinstance(values, dict) else {}
    return [name for name, parameters in values.items()
            if isinstance(parameters, dict) and isinstance(parameters.get("type"), str)]


def _filter(
    controllers: Iterable[ControllerState], list_texts: Callable[[ControllerState], list[str]],
    pattern: str, match_substring: bool,
) -> list[ControllerState]:  # fmt: skip
    return [
        controller for controller in controllers
        if any(pattern == text or match_substring and pattern in text
               for text in list_texts(controller))
    ]  # fmt: skip


def filter_by_name(
    ctrl_list: Iterable[ControllerState], ctrl_name: str, match_substring: bool = False
) -> list[ControllerState]:
    """Return the controllers whose name is, or with `match_substring` contains, `ctrl_name`."""
    return _filter(ctrl_list, lambda controller: [controller.name], ctrl_name, match_substring)


def filter_by_type(
    ctrl_list: Iterable[ControllerState], ctrl_type: str, match_substring: bool = False
) -> list[ControllerState]:
    """Return the controllers whose type is, or with `match_substring` contains, `ctrl_type`."""
    return _filter(ctrl_list, lambda controller: [controller.type], ctrl_type, match_substring)


def filter_by_state(
    ctrl_list: Iterable[ControllerState], ctrl_state: str, match_substring: bool = False
) -> list[ControllerState]:
    """Return the controllers in the state `ctrl_state`, such as 'running' or 'stopped'.

    With `match_substring`, it is sufficient that the state contains `ctrl_state`.
    """
    return _filter(ctrl_list, lambda controller: [controller.state], ctrl_state, match_substring)


def filter_by_hardware_interface(
    ctrl_list: Iterable[ControllerState], hardware_interface: str, match_substring: bool = False
) -> list[ControllerState]:
    """Return the controllers that claim resources of the interface `hardware_interface`.

    With `match_substring`, it is sufficient that the interface's name contains this text.
    """
    def list_interfaces(controller: ControllerState) -> list[str]:
        return [claim.hardware_interface for claim in controller.claimed_resources]

    return _filter(ctrl_list, list_interfaces, hardware_interface, match_substring)


def filter_by_resources(
    ctrl_list: Iterable[ControllerState],
    resources: Iterable[str],
    hardware_interface: str | None = None,
    match_any: bool = False,
) -> list[ControllerState]:
    """Return the controllers that claim all of the given resources (joints).

    match_any: whether it is sufficient that a controller claims one of them.
    hardware_interface: if given, only the resources of this hardware interface are considered.
    """
    names, matches = set(resources), []
    for controller in ctrl_list:
        claims = [claim for claim in controller.claimed_resources
                  if hardware_interface in (None, claim.hardware_interface)]
        claimed = {name for claim in claims for name in claim.resources}
        if claimed & names if match_any else claimed >= names:
            matches.append(controller)
    return matches
