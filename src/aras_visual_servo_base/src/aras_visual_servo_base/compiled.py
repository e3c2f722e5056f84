"""Numba for small loops and matrices of a few rows, where NumPy's calls cost more than their work.

Signatures are explicit, so everything is compiled when its module is imported and nothing in the
middle of a run. What was compiled is kept in __pycache__ beside the source, or where
NUMBA_CACHE_DIR says, until the source changes. Numba watches each file alone: a compiled function
that calls some of other modules names them.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

import numba
from numba.core.cgutils import true_bit
from numba.core.sigutils import normalize_signature
from numba.extending import intrinsic

_log = logging.getLogger(__name__)


def compiled(
    signature: str, calls: Sequence[Callable] = (), allocates: bool = True
) -> Callable[[Callable], Callable]:
    """Decorator for a function of these argument types, in Numba's words: 'f8[:,::1], i8'.

    Arrays in C order ('f8[:,::1]') may be written to. Those in any order ('f8[:,:]') are only read,
    so read-only ones and views are taken too.

    calls: compiled functions of other modules that it calls; it is compiled anew when their
    sources change too.
    allocates: whether it makes arrays. One that does not, and calls none that does, is compiled
    without counting references to the rows that it looks at: half of a control cycle's time.
    """
    given, _ = normalize_signature(f"({signature},)")
    arguments = tuple(
        kind.copy(readonly=True) if getattr(kind, "layout", "") == "A" else kind for kind in given
    )

    def compile_function(function: Callable) -> Callable:
        made = numba.njit(nogil=True, error_model="numpy", _nrt=allocates)(function)
        try:
            made.enable_caching()
            if calls:
                _watch(made, calls)
        except RuntimeError as error:  # neither its folder nor the user's cache can be written
            if "cannot cache" not in str(error):
                raise
            _tell_once()
        made.compile(arguments)
        made.disable_compile()
        return made

    return compile_function


def _watch(made: Callable, calls: Sequence[Callable]) -> None:
    """Let what is kept of `made` count only for the sources of `calls` as they are now."""
    kept = made._cache._cache_file  # Numba knows of no other way to say it
    sources = sorted({call.py_func.__code__.co_filename for call in calls})
    stamps = [Path(source).stat() for source in sources]
    kept._source_stamp = (kept._source_stamp, *((s.st_mtime_ns, s.st_size) for s in stamps))


def inlined(function: Callable) -> Callable:
    """Decorator for a small function that becomes part of the compiled ones that call it: a call
    with three arrays costs more than a triangle's test."""
    return numba.njit(inline="always", nogil=True, error_model="numpy")(function)


@intrinsic
def lowest_bit(typing: object, bits: numba.types.Type) -> tuple[object, Callable]:
    """The number of the lowest bit of an integer of 64 bits that is not 0; for compiled functions.
    """

    def build(context: object, builder: object, signature: object, arguments: list) -> object:
        return builder.cttz(arguments[0], true_bit)

    return numba.types.int64(bits), build


@cache
def _tell_once() -> None:
    _log.warning("compiled loops cannot be kept, so every start takes some ten "
                 "seconds longer; set NUMBA_CACHE_DIR to a folder that can be written")


def column(number: int) -> property:
    """A column of an object's `row`, as an attribute."""

    def read(self: object) -> float:
        return self.row.item(number)

    def write(self: object, value: float) -> None:
        self.row[number] = value

    return property(read, write)
