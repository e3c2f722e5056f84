"""Compilation with Numba, for short loops and small matrices, where NumPy's calls take too long.

The types of the arguments are declared, so that all functions can be compiled in advance. Compiled
functions are cached in __pycache__ next to the source file, or in NUMBA_CACHE_DIR. A function is
compiled again if its source file changes. It is also compiled again if another module changes a
compiled function or a constant that it uses, which Numba by itself would not notice.

Each function is compiled or loaded from the cache only when it is first called, because no program
calls more than half of the functions. Numba itself is imported at the first call of any of them,
which takes 0.2 s of processor time. Nodes call `compile_all` when they start, so that their first
image is not delayed.
"""

from __future__ import annotations

import functools
import inspect
import logging
import threading
import zlib
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

from .errors import NumbaUnavailableError
from .lazy_imports import import_without

if TYPE_CHECKING:
    import numba
    from numba.core.dispatcher import Dispatcher

_log = logging.getLogger(__name__)
_compile_lock = threading.RLock()
# All functions with the decorator `jit`, by module and name.
_functions: dict[tuple[str, str], CompiledFunction] = {}
# Reasons why compiled functions of this process could not be written to Numba's cache.
uncached_reasons: list[str] = []


@cache
def import_numba() -> ModuleType:
    """Import Numba, without the libraries that the project's functions do not use.

    Raises:
        NumbaUnavailableError: Numba is not installed or cannot be loaded.
    """
    try:
        import numba
    # OSError is raised if llvmlite cannot load LLVM's library
    except (ImportError, OSError) as error:
        raise NumbaUnavailableError(
            f"cannot import Numba, which compiles functions ({error}): run ./setup.sh; without "
            "ROS, pip install --force-reinstall numba"
        ) from error
    # numba.np.arraymath imports SciPy's linear algebra, which takes 0.1 s of processor time, i.e.
    # 12 % of a short run. Numba needs it only for np.convolve and np.correlate, which this project
    # does not compile, and has no public option to prevent the import.
    import_without("scipy.linalg", "numba.np.arraymath")
    return numba


class CompiledFunction:
    """A function that Numba compiles.

    It is compiled or loaded from the cache when it is first called from Python, or when a compiled
    function that calls it is compiled.

    Attributes:
        py_func: the original Python function.
    """

    def __new__(cls, *_: object) -> CompiledFunction:
        """Create an instance of a class of its own, whose `__call__` can be replaced."""
        return super().__new__(type(cls.__name__, (cls,), {}))

    def __init__(self, function: Callable, compile_function: Callable[[], Dispatcher]) -> None:
        functools.update_wrapper(self, function)
        self.py_func = function
        self._compile = compile_function
        self._dispatcher: Dispatcher | None = None

    def __call__(self, *arguments: object) -> object:
        """Compile the function and call it; later calls go directly to Numba's function.

        Raises:
            TypeError: the arguments do not have the declared types.
            NumbaUnavailableError: Numba, which the first call needs, cannot be imported.
        """
        return self.compile()(*arguments)

    def compile(self) -> Dispatcher:
        """Return Numba's compiled function; compile or load it first if necessary."""
        with _compile_lock:
            if self._dispatcher is None:
                self._dispatcher = self._compile()
                # Python looks for `__call__` in the class. A method in Python would take 0.2 µs
                # for each call, of which there are thirty for an image.
                type(self).__call__ = staticmethod(self._dispatcher)
        return self._dispatcher

    @property
    def signatures(self) -> list[tuple]:
        """The types of the arguments; empty until the function is compiled."""
        return [] if self._dispatcher is None else self._dispatcher.signatures

    @property
    def stats(self) -> object:
        """Numba's statistics: whether the function was compiled or loaded from the cache."""
        return self.compile().stats

    # Numba reads the properties `_numba_type_` and `targetoptions` when it compiles a function that
    # calls this one.
    @property
    def _numba_type_(self) -> numba.types.Type:
        return import_numba().typeof(self.compile())

    @property
    def targetoptions(self) -> dict[str, object]:
        """Numba's options; `inline` lets Numba inline the function."""
        return self.compile().targetoptions


def jit(signature: str, allocates: bool = True) -> Callable[[Callable], CompiledFunction]:
    """Return a decorator that compiles a function for a signature such as 'f8[:,::1], i8'.

    Write loops instead of array expressions, because loops compile faster. For each assignment of
    an array to a slice, Numba also compiles the text of an error message, which takes a quarter of
    a second. Loops do not check the shapes of arrays, so the caller must check them.

    Arrays that are declared in C order ('f8[:,::1]') may be written. Arrays that are declared in
    any order ('f8[:,:]') may only be read; the caller may pass views and read-only arrays for them.

    Args:
        allocates: whether the function, or a function that it calls, creates arrays. If False, the
            function is compiled without reference counting and is faster.
    """
    def compile_function(function: Callable) -> CompiledFunction:
        # No other language calls the function (`no_cfunc_wrapper`). Reference counting, which only
        # the private option `_nrt` of Numba can disable, would increase the processor time of a
        # step of the simulated arm by 28 %.
        made = CompiledFunction(function, partial(_compile, function, signature, {
            "nogil": True, "error_model": "numpy", "_nrt": allocates, "no_cfunc_wrapper": True,
        }))  # fmt: skip
        _functions[function.__module__, function.__qualname__] = made
        return made

    return compile_function


def compile_all(package: str = "") -> None:
    """Compile all functions of a package's imported modules, or load them from the cache.

    Nodes call this when they start, so that their first image is not delayed.

    Args:
        package: name of a package whose functions are compiled; '' for this project's packages.
    """
    for function in list_functions(package):
        function.compile()


def list_functions(package: str = "") -> list[CompiledFunction]:
    """Return the functions with the decorator `jit` in the imported modules of a package.

    If `package` is '', return those of this project's packages, whose names begin with 'aras_'.
    """
    def is_listed(module: str) -> bool:
        root = module.partition(".")[0]
        return root == package if package else root.startswith("aras_")

    return [function for (module, _), function in list(_functions.items()) if is_listed(module)]


def _compile(function: Callable, signature: str, options: dict[str, object]) -> Dispatcher:
    numba = import_numba()
    given = eval(f"({signature},)", vars(numba.types))
    arguments = tuple(
        kind.copy(readonly=True) if getattr(kind, "layout", "") == "A" else kind for kind in given
    )
    # Numba's cache identifies a function only by its file and its name. Therefore the name gets a
    # checksum of everything else on which the compiled code depends.
    name = function.__qualname__
    function.__qualname__ = f"{name}-{_compute_checksum(function):08x}"
    try:
        return numba.njit([arguments], cache=True, **options)(function)
    except RuntimeError as error:
        if "cannot cache" not in str(error):
            raise
        warn_uncached("the cache folder is not writable")
    except OSError as error:  # the cache cannot be written, for example because the disk is full
        warn_uncached(error.strerror or str(error))
    finally:
        function.__qualname__ = name
    return numba.njit([arguments], **options)(function)


def _compute_checksum(function: Callable) -> int:
    """Return a checksum of what a compiled function depends on outside of its source file.

    It covers the source files of the compiled functions that it calls, and the values of the global
    constants that these functions use.
    """
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
    """Return the checksum of a file; it is cached until the file's time or size changes."""
    return str(zlib.crc32(Path(path).read_bytes()))


def jit_inline(function: Callable) -> CompiledFunction:
    """Decorate a small function that LLVM inlines into the compiled functions that call it.

    Use this if a call would take more time than the function itself. For example, a call with three
    arrays takes longer than the test of one triangle.
    """
    return CompiledFunction(function, partial(_make_inline, function, {"forceinline": True}))


def jit_inline_numba(function: Callable) -> CompiledFunction:
    """Decorate a small function that Numba inlines into its callers before LLVM optimises them.

    Use this for loops over rows of arrays. LLVM vectorises such loops only if it can prove that the
    rows do not overlap, which is not possible if LLVM itself inlines the function (`jit_inline`).
    """
    return CompiledFunction(function, partial(_make_inline, function, {"inline": "always"}))


def _make_inline(function: Callable, options: dict[str, object]) -> Dispatcher:
    return import_numba().njit(
        nogil=True, error_model="numpy", _nrt=False, no_cfunc_wrapper=True, **options
    )(function)


def warn_uncached(reason: str) -> None:
    """Log, once per process, why compiled functions cannot be cached."""
    if reason in uncached_reasons:
        return
    uncached_reasons.append(reason)
    _log.warning(
        "compiled functions cannot be cached (%s), so every start compiles them again, which can "
        "take minutes; set NUMBA_CACHE_DIR to a writable folder with free space", reason,
    )  # fmt: skip


def column(number: int) -> property:
    """Return a property that reads and writes element `number` of the object's array `row`."""

    def read(self: object) -> float:
        return self.row.item(number)

    def write(self: object, value: float) -> None:
        self.row[number] = value

    return property(read, write)
