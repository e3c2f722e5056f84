"""Flow control of the messages to one viewer, which is an open page.

A viewer acknowledges each message. If MAX_UNACKNOWLEDGED messages are not acknowledged, further
updates are merged into one pending update, and only the newest image is stored. A slow browser
therefore shows the current state. No update is lost, because an update contains only changes.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

from .plot_samples import CLEAR

# largest number of messages to a viewer that the viewer has not acknowledged
MAX_UNACKNOWLEDGED = 3
ACKNOWLEDGED = "ack"  # text that a viewer sends to acknowledge an update or an image


def merge_updates(older: dict[str, Any], newer: dict[str, Any]) -> dict[str, Any]:
    """Return one update that has the same effect as an older update followed by a newer one."""
    both = {**older, **newer}
    if "shapes" in older and "shapes" in newer:
        both["shapes"] = {**older["shapes"], **newer["shapes"]}
    if "samples" in older and "samples" in newer:
        rows = older["samples"] + newer["samples"]
        clears = [i for i, row in enumerate(rows) if row == CLEAR]
        both["samples"] = rows[clears[-1] :] if clears else rows
    # a full message remains a full message after it is merged with an update
    both["kind"] = older["kind"]
    return both


def to_json(message: dict[str, Any]) -> str:
    """Return a message as compact JSON."""
    return json.dumps(message, separators=(",", ":"))


class Outbox:
    """Sends updates and images to one viewer.

    While MAX_UNACKNOWLEDGED messages are not acknowledged, updates and images wait here.
    """

    def __init__(self, send: Callable[[str | bytes], None]) -> None:
        self._send = send
        self._unacknowledged = 0
        self._update: dict[str, Any] | None = None
        self._image: bytes | None = None

    def send_update(self, message: dict[str, Any], text: str = "") -> None:
        """Send an update now, or merge it into the pending update.

        Args:
            message: the update.
            text: the update as JSON; '' to encode it here.
        """
        if self._unacknowledged >= MAX_UNACKNOWLEDGED:
            self._update = message if self._update is None else merge_updates(self._update, message)
            return
        self._send_now(text or to_json(message))

    def send_image(self, image: bytes) -> None:
        """Send an image now, or store it instead of the pending image."""
        if self._unacknowledged >= MAX_UNACKNOWLEDGED:
            self._image = image
            return
        self._send_now(image)

    def acknowledge(self) -> None:
        """Handle an acknowledgement of the viewer: send the pending update and the pending image.
        """
        self._unacknowledged = max(0, self._unacknowledged - 1)
        if self._update is not None:
            update, self._update = self._update, None
            self._send_now(to_json(update))
        if self._image is not None and self._unacknowledged < MAX_UNACKNOWLEDGED:
            image, self._image = self._image, None
            self._send_now(image)

    def _send_now(self, message: str | bytes) -> None:
        self._unacknowledged += 1
        self._send(message)
