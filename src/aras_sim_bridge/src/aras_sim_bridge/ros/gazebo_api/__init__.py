"""gazebo_ros's topics and services below /gazebo."""

from __future__ import annotations

from collections.abc import Callable

from aras_sim_bridge.ros.gazebo_api.forces import ForceServices
from aras_sim_bridge.ros.gazebo_api.lights import LightServices
from aras_sim_bridge.ros.gazebo_api.links import LinkServices
from aras_sim_bridge.ros.gazebo_api.models import ModelServices
from aras_sim_bridge.ros.gazebo_api.physics import PhysicsServices
from aras_sim_bridge.ros.gazebo_api.states import StateTopics
from aras_sim_bridge.ros.gazebo_api.world import WorldServices
from aras_sim_bridge.ros.runtime.graph import OnGraph
from aras_sim_bridge.ros.runtime.services import ServiceTable
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread

NAMESPACE = "/gazebo"


class GazeboApi:
    """Everything that clients of gazebo_ros find."""

    def __init__(
        self, thread: SimulationThread, on_graph: OnGraph, on_time_reset: Callable[[], None]
    ) -> None:
        """Advertise all of it; `on_time_reset` is called in the simulation's thread."""
        table = ServiceTable(NAMESPACE, thread)
        self.states = StateTopics(NAMESPACE, thread)
        forces = ForceServices(table, thread)
        models = ModelServices(table, thread, forces, on_graph)
        LinkServices(table, NAMESPACE, thread, models)
        LightServices(table, thread)
        PhysicsServices(table, NAMESPACE, thread)
        WorldServices(table, thread, on_time_reset)
