"""Bit operations for compiled functions; importing this module imports Numba."""

from __future__ import annotations

from collections.abc import Callable

import numba
from numba.extending import intrinsic


@intrinsic
def lowest_bit(typing: object, bits: numba.types.Type) -> tuple[object, Callable]:
    """Return the index of the lowest set bit of a 64-bit integer, which must not be 0.

    This can only be called from compiled code.
    """

    def build(context: object, builder: object, signature: object, arguments: list) -> object:
        never_zero = context.get_constant(numba.types.boolean, True)
        return builder.cttz(arguments[0], never_zero)

    return numba.types.int64(bits), build
