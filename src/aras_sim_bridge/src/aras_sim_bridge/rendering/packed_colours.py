"""Packed colours of pixels, uint32.

The bytes of a packed colour, from the lowest to the highest, are red, green, blue and 255.
"""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.compiled import jit


@jit("f8, f8, f8")
def pack_colour(red, green, blue):
    """Pack a colour with components from 0 to 255 into a uint32."""
    r = np.uint32(np.rint(min(max(red, 0.0), 255.0)))
    g = np.uint32(np.rint(min(max(green, 0.0), 255.0)))
    b = np.uint32(np.rint(min(max(blue, 0.0), 255.0)))
    return np.uint32(r | (g << np.uint32(8)) | (b << np.uint32(16)) | np.uint32(0xFF000000))
