"""Bit operations for compiled functions; importing this module imports Numba."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from .compiled import import_numba

if TYPE_CHECKING:
    import numba
else:
    numba = import_numba()


@numba.extending.intrinsic
def lowest_bit(typing: object, bits: numba.types.Type) -> tuple[object, Callable]:
    """Return the index of the lowest set bit of a 64-bit integer, which must not be 0.

    This can only be called from compiled code.
    """

    def build(context: object, builder: object, signature: object, arguments: list) -> object:
        never_zero = context.get_constant(numba.types.boolean, True)
        return builder.cttz(arguments[0], never_zero)

    return numba.types.int64(bits), build
