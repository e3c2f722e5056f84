"""Messages of a page: JSON objects that name a request."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from aras_visual_servo_base.names import suggest
from aras_visual_servo_base.setting_values import format_value

from ..errors import RefusedError

MAX_BYTES = 4096  # bytes of a request


def read_message(
    text: str | bytes, requests: Mapping[str, type], max_bytes: int = MAX_BYTES
) -> tuple[str, dict[str, Any]]:
    """What a page's message, a JSON object {"do": NAME, ...}, asks for, and the fields given.

    Args:
        known: requests by name. most: characters.

    Raises:
        RefusedError: it is none, or too long, or there is no such request.
    """
    if not isinstance(text, str) or len(text) > max_bytes:
        raise RefusedError(f"a request is a text of at most {max_bytes} characters")
    try:
        data = json.loads(text)
    except (ValueError, RecursionError):
        raise RefusedError("a request is a JSON object") from None
    if not isinstance(data, dict) or not isinstance(data.get("do"), str):
        raise RefusedError("a request is a JSON object with a key 'do'")
    do = data.pop("do")
    if do not in requests:
        raise RefusedError(f"there is no request {format_value(do)}: {suggest(do, requests)}")
    return do, data
