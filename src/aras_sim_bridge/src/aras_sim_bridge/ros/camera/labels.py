"""Which number of a segmentation image is which link."""

from __future__ import annotations

import rospy
import yaml
from std_msgs.msg import String

from aras_sim_bridge.ros.runtime.publisher import Peers, connections
from aras_sim_bridge.simulation import Simulation


class LabelTopic:
    """A latched YAML text `number: model::link`, sent anew when models come or go."""

    def __init__(self, topic: str, peers: Peers) -> None:
        """Advertise; `peers` hears of subscribers."""
        self._publisher = rospy.Publisher(
            topic, String, latch=True, queue_size=2, subscriber_listener=peers
        )
        self._known: tuple[tuple[str, int], ...] | None = None

    @property
    def listeners(self) -> int:
        """Number of listeners."""
        return len(connections(self._publisher))

    def update(self, simulation: Simulation) -> None:
        """Look at the models; runs in the simulation's thread."""
        models = simulation.world.models
        known = tuple((name, model.body_id) for name, model in models.items())
        if known == self._known:
            return
        self._known = known
        labels = {
            model.body_id + ((index + 1) << 24): f"{name}::{link}"
            for name, model in models.items()
            for link, index in model.link_indices.items()
        }
        self._publisher.publish(yaml.safe_dump(labels, sort_keys=True))

    def unregister(self) -> None:
        """Take the topic off the graph."""
        self._publisher.unregister()
