"""Pictures from strangers: their size by the header, before they are decoded."""

import warnings
from pathlib import Path

from aras_visual_servo_base.errors import DescriptionError

LARGEST = 64_000_000  # pixels of a picture that is read


def picture_size(path: str | Path) -> tuple[int, int] | None:
    """Width and height (px) as the header says; None where the file is no picture.

    Raises:
        DescriptionError: it has more than LARGEST pixels.
    """
    from PIL import Image  # only who has a picture waits for it

    too_large = DescriptionError(f"{path} has more than {LARGEST} pixels: make it smaller")
    try:
        with warnings.catch_warnings(action="error"), Image.open(path) as picture:
            size = picture.size
    except (Image.DecompressionBombError, Image.DecompressionBombWarning):
        raise too_large from None
    except (OSError, ValueError, SyntaxError, Warning):
        return None
    if size[0] * size[1] > LARGEST:
        raise too_large
    return size
