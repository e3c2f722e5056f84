"""Which number of a segmentation image is which link."""

from __future__ import annotations

from typing import Any

import rospy
import yaml
from std_msgs.msg import String

from aras_sim_bridge.ros.camera.quick_publisher import listeners


class LabelTopic:
    """A latched YAML text `number: model::link`, sent anew when models come or go."""

    def __init__(self, topic: str, listener: rospy.SubscribeListener) -> None:
        """Advertise; `listener` hears subscribers."""
        self._publisher = rospy.Publisher(
            topic, String, latch=True, queue_size=2, subscriber_listener=listener
        )
        self._known: tuple[tuple[str, int], ...] | None = None

    @property
    def wanted(self) -> bool:
        """Whether somebody subscribes."""
        return listeners(self._publisher) > 0

    def update(self, simulation: Any) -> None:
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

    def shutdown(self) -> None:
        """Take the topic off the graph."""
        self._publisher.unregister()
