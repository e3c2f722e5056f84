"""What is heard of a run on a graph or in a bag; from_bag.Messages makes a Run of it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np


class GraphRecording:
    """Messages of one run, as they came.

    Attributes:
        path: where they are from, for messages.
        states, joints: messages. reports, moments: the same by stamp, ns. info: of the camera.
        pace: stamp, s, and real-time factor. stamps: exposure and arrival of each image, s.
        poses: stamp, s, and base_T_optical by tf. described: the experiment's text.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.states: list[Any] = []
        self.reports: dict[int, Any] = {}
        self.moments: dict[int, Any] = {}
        self.joints: list[Any] = []
        self.real_time_factors: list[tuple[float, float]] = []
        self.stamps: list[tuple[float, float, Any]] = []
        self.poses: list[tuple[float, np.ndarray]] = []
        self.info: Any = None
        self.experiment_text = ""
        self.notes: list[str] = []

    def add_report(self, message: Any) -> None:
        """One report of the controller."""
        self.reports[message.header.stamp.to_nsec()] = message

    def add_moments(self, message: Any) -> None:
        """One measurement of the camera node."""
        if message.valid:
            self.moments[message.header.stamp.to_nsec()] = message

    def read_images(self, stamps: Iterable[float]) -> Iterator[tuple[float, np.ndarray]]:
        """The pictures that are next to these exposures, as rgb; none were kept."""
        yield from ()
