"""Messages from the web pages to their servers.

A message is a JSON object with the name and the fields of a request.
"""

from __future__ import annotations

import json
from collections.abc import Collection
from typing import Any

from aras_visual_servo_base.names import suggest
from aras_visual_servo_base.setting_values import format_value

from ..errors import RefusedRequestError

MAX_BYTES = 4096  # default limit for the length of a message, characters


def read_message(
    text: str | bytes, requests: Collection[str], max_bytes: int = MAX_BYTES
) -> tuple[str, dict[str, Any]]:
    """Return the name of the request and its fields from a message {"do": NAME, FIELD: VALUE, ...}.

    Args:
        text: the message.
        requests: names of all requests.
        max_bytes: largest length of the message, characters.

    Raises:
        RefusedRequestError: the message is too long, has another form, or its request is unknown.
    """
    if not isinstance(text, str) or len(text) > max_bytes:
        raise RefusedRequestError(f"a request must be a text of at most {max_bytes} characters")
    try:
        data = json.loads(text)
    except (ValueError, RecursionError):
        raise RefusedRequestError("a request must be a JSON object") from None
    if not isinstance(data, dict) or not isinstance(data.get("do"), str):
        raise RefusedRequestError("a request must be a JSON object with its name as the key 'do'")
    do = data.pop("do")
    if do not in requests:
        raise RefusedRequestError(
            f"there is no request {format_value(do)}: {suggest(do, requests)}"
        )
    return do, data
