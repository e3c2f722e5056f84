"""Topics and services of gazebo_ros below /gazebo."""

from __future__ import annotations

from collections.abc import Callable

from aras_sim_bridge.ros.gazebo_api import attacher, lights, links, model_services, stepping, world
from aras_sim_bridge.ros.gazebo_api.forces import AppliedForces
from aras_sim_bridge.ros.gazebo_api.model_services import ModelServices
from aras_sim_bridge.ros.gazebo_api.physics_properties import PhysicsProperties
from aras_sim_bridge.ros.gazebo_api.states import ModelStateTopics, subscribe_states
from aras_sim_bridge.ros.gazebo_api.world import TimeReset
from aras_sim_bridge.ros.runtime.device_interfaces import DeviceInterfaces
from aras_sim_bridge.ros.runtime.services import ServiceTable, find_handlers
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread

NAMESPACE = "/gazebo"


class GazeboApi:
    """All topics and services that gazebo_ros offers to its clients."""

    def __init__(
        self,
        thread: SimulationThread,
        device_interfaces: DeviceInterfaces,
        on_time_reset: Callable[[], None],
        extra: bool = True,
        link_attacher: bool = False,
    ) -> None:
        """Advertise the topics and services.

        Args:
            thread: simulation thread.
            device_interfaces: ROS interfaces of the robots, cameras and sensors.
            on_time_reset: function that the simulation thread calls after a reset of simulated
                time.
            extra: whether to add topics and services that are not part of gazebo_ros's API.
            link_attacher: whether to offer the services of the plug-in gazebo_ros_link_attacher.
        """
        self.states = ModelStateTopics(NAMESPACE, thread, extra)
        forces = AppliedForces(thread)
        spawned = ModelServices(forces, device_interfaces)
        physics = PhysicsProperties(NAMESPACE, thread)
        reset = TimeReset(on_time_reset)
        ServiceTable(
            NAMESPACE,
            thread,
            *find_handlers(
                lights, links, model_services, world, forces, spawned, physics, reset,
                *([stepping] if extra else []),
            ),
        )
        if link_attacher:
            ServiceTable(attacher.NAMESPACE, thread, *find_handlers(attacher))
        subscribe_states(NAMESPACE, thread)
