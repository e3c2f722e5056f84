"""Numba for what the loop does with each image: matrices of a few rows, for which NumPy's calls and
LAPACK's cost more than their work, above all where the simulator has had the caches in between.

Signatures are explicit, so everything is compiled when its module is imported and nothing in the
middle of a run. What was compiled is kept in __pycache__ beside the source, or where
NUMBA_CACHE_DIR says, until the source changes. Numba watches each file alone: compiled functions
call none of other modules.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import cache

import numba
from numba import types

_log = logging.getLogger(__name__)

# Arguments: float64 arrays in any order of memory, also read-only ones; grey levels; masks.
VECTOR = types.Array(types.float64, 1, "A", readonly=True)
MATRIX = types.Array(types.float64, 2, "A", readonly=True)
PIXELS = types.Array(types.uint8, 2, "A", readonly=True)
MASK = types.Array(types.boolean, 1, "A", readonly=True)
NUMBER, INTEGER, FLAG = types.float64, types.int64, types.boolean


def compiled(*arguments: types.Type) -> Callable[[Callable], Callable]:
    """Decorator for a function of these argument types, e.g. VECTOR, NUMBER."""
    options = {"nogil": True, "error_model": "numpy"}

    def compile_function(function: Callable) -> Callable:
        try:
            return numba.njit(arguments, cache=True, **options)(function)
        except RuntimeError as error:  # neither its folder nor the user's cache can be written
            if "cannot cache" not in str(error):
                raise
            _tell_once()
            return numba.njit(arguments, **options)(function)

    return compile_function


@cache
def _tell_once() -> None:
    _log.warning("the controller's compiled functions cannot be kept, so every start takes some "
                 "ten seconds longer; set NUMBA_CACHE_DIR to a folder that can be written")
