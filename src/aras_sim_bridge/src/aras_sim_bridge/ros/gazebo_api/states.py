"""Topics that publish the state of the simulation, and topics that set it."""

from __future__ import annotations

import contextlib
import time
from functools import partial

import rospy
from gazebo_msgs.msg import (
    LinkState,
    LinkStates,
    ModelState,
    ModelStates,
    PerformanceMetrics,
    SensorPerformanceMetric,
)
from std_msgs.msg import Float64

from aras_sim_bridge.errors import SimError
from aras_sim_bridge.ros.conversions import to_pose, to_time, to_twist
from aras_sim_bridge.ros.gazebo_api.links import move_link
from aras_sim_bridge.ros.gazebo_api.model_services import move_model
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread
from aras_sim_bridge.simulation import Simulation

METRICS_PERIOD = 0.2  # interval between two messages of performance_metrics, s of wall time
# Interval between two messages of real_time_factor, s of wall time. The messages continue while
# simulated time is paused.
FACTOR_PERIOD = 1.0


class ModelStateTopics:
    """Publishers of model states, link states and performance.

    Messages are only created for topics that have subscribers.
    """

    def __init__(self, namespace: str, thread: SimulationThread, extra: bool) -> None:
        """Advertise model_states and link_states below `namespace`.

        With `extra`, performance_metrics and real_time_factor are advertised, too.
        """
        self._thread = thread
        self._models = rospy.Publisher(f"{namespace}/model_states", ModelStates, queue_size=10)
        self._links = rospy.Publisher(f"{namespace}/link_states", LinkStates, queue_size=10)
        self._metrics: rospy.Publisher | None = None
        self._next_metrics = 0.0
        if extra:
            self._metrics = rospy.Publisher(
                f"{namespace}/performance_metrics", PerformanceMetrics, queue_size=10
            )
            self._factor = rospy.Publisher(f"{namespace}/real_time_factor", Float64, queue_size=1)
            rospy.Timer(rospy.Duration.from_sec(FACTOR_PERIOD), self._publish_factor)

    def _publish_factor(self, _event: rospy.timer.TimerEvent) -> None:
        with contextlib.suppress(rospy.ROSException):  # rospy has closed the topic at shutdown
            self._factor.publish(self._thread.real_time_factor)

    def after_batch(self, simulation: Simulation) -> None:
        """Publish on all topics that have subscribers, after a group of steps.

        This is called in the simulation thread.
        """
        if self._models.get_num_connections():
            self._models.publish(make_model_states(simulation))
        if self._links.get_num_connections():
            self._links.publish(make_link_states(simulation))
        now = time.monotonic()
        if self._metrics is not None and now >= self._next_metrics:
            self._next_metrics = now + METRICS_PERIOD
            if self._metrics.get_num_connections():
                self._metrics.publish(self._make_performance_metrics(simulation))

    def _make_performance_metrics(self, simulation: Simulation) -> PerformanceMetrics:
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


def make_model_states(simulation: Simulation) -> ModelStates:
    """Return poses and twists of the root links of all models in the world frame."""
    message = ModelStates()
    for name, model in simulation.world.main_models.items():
        pose, twist = model.link_state(model.description.root)
        message.name.append(name)
        message.pose.append(to_pose(pose))
        message.twist.append(to_twist(twist))
    return message


def make_link_states(simulation: Simulation) -> LinkStates:
    """Return poses and twists of all links in the world frame, named model::link."""
    message = LinkStates()
    for model in simulation.world.models.values():
        for link, (pose, twist) in model.link_states().items():
            message.name.append(model.get_scoped_name(link))
            message.pose.append(to_pose(pose))
            message.twist.append(to_twist(twist))
    return message


def subscribe_states(namespace: str, thread: SimulationThread) -> None:
    """Subscribe to set_model_state and set_link_state below `namespace`."""

    def move(message: ModelState | LinkState, topic: str) -> None:
        apply = move_model if isinstance(message, ModelState) else move_link
        # Wait until the message has been applied, so that messages keep their order.
        try:
            thread.call(lambda: apply(thread.simulation, message))
        except SimError as error:
            rospy.logerr_throttle(1.0, f"{topic}: {error}")

    for name, kind in (("set_model_state", ModelState), ("set_link_state", LinkState)):
        topic = f"{namespace}/{name}"
        rospy.Subscriber(topic, kind, partial(move, topic=topic), queue_size=10)
