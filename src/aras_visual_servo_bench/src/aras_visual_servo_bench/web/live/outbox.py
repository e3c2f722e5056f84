"""What one viewer is still to be told: the next when it has seen the last, in between one of all.

A browser that draws slowly would else show what was long ago, and what is told once would be lost
to it as soon as something had to be left out.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

from .page import MAX_SAMPLES

MAX_UNACKNOWLEDGED = 3  # messages that are sent before the first of them has been seen
ACKNOWLEDGED = "seen"  # what a viewer says of each news and each picture


def merge_updates(older: dict[str, Any], newer: dict[str, Any]) -> dict[str, Any]:
    """One news that tells what the two tell one after the other."""
    both = {**older, **newer}
    if "shapes" in older and "shapes" in newer:
        both["shapes"] = {**older["shapes"], **newer["shapes"]}
    if "samples" in older and "samples" in newer:
        rows = older["samples"] + newer["samples"]
        clears = [i for i, row in enumerate(rows) if row[0] == "clear"]
        both["samples"] = rows[clears[-1]:] if clears else rows
        if len(both["samples"]) > MAX_SAMPLES:
            both["samples"] = [["clear"], *both["samples"][-MAX_SAMPLES:]]
    both["kind"] = older["kind"]  # everything, and then some news, is everything
    return both


def to_json(message: dict[str, Any]) -> str:
    """As it is sent."""
    return json.dumps(message, separators=(",", ":"))


class Outbox:
    """News and pictures on their way to one viewer."""

    def __init__(self, send: Callable[[str | bytes], None]) -> None:
        self._send = send
        self._unacknowledged = 0
        self._update: dict[str, Any] | None = None
        self._image: bytes | None = None

    def send_update(self, message: dict[str, Any], text: str = "") -> None:
        """Tell it, now or with what follows; `text` is the same, where it is there already."""
        if self._unacknowledged >= MAX_UNACKNOWLEDGED:
            self._update = message if self._update is None else merge_updates(self._update, message)
            return
        self._send_now(text or to_json(message))

    def send_image(self, image: bytes) -> None:
        """Show it, now or, if no newer one comes before, later."""
        if self._unacknowledged >= MAX_UNACKNOWLEDGED:
            self._image = image
            return
        self._send_now(image)

    def acknowledge(self) -> None:
        """The viewer has seen one of those that were sent."""
        self._unacknowledged = max(0, self._unacknowledged - 1)
        if self._update is not None:
            news, self._update = self._update, None
            self._send_now(to_json(news))
        if self._image is not None and self._unacknowledged < MAX_UNACKNOWLEDGED:
            picture, self._image = self._image, None
            self._send_now(picture)

    def _send_now(self, message: str | bytes) -> None:
        self._unacknowledged += 1
        self._send(message)
