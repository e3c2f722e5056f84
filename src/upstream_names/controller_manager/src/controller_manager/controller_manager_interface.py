"""Functions that load, start, stop and list controllers.

They use the controller manager in this node's namespace.
"""

from aras_sim_bridge.ros.cli.controller_manager import (
    list_controller_types,
    list_controllers,
    load_controller,
    reload_libraries,
    start_controller,
    start_controllers,
    start_stop_controllers,
    stop_controller,
    stop_controllers,
    unload_controller,
)

__all__ = [
    "list_controller_types",
    "list_controllers",
    "load_controller",
    "reload_libraries",
    "start_controller",
    "start_controllers",
    "start_stop_controllers",
    "stop_controller",
    "stop_controllers",
    "unload_controller",
]
