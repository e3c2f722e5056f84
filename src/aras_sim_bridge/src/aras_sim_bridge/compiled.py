"""Numba for loops over triangles, links and joints, where NumPy would make hundreds of small calls.

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

_log = logging.getLogger(__name__)


def compiled(signature: str) -> Callable[[Callable], Callable]:
    """Decorator for a function of these argument types, e.g. 'f8[:,::1], i8'."""
    types, options = f"({signature},)", {"nogil": True, "error_model": "numpy"}

    def compile_function(function: Callable) -> Callable:
        try:
            return numba.njit(types, cache=True, **options)(function)
        except RuntimeError as error:  # neither its folder nor the user's cache can be written
            if "cannot cache" not in str(error):
                raise
            _tell_once()
            return numba.njit(types, **options)(function)

    return compile_function


def inlined(function: Callable) -> Callable:
    """Decorator for a small function that becomes part of the compiled ones that call it: a call
    with three arrays costs more than a triangle's test."""
    return numba.njit(inline="always", nogil=True, error_model="numpy")(function)


@cache
def _tell_once() -> None:
    _log.warning("compiled loops cannot be kept, so every start takes some ten "
                 "seconds longer; set NUMBA_CACHE_DIR to a folder that can be written")
