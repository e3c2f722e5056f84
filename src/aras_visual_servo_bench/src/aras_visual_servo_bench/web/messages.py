"""Messages of the web pages to their servers: JSON objects with a request's name and fields."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from aras_visual_servo_base.names import suggest
from aras_visual_servo_base.setting_values import format_value

from ..errors import RefusedError

MAX_BYTES = 4096  # default limit for a message


def read_message(
    text: str | bytes, requests: Mapping[str, type], max_bytes: int = MAX_BYTES
) -> tuple[str, dict[str, Any]]:
    """Read the request's name and the fields of a message {"do": NAME, ...}.

    Args:
        requests: the known requests by name.
        max_bytes: limit for the length of the message, in characters.

    Raises:
        RefusedError: the message is too long, no such JSON object, or names an unknown request.
    """
    if not isinstance(text, str) or len(text) > max_bytes:
        raise RefusedError(f"a request must be a text of at most {max_bytes} characters")
    try:
        data = json.loads(text)
    except (ValueError, RecursionError):
        raise RefusedError("a request must be a JSON object") from None
    if not isinstance(data, dict) or not isinstance(data.get("do"), str):
        raise RefusedError("a request must be a JSON object with a key 'do'")
    do = data.pop("do")
    if do not in requests:
        raise RefusedError(f"there is no request {format_value(do)}: {suggest(do, requests)}")
    return do, data
