"""Numba for small loops and matrices of a few rows, where NumPy's calls cost more than their work.

Signatures are explicit, so set-up compiles everything. What was compiled is kept in __pycache__
beside the source, or where NUMBA_CACHE_DIR says, until the source changes, or that of a compiled
function of another module that it calls, or a number that it takes from one: Numba itself watches
each file alone. A function is read from there when it is first called, for no program calls more
than half of them, and compiled then if it is not there. Nodes call `compile_all` before their first
image.
"""

from __future__ import annotations

import functools
import importlib
import inspect
import logging
import sys
import threading
import zlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numba
from numba.extending import intrinsic, typeof_impl

if TYPE_CHECKING:
    from numba.core.dispatcher import Dispatcher


def _import_without(excluded: str, module: str) -> None:
    """Import a module that then takes `excluded`, if nothing has imported it yet, for missing."""
    if excluded in sys.modules:
        importlib.import_module(module)
        return
    sys.modules[excluded] = None  # what Python takes for a module that cannot be imported
    try:
        importlib.import_module(module)
    finally:
        del sys.modules[excluded]


# Here Numba looks for a BLAS to use in np.convolve and np.correlate, and so imports SciPy's linear
# algebra: 0.1 s of processor time, 16 % of what importing the bridge takes and 9 % of a short run
# that compiles nothing. Numba has no public option against it. Its np.dot looks for a BLAS when it
# is compiled.
_import_without("scipy.linalg.cython_blas", "numba.np.arraymath")

_log = logging.getLogger(__name__)
_compile_lock = threading.RLock()
_functions: dict[tuple[str, str], CompiledFunction] = {}  # by module and name


class CompiledFunction:
    """A function for given argument types, compiled or read from the cache when it is first called,
    from Python or by a function that is being compiled.

    Attributes:
        py_func: the Python function.
    """

    def __init__(self, function: Callable, arguments: tuple, options: dict[str, object]) -> None:
        functools.update_wrapper(self, function)
        self.py_func = function
        self._arguments, self._options = arguments, options
        self._dispatcher: Dispatcher | None = None
        self._call: Callable = self._first_call

    def __call__(self, *arguments: object) -> object:
        """The function's value; TypeError for other types."""
        return self._call(*arguments)

    def _first_call(self, *arguments: object) -> object:
        return self.compile()(*arguments)

    def compile(self) -> Dispatcher:
        """Numba's function, compiled or read from the cache now if it was not before."""
        with _compile_lock:
            if self._dispatcher is None:
                self._dispatcher = self._call = _compile(
                    self.py_func, self._arguments, self._options
                )
        return self._dispatcher

    @property
    def signatures(self) -> list[tuple]:
        """The argument types; none while it is not compiled."""
        return [] if self._dispatcher is None else self._dispatcher.signatures

    @property
    def stats(self) -> object:
        """Numba's counts of what was read from the cache and what was compiled."""
        return self.compile().stats


@typeof_impl.register(CompiledFunction)
def _find_type(function: CompiledFunction, _context: object) -> numba.types.Type:
    """The type by which compiled functions call it: that of Numba's function."""
    return numba.typeof(function.compile())


def jit(signature: str, allocates: bool = True) -> Callable[[Callable], CompiledFunction]:
    """Decorator for a function of these argument types, in Numba's words: 'f8[:,::1], i8'.

    Loops are compiled in less time than arithmetic of arrays. Where an array is assigned to a slice
    Numba compiles the text of an error too, for a quarter of a second each; loops in its place
    check no shapes: whoever calls them sees to those.

    Arrays in C order ('f8[:,::1]') may be written to. Those in any order ('f8[:,:]') are only read,
    so read-only ones and views are taken too.

    allocates: whether it makes arrays. One that does not, and calls none that does, is compiled
    without counting references to the rows that it reads.
    """
    given = eval(f"({signature},)", vars(numba.types))
    arguments = tuple(
        kind.copy(readonly=True) if getattr(kind, "layout", "") == "A" else kind for kind in given
    )

    def compile_function(function: Callable) -> CompiledFunction:
        # No other language calls it, so a C function of the same kind is not compiled. `_nrt` is
        # private, and no public option counts no references: with them a step of the simulated
        # arm takes 8.0 µs instead of 6.2 µs of processor time (+28 %).
        made = CompiledFunction(function, arguments, {
            "nogil": True, "error_model": "numpy", "_nrt": allocates, "no_cfunc_wrapper": True,
        })  # fmt: skip
        _functions[function.__module__, function.__qualname__] = made
        return made

    return compile_function


def compile_all(package: str = "") -> None:
    """Compile, or read from the cache, all functions of the imported modules, or of those of a
    package: for nodes, whose first image must not wait for them."""
    for (module, _), function in list(_functions.items()):
        if package in ("", module.partition(".")[0]):
            function.compile()


def _compile(function: Callable, arguments: tuple, options: dict[str, object]) -> Dispatcher:
    # Numba's cache knows the function's own file and name alone, so the name tells it what else
    # the function is made of.
    name = function.__qualname__
    function.__qualname__ = f"{name}-{_compute_checksum(function):08x}"
    try:
        return numba.njit([arguments], cache=True, **options)(function)
    except RuntimeError as error:  # neither its folder nor the user's cache can be written
        if "cannot cache" not in str(error):
            raise
        _warn_once()
        return numba.njit([arguments], **options)(function)
    finally:
        function.__qualname__ = name


def _compute_checksum(function: Callable) -> int:
    """Checksum of what goes into compiled code besides its own source: the sources of the compiled
    functions that it calls, and the values of its globals."""
    called, found = [function], set()
    for one in called:
        for name in one.__code__.co_names:
            value = one.__globals__.get(name)
            source = getattr(value, "__wrapped__", None)
            if inspect.isfunction(source) and source not in called:
                called.append(source)
            elif isinstance(value, (bool, int, float, tuple)):
                found.add((name, repr(value)))
    for path in {one.__code__.co_filename for one in called[1:]}:
        stat = Path(path).stat()
        found.add((Path(path).name, _compute_file_checksum(path, stat.st_mtime_ns, stat.st_size)))
    return zlib.crc32(repr(sorted(found)).encode())


@cache
def _compute_file_checksum(path: str, _time: int, _size: int) -> str:
    """Of a file as it is now: copies of the same text are the same."""
    return str(zlib.crc32(Path(path).read_bytes()))


def jit_inline(function: Callable) -> Callable:
    """Decorator for a small function that becomes part of the compiled ones that call it: a call
    with three arrays costs more than a triangle's test."""
    return numba.njit(forceinline=True, nogil=True, error_model="numpy", _nrt=False,
                      no_cfunc_wrapper=True)(function)  # fmt: skip


def jit_inline_numba(function: Callable) -> Callable:
    """Decorator for a small function whose body Numba copies into each caller before LLVM sees it.

    Use it for loops over rows of arrays: LLVM vectorizes them only where it can tell that the rows
    do not overlap, and it loses that when it inlines the function itself, as for `jit_inline`.
    """
    return numba.njit(inline="always", nogil=True, error_model="numpy", _nrt=False,
                      no_cfunc_wrapper=True)(function)  # fmt: skip


@intrinsic
def lowest_bit(typing: object, bits: numba.types.Type) -> tuple[object, Callable]:
    """The number of the lowest bit of an integer of 64 bits that is not 0; for compiled functions.
    """

    def build(context: object, builder: object, signature: object, arguments: list) -> object:
        never_zero = context.get_constant(numba.types.boolean, True)
        return builder.cttz(arguments[0], never_zero)

    return numba.types.int64(bits), build


@cache
def _warn_once() -> None:
    _log.warning("compiled loops cannot be kept, so every start takes some ten "
                 "seconds longer; set NUMBA_CACHE_DIR to a folder that can be written")


def column(number: int) -> property:
    """A column of an object's `row`, as an attribute."""

    def read(self: object) -> float:
        return self.row.item(number)

    def write(self: object, value: float) -> None:
        self.row[number] = value

    return property(read, write)
