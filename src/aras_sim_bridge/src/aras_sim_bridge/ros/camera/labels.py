"""Publisher of the names of the links that the numbers in segmentation images stand for."""

from __future__ import annotations

from collections.abc import Callable

import yaml
from std_msgs.msg import String

from aras_sim_bridge.ros.runtime.publisher import NonBlockingPublisher
from aras_sim_bridge.simulation import Simulation
from aras_sim_bridge.world.labels import list_links_by_label


class LabelTopic(NonBlockingPublisher):
    """Latched topic that maps the numbers in segmentation images to names `model::link`.

    The message is a YAML text.
    """

    def __init__(self, topic: str, on_change: Callable[[], None]) -> None:
        """Advertise the topic.

        Any thread may call `on_change` when subscribers connect or leave.
        """
        super().__init__(topic, String, queue_size=2, latch=True, on_change=on_change)
        self._labels: tuple[tuple[str, int], ...] | None = None

    def update(self, simulation: Simulation) -> None:
        """Publish the map if the models have changed; call this in the simulation thread."""
        models = simulation.world.models
        labels = tuple((name, model.body_id) for name, model in models.items())
        if labels == self._labels:
            return
        self._labels = labels
        self.publish(String(yaml.safe_dump(list_links_by_label(models))))
