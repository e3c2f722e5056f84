"""Conversion of depth images."""

from __future__ import annotations

import numpy as np
from sensor_msgs.msg import Image

from aras_visual_servo_camera.errors import ImageError


def read_depth(message: Image) -> np.ndarray:
    """Convert a 32FC1 or 16UC1 (mm) image to depth (rows, columns), m.

    Raises:
        ImageError: the encoding is not supported, or there are too few data for the size of the
            image.
    """
    kinds = {"32FC1": (np.float32, 1.0), "16UC1": (np.uint16, 1e-3)}
    if message.encoding not in kinds:
        raise ImageError(
            f"the depth image has the encoding '{message.encoding}'; use one of {', '.join(kinds)}"
        )
    kind, unit = kinds[message.encoding]
    kind = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    width = message.width * kind.itemsize
    if message.step < width or len(message.data) < message.step * message.height:
        raise ImageError(
            f"the depth image of {message.width} x {message.height} pixels is too short: it has "
            f"{len(message.data)} bytes in rows of {message.step}"
        )
    rows = np.frombuffer(message.data, np.uint8)[: message.step * message.height]
    rows = np.ascontiguousarray(rows.reshape(message.height, message.step)[:, :width])
    return rows.view(kind).astype(np.float32) * np.float32(unit)
