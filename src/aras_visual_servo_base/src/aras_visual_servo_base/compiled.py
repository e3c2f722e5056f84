"""Numba for small loops and matrices of a few rows, where NumPy's calls cost more than their work.

Signatures are explicit, so set-up compiles everything. What was compiled is kept in __pycache__
beside the source, or where NUMBA_CACHE_DIR says, until the source changes, or that of a compiled
function of another module that it calls, or a number that it takes from one: Numba itself watches
each file alone. What is kept is read when the function is first called, for no program calls more
than half of them; what is not kept is compiled when its module is imported. So nothing is compiled
in the middle of a run.
"""

from __future__ import annotations

import contextlib
import importlib
import logging
import sys
import threading
import zlib
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import numba
from numba.core.cgutils import true_bit
from numba.core.dispatcher import Dispatcher
from numba.core.sigutils import normalize_signature
from numba.extending import intrinsic


def _import_without(left_out: str, module: str) -> None:
    """Import a module that then takes `left_out`, if nothing has imported it yet, for missing."""
    if left_out in sys.modules:
        importlib.import_module(module)
        return
    sys.modules[left_out] = None  # what Python takes for a module that cannot be imported
    try:
        importlib.import_module(module)
    finally:
        del sys.modules[left_out]


# Here Numba looks for a BLAS to use in np.convolve and np.correlate, and so imports SciPy's linear
# algebra: a tenth of what a node's start takes. Its np.dot looks for one when it is compiled.
_import_without("scipy.linalg.cython_blas", "numba.np.arraymath")

_log = logging.getLogger(__name__)
_one_at_a_time = threading.RLock()
_prepared: list[tuple[str, Callable[[], None]]] = []  # a function's module, and what compiles it
_put_off: list[bool] = []  # an entry for each `put_off` that is under way


def compiled(signature: str, allocates: bool = True) -> Callable[[Callable], Callable]:
    """Decorator for a function of these argument types, in Numba's words: 'f8[:,::1], i8'.

    Loops are compiled in less time than arithmetic of arrays. Where an array is assigned to a slice
    Numba compiles the text of an error too, for a quarter of a second each; loops in its place
    check no shapes: whoever calls them sees to those.

    Arrays in C order ('f8[:,::1]') may be written to. Those in any order ('f8[:,:]') are only read,
    so read-only ones and views are taken too.

    allocates: whether it makes arrays. One that does not, and calls none that does, is compiled
    without counting references to the rows that it looks at: half of a control cycle's time.
    """
    given, _ = normalize_signature(f"({signature},)")
    arguments = tuple(
        kind.copy(readonly=True) if getattr(kind, "layout", "") == "A" else kind for kind in given
    )

    def compile_function(function: Callable) -> Callable:
        # No other language calls it, so a C function of the same kind is not compiled.
        made = numba.njit(
            nogil=True, error_model="numpy", _nrt=allocates, no_cfunc_wrapper=True
        )(function)  # fmt: skip
        try:
            made.enable_caching()
            kept = made._cache._cache_file  # Numba knows of no other way to ask
            kept._source_stamp = (kept._source_stamp, *_made_of(function))
            due = not kept._load_index()
        except RuntimeError as error:  # neither its folder nor the user's cache can be written
            if "cannot cache" not in str(error):
                raise
            _tell_once()
            due = True
        ready = _compile_when_used(made, arguments)
        if due and not _put_off:
            ready()
        return made

    return compile_function


def _compile_when_used(made: Dispatcher, arguments: tuple) -> Callable[[], None]:
    """Compile it for these arguments, or read what was kept, when it is first called from Python or
    from a function that is compiled; from then on it takes no others. Returns what does that now.
    """
    types_of = made.get_call_template

    def ready() -> None:
        with _one_at_a_time:
            if made._can_compile:
                made.compile(arguments)
                made.disable_compile()

    def before_a_call(*_given: object, **_named: object) -> Dispatcher:
        ready()
        return made  # Numba calls what it gets from here

    def before_a_caller(given: tuple, named: dict) -> tuple:
        ready()
        return types_of(given, named)

    made._compile_for_args, made.get_call_template = before_a_call, before_a_caller
    _prepared.append((made.__module__, ready))
    return ready


@contextlib.contextmanager
def put_off() -> Iterator[None]:
    """While modules are imported whose functions are not to be compiled before `compile_all`."""
    _put_off.append(True)
    try:
        yield
    finally:
        _put_off.pop()


def compile_all(package: str = "") -> None:
    """All compiled functions of the modules that were imported, or of those of a package, now: for
    nodes, whose first image must not wait for them."""
    for module, ready in _prepared:
        if package in ("", module.partition(".")[0]):
            ready()


def _made_of(function: Callable) -> list[tuple]:
    """What goes into compiled code beside its own source: the sources of the compiled functions
    that it calls, and the values of its globals."""
    called, found = [function], set()
    for one in called:
        for name in one.__code__.co_names:
            value = one.__globals__.get(name)
            source = getattr(value, "py_func", None) or getattr(value, "_defn", None)
            if source is not None and source not in called:
                called.append(source)
            elif isinstance(value, (bool, int, float, tuple)):
                found.add((name, repr(value)))
    for path in {one.__code__.co_filename for one in called[1:]}:
        stat = Path(path).stat()
        found.add((Path(path).name, _checksum(path, stat.st_mtime_ns, stat.st_size)))
    return sorted(found)


@cache
def _checksum(path: str, _time: int, _size: int) -> str:
    """Of a file as it is now: copies of the same text are the same."""
    return str(zlib.crc32(Path(path).read_bytes()))


def inlined(function: Callable) -> Callable:
    """Decorator for a small function that becomes part of the compiled ones that call it: a call
    with three arrays costs more than a triangle's test."""
    return numba.njit(forceinline=True, nogil=True, error_model="numpy", _nrt=False,
                      no_cfunc_wrapper=True)(function)  # fmt: skip


def inlined_by_numba(function: Callable) -> Callable:
    """Decorator for a small function whose body Numba copies into each caller before LLVM sees it.

    Use it for loops over rows of arrays: LLVM vectorizes them only where it can tell that the rows
    do not overlap, and it loses that when it inlines the function itself, as for `inlined`.
    """
    return numba.njit(inline="always", nogil=True, error_model="numpy", _nrt=False,
                      no_cfunc_wrapper=True)(function)  # fmt: skip


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
