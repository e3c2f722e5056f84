"""Which number of a segmentation image is which link."""

from __future__ import annotations

from collections.abc import Callable

import yaml
from std_msgs.msg import String

from aras_sim_bridge.ros.runtime.publisher import NonBlockingPublisher
from aras_sim_bridge.simulation import Simulation
from aras_sim_bridge.world.labels import list_links_by_label


class LabelTopic(NonBlockingPublisher):
    """A latched YAML text `number: model::link`, sent anew when models come or go."""

    def __init__(self, topic: str, on_change: Callable[[], None]) -> None:
        """Advertise; `on_change` is called, from any thread, when listeners came or went."""
        super().__init__(topic, String, queue_size=2, latch=True, on_change=on_change)
        self._labels: tuple[tuple[str, int], ...] | None = None

    def update(self, simulation: Simulation) -> None:
        """Look at the models; runs in the simulation's thread."""
        models = simulation.world.models
        known = tuple((name, model.body_id) for name, model in models.items())
        if known == self._labels:
            return
        self._labels = known
        self.publish(String(yaml.safe_dump(list_links_by_label(models))))
