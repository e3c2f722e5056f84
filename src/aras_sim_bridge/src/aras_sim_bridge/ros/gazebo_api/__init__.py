"""Topics and services of gazebo_ros below /gazebo."""

from __future__ import annotations

from aras_sim_bridge.ros.gazebo_api import attacher, lights, links, model_services, stepping, world
from aras_sim_bridge.ros.gazebo_api.forces import AppliedForces
from aras_sim_bridge.ros.gazebo_api.model_services import ModelServices
from aras_sim_bridge.ros.gazebo_api.physics_properties import PhysicsProperties
from aras_sim_bridge.ros.gazebo_api.states import ModelStateTopics, subscribe_states
from aras_sim_bridge.ros.runtime.device_interfaces import DeviceInterfaces
from aras_sim_bridge.ros.runtime.services import ServiceTable, find_handlers
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread

NAMESPACE = "/gazebo"


def advertise_gazebo_api(
    thread: SimulationThread,
    device_interfaces: DeviceInterfaces,
    extra: bool = True,
    link_attacher: bool = False,
) -> ModelStateTopics:
    """Advertise all topics and services that gazebo_ros offers; return the topics of states.

    Args:
        thread: simulation thread.
        device_interfaces: ROS interfaces of the robots, cameras and sensors.
        extra: whether to add topics and services that are not part of gazebo_ros's API.
        link_attacher: whether to offer the services of the plug-in gazebo_ros_link_attacher.
    """
    states = ModelStateTopics(NAMESPACE, thread, extra)
    forces = AppliedForces(thread)
    spawned = ModelServices(forces, device_interfaces)
    physics = PhysicsProperties(NAMESPACE, thread)
    places = [lights, links, model_services, world, forces, spawned, physics]
    if extra:
        places.append(stepping)
    ServiceTable(NAMESPACE, thread, *find_handlers(*places))
    if link_attacher:
        ServiceTable(attacher.NAMESPACE, thread, *find_handlers(attacher))
    subscribe_states(NAMESPACE, thread)
    return states
