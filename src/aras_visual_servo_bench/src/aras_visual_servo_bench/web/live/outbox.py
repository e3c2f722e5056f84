"""What one viewer is still to be told: the next when it has seen the last, in between one of all.

A browser that draws slowly would else show what was long ago, and what is told once would be lost
to it as soon as something had to be left out.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

from .page import KEPT

AHEAD = 3  # messages that are sent before the first of them has been seen
SEEN = "seen"  # what a viewer says of each news and each picture


def merged(older: dict[str, Any], newer: dict[str, Any]) -> dict[str, Any]:
    """One news that tells what the two tell one after the other."""
    both = {**older, **newer}
    if "shapes" in older and "shapes" in newer:
        both["shapes"] = {**older["shapes"], **newer["shapes"]}
    if "samples" in older and "samples" in newer:
        rows = older["samples"] + newer["samples"]
        clears = [i for i, row in enumerate(rows) if row[0] == "clear"]
        both["samples"] = rows[clears[-1]:] if clears else rows
        if len(both["samples"]) > KEPT:
            both["samples"] = [["clear"], *both["samples"][-KEPT:]]
    both["kind"] = older["kind"]  # everything, and then some news, is everything
    return both


def text_of(message: dict[str, Any]) -> str:
    """As it is sent."""
    return json.dumps(message, separators=(",", ":"))


class Outbox:
    """News and pictures on their way to one viewer."""

    def __init__(self, send: Callable[[str | bytes], None]) -> None:
        self._send = send
        self._unseen = 0
        self._news: dict[str, Any] | None = None
        self._picture: bytes | None = None

    def news(self, message: dict[str, Any], text: str = "") -> None:
        """Tell it, now or with what follows; `text` is the same, where it is there already."""
        if self._unseen >= AHEAD:
            self._news = message if self._news is None else merged(self._news, message)
            return
        self._pass(text or text_of(message))

    def picture(self, picture: bytes) -> None:
        """Show it, now or, if no newer one comes before, later."""
        if self._unseen >= AHEAD:
            self._picture = picture
            return
        self._pass(picture)

    def seen(self) -> None:
        """The viewer has seen one of those that were sent."""
        self._unseen = max(0, self._unseen - 1)
        if self._news is not None:
            news, self._news = self._news, None
            self._pass(text_of(news))
        if self._picture is not None and self._unseen < AHEAD:
            picture, self._picture = self._picture, None
            self._pass(picture)

    def _pass(self, message: str | bytes) -> None:
        self._unseen += 1
        self._send(message)
