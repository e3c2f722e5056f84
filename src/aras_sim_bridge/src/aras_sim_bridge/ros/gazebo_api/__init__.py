"""gazebo_ros's topics and services below /gazebo."""

from __future__ import annotations

from typing import Any

from aras_sim_bridge.ros.gazebo_api.forces import ForceServices
from aras_sim_bridge.ros.gazebo_api.lights import LightServices
from aras_sim_bridge.ros.gazebo_api.links import LinkServices
from aras_sim_bridge.ros.gazebo_api.models import ModelServices
from aras_sim_bridge.ros.gazebo_api.physics import PhysicsServices
from aras_sim_bridge.ros.gazebo_api.states import StateTopics
from aras_sim_bridge.ros.gazebo_api.world import WorldServices
from aras_sim_bridge.ros.runtime.services import ServiceTable

NAMESPACE = "/gazebo"


class GazeboApi:
    """Everything that clients of gazebo_ros find; `node` is the GazeboNode."""

    def __init__(self, node: Any) -> None:
        """Advertise all of it."""
        self.table = ServiceTable(NAMESPACE)
        self.states = StateTopics(NAMESPACE, node)
        self.forces = ForceServices(self.table, node)
        self.models = ModelServices(self.table, node)
        self.links = LinkServices(self.table, NAMESPACE, node, self.models)
        self.lights = LightServices(self.table, node)
        self.physics = PhysicsServices(self.table, NAMESPACE, node)
        self.world = WorldServices(self.table, node)
