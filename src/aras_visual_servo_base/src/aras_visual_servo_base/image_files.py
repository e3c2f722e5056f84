"""Functions that read an image file, or only the size of the image without decoding it."""

import warnings
from pathlib import Path

import numpy as np

from aras_visual_servo_base.errors import DescriptionError

LARGEST_IMAGE = 64_000_000  # largest accepted number of pixels of an image


def read_image_size(path: str | Path) -> tuple[int, int] | None:
    """Return width and height (px) from the header of a file; None if it is not an image.

    Raises:
        DescriptionError: the image has more than LARGEST_IMAGE pixels.
    """
    from PIL import Image  # imported here because few programs read images

    too_large = DescriptionError(f"{path} has more than {LARGEST_IMAGE} pixels: make it smaller")
    try:
        with warnings.catch_warnings(action="error"), Image.open(path) as picture:
            size = picture.size
    except (Image.DecompressionBombError, Image.DecompressionBombWarning):
        raise too_large from None
    except (OSError, ValueError, SyntaxError, Warning):
        return None
    if size[0] * size[1] > LARGEST_IMAGE:
        raise too_large
    return size


def read_on_white(path: str | Path, colour: bool = False) -> np.ndarray | None:
    """Read an image, and replace transparency by a white background.

    Returns:
        Grey levels (rows, columns), uint8; if `colour`, BGR levels (rows, columns, 3), uint8. None
        if the file cannot be read.
    """
    import cv2

    image = _read(path, cv2.IMREAD_COLOR if colour else cv2.IMREAD_GRAYSCALE)
    plain = _read(path, cv2.IMREAD_UNCHANGED)
    if image is None or not _has_alpha(plain):
        return image
    opacity = plain[..., 3].astype(np.float32) / np.iinfo(plain.dtype).max
    opacity = opacity[..., None] if colour else opacity
    return np.round(255.0 + opacity * (image - np.float32(255.0))).astype(np.uint8)


def _has_alpha(image: np.ndarray | None) -> bool:
    return image is not None and image.ndim == 3 and image.shape[2] == 4


def _read(path: str | Path, flags: int) -> np.ndarray | None:
    """Read an image with OpenCV; suppress OpenCV's log message for files that are not images."""
    import cv2

    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        return cv2.imread(str(path), flags)
    finally:
        cv2.utils.logging.setLogLevel(level)
