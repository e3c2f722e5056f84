"""Pixel formats: Gazebo's names, ROS's encodings, and the conversion of images."""

from __future__ import annotations

import cv2
import numpy as np

from aras_visual_servo_base.names import find_nearest

from ..errors import CameraError

ENCODINGS = ("mono8", "mono16", "rgb8", "bgr8", "rgb16", "bayer_rggb8", "bayer_bggr8",
             "bayer_gbrg8", "bayer_grbg8")
_GAZEBO = {
    "L8": "mono8", "L_INT8": "mono8", "L16": "mono16", "L_INT16": "mono16",
    "R8G8B8": "rgb8", "RGB_INT8": "rgb8", "B8G8R8": "bgr8", "BGR_INT8": "bgr8",
    "R16G16B16": "rgb16", "RGB_INT16": "rgb16",
    "BAYER_RGGB8": "bayer_rggb8", "BAYER_BGGR8": "bayer_bggr8",
    "BAYER_GBRG8": "bayer_gbrg8", "BAYER_GRBG8": "bayer_grbg8",
}


def find_encoding(name: str, camera: str = "") -> str:
    """Return the ROS encoding of a pixel format, given by its name in Gazebo or ROS.

    Raises:
        CameraError: the name is unknown; the message suggests the most similar name.
    """
    if name in ENCODINGS:
        return name
    if name in _GAZEBO:
        return _GAZEBO[name]
    known = [*ENCODINGS, *_GAZEBO]
    near = find_nearest(name, known, 0.0)
    raise CameraError(
        f"camera '{camera}': format '{name}' is not known; the nearest is '{near}'; use one of "
        f"{', '.join(known)}"
    )


def find_shape(encoding: str, height: int, width: int) -> tuple[int, ...]:
    """Return the shape of an image array: (H, W, 3) in colour, (H, W) otherwise."""
    colour = encoding.startswith(("rgb", "bgr"))
    return (height, width, 3) if colour else (height, width)


def read_out(rgb: np.ndarray, encoding: str) -> np.ndarray:
    """Convert an rgb image (H, W, 3) uint8 to the pixels of a sensor with colour filters.

    The result is (H, W, 3) uint8 with colours in the order of the encoding, or (H, W) uint8 for
    Bayer patterns. With a Bayer pattern, each pixel has only the channel that its filter transmits.
    The first two letters of the pattern are the filters of the first two pixels in the first row,
    and the last two letters are the filters of the two pixels below.
    """
    if encoding in ("rgb8", "rgb16"):
        return rgb
    if encoding == "bgr8":
        return cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR)
    pattern = encoding[len("bayer_"):-1]
    out = np.empty(rgb.shape[:2], np.uint8)
    for n, letter in enumerate(pattern):
        row, column = divmod(n, 2)
        out[row::2, column::2] = rgb[row::2, column::2, "rgb".index(letter)]
    return out


def widen(image: np.ndarray, encoding: str) -> np.ndarray:
    """Convert a uint8 image to the bit depth of the encoding. In 16 bits, 255 becomes 65535."""
    return image.astype(np.uint16) * 257 if encoding.endswith("16") else image
