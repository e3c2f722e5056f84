"""model_states, link_states and performance_metrics: built only while somebody listens."""

from __future__ import annotations

import time

import rospy
from gazebo_msgs.msg import LinkStates, ModelStates, PerformanceMetrics, SensorPerformanceMetric

from aras_sim_bridge.ros.conversions import to_pose, to_time, to_twist
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread
from aras_sim_bridge.simulation import Simulation

METRICS_PERIOD = 0.2  # seconds of wall time between two performance_metrics


class StateTopics:
    """The simulation's state for everybody who subscribes."""

    def __init__(self, namespace: str, thread: SimulationThread) -> None:
        """Advertise below `namespace`."""
        self._thread = thread
        self._models = rospy.Publisher(f"{namespace}/model_states", ModelStates, queue_size=10)
        self._links = rospy.Publisher(f"{namespace}/link_states", LinkStates, queue_size=10)
        self._metrics = rospy.Publisher(
            f"{namespace}/performance_metrics", PerformanceMetrics, queue_size=10
        )
        self._next_metrics = 0.0

    def after_batch(self, simulation: Simulation) -> None:
        """Publish what is listened to; called in the simulation's thread."""
        if self._models.get_num_connections():
            self._models.publish(model_states(simulation))
        if self._links.get_num_connections():
            self._links.publish(link_states(simulation))
        now = time.monotonic()
        if now >= self._next_metrics:
            self._next_metrics = now + METRICS_PERIOD
            if self._metrics.get_num_connections():
                self._metrics.publish(self._performance(simulation))

    def _performance(self, simulation: Simulation) -> PerformanceMetrics:
        message = PerformanceMetrics(real_time_factor=self._thread.real_time_factor)
        message.header.stamp = to_time(simulation.time_ns)
        for mounted in simulation.cameras:
            config = mounted.sensor.config
            message.sensors.append(
                SensorPerformanceMetric(
                    name=config.name,
                    sim_update_rate=mounted.sensor.rate,
                    real_update_rate=mounted.sensor.rate * message.real_time_factor,
                    fps=mounted.sensor.rate * message.real_time_factor if mounted.enabled else 0.0,
                )
            )
        return message


def model_states(simulation: Simulation) -> ModelStates:
    """Return pose and twist of every model's root link in the world."""
    message = ModelStates()
    for name, model in simulation.world.models.items():
        pose, twist = model.link_state(model.description.root)
        message.name.append(name)
        message.pose.append(to_pose(pose))
        message.twist.append(to_twist(twist))
    return message


def link_states(simulation: Simulation) -> LinkStates:
    """Return pose and twist of every link in the world, named model::link."""
    message = LinkStates()
    for name, model in simulation.world.models.items():
        for link, (pose, twist) in model.link_states().items():
            message.name.append(f"{name}::{link}")
            message.pose.append(to_pose(pose))
            message.twist.append(to_twist(twist))
    return message
