"""Messages of a run from a ROS graph or a bag; a MessageRunBuilder builds a Run from them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np


class GraphRecording:
    """Messages of one run, in the order of arrival.

    Attributes:
        path: path of the bag, for error messages.
        states: state messages of the loop.
        joints: joint state messages.
        reports: messages with a report of the loop, by stamp (ns).
        moments: measured moments, by stamp (ns).
        info: last CameraInfo message; None if there was none.
        real_time_factors: pairs of stamp (s) and real-time factor.
        stamps: for each image, stamp of the exposure (s), time of arrival (s), and position of the
            message in the bag.
        poses: pairs of stamp (s) and base_T_optical (4, 4), from tf.
        experiment_text: description of the experiment, as JSON text.
        notes: texts that describe problems of the recording, for the report.
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
        """Add a report of the controller."""
        self.reports[message.header.stamp.to_nsec()] = message

    def add_moments(self, message: Any) -> None:
        """Add a measurement of the camera node, if it is valid."""
        if message.valid:
            self.moments[message.header.stamp.to_nsec()] = message

    def read_images(self, stamps: Iterable[float]) -> Iterator[tuple[float, np.ndarray]]:
        """Read the rgb images nearest to these stamps (s); this base class has no images."""
        yield from ()
