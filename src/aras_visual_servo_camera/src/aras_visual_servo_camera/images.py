"""Decoding of image messages to grey and RGB arrays, with numpy and OpenCV only."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from .errors import ImageError

# Images of a servo loop are too small for several threads. At 320 x 240 pixels, OpenCV's waiting
# threads take twice as much processor time as segmentation and moments together.
cv2.setNumThreads(1)

# For each encoding: bytes per channel, number of channels, OpenCV's code of the conversion to grey,
# OpenCV's code of the conversion to RGB. None means that no conversion is needed.
_ENCODINGS: dict[str, tuple[int, int, int | None, int | None]] = {
    "mono8": (1, 1, None, cv2.COLOR_GRAY2RGB),
    "mono16": (2, 1, None, cv2.COLOR_GRAY2RGB),
    "rgb8": (1, 3, cv2.COLOR_RGB2GRAY, None),
    "rgb16": (2, 3, cv2.COLOR_RGB2GRAY, None),
    "bgr8": (1, 3, cv2.COLOR_BGR2GRAY, cv2.COLOR_BGR2RGB),
    "rgba8": (1, 4, cv2.COLOR_RGBA2GRAY, cv2.COLOR_RGBA2RGB),
    "bgra8": (1, 4, cv2.COLOR_BGRA2GRAY, cv2.COLOR_BGRA2RGB),
    # OpenCV names a Bayer pattern after the second and third pixels of the second row, ROS after
    # the first two pixels of the first row.
    "bayer_rggb8": (1, 1, cv2.COLOR_BayerBG2GRAY, cv2.COLOR_BayerBG2RGB),
    "bayer_bggr8": (1, 1, cv2.COLOR_BayerRG2GRAY, cv2.COLOR_BayerRG2RGB),
    "bayer_gbrg8": (1, 1, cv2.COLOR_BayerGR2GRAY, cv2.COLOR_BayerGR2RGB),
    "bayer_grbg8": (1, 1, cv2.COLOR_BayerGB2GRAY, cv2.COLOR_BayerGB2RGB),
}
ENCODINGS = tuple(_ENCODINGS)


@dataclass(eq=False)
class Image:
    """One image; its grey and RGB arrays are computed at first use.

    Attributes:
        pixels: (rows, columns) or (rows, columns, channels) uint8. The channels are those of the
            encoding; 16-bit channels are reduced to 8 bits.
        encoding: encoding of the message, one of ENCODINGS.
        target_mask: (rows, columns) 255 where a label image shows the target, 0 elsewhere; None if
            there is no label image.
    """

    pixels: NDArray[np.uint8]
    encoding: str
    target_mask: NDArray[np.uint8] | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Size (rows, columns)."""
        return self.pixels.shape[:2]

    @cached_property
    def grey(self) -> NDArray[np.uint8]:
        """Grey levels (rows, columns)."""
        code = _ENCODINGS[self.encoding][2]
        return self.pixels if code is None else cv2.cvtColor(self.pixels, code)

    @cached_property
    def rgb(self) -> NDArray[np.uint8]:
        """Red, green and blue levels (rows, columns, 3)."""
        code = _ENCODINGS[self.encoding][3]
        return self.pixels if code is None else cv2.cvtColor(self.pixels, code)

    @property
    def has_colour(self) -> bool:
        """True if the encoding has colours, False if it is mono8 or mono16."""
        return not self.encoding.startswith("mono")


def decode(message: Any) -> Image:
    """Decode a sensor_msgs/Image or any object with its attributes.

    Raises:
        ImageError: the encoding is unknown, the image is empty, the step is shorter than a row, or
            the data are too short.
    """
    encoding = str(message.encoding)
    if encoding not in _ENCODINGS:
        raise ImageError(
            f"encoding '{encoding}' is not supported; send one of {', '.join(ENCODINGS)}"
        )
    depth, channels = _ENCODINGS[encoding][:2]
    rows, columns, step = int(message.height), int(message.width), int(message.step)
    line = columns * channels * depth
    if rows < 1 or columns < 1:
        raise ImageError(
            f"the image is empty: its size is {columns} x {rows} pixels, must be at least 1 x 1"
        )
    if step < line:
        raise ImageError(
            f"the image's step is {step}, must be at least {line}, the number of bytes in a row "
            f"of {columns} {encoding} pixels"
        )
    # In an image message, the padding after the last row may be missing.
    if len(message.data) < step * (rows - 1) + line:
        raise ImageError(
            f"the image's data are truncated: {len(message.data)} bytes, must be "
            f"{step * (rows - 1) + line} for {rows} rows with a step of {step} bytes"
        )
    data = np.frombuffer(message.data, dtype=np.uint8)
    shape = (rows, line) if depth == 2 or channels == 1 else (rows, columns, channels)
    if step == line:
        pixels = data[: rows * line].reshape(shape)
    else:
        pixels = np.lib.stride_tricks.as_strided(
            data, (rows, line), (step, 1), writeable=False
        ).reshape(shape)
    if depth == 2:  # keep only the upper byte of 16-bit channels
        start = 0 if message.is_bigendian else 1
        pixels = np.ascontiguousarray(pixels[:, start::2])
        if channels > 1:
            pixels = pixels.reshape(rows, columns, channels)
    return Image(pixels, encoding)
