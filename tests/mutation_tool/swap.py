"""Planting a fault into functions of modules that are imported already: their code is exchanged.

Importing the workspace and collecting its tests takes longer than most tests. A process that has
done both once is forked for each fault, and only code within functions is exchanged there; what
numba made of it is compiled again, with all compiled functions that call it. What a module makes
when it is imported (constants, classes, decorated functions) would stay as it was, so such faults
are refused here.
"""

from __future__ import annotations

import gc
import inspect
import sys
from pathlib import Path
from types import CodeType, FunctionType

_Identity = tuple[str, str, int]


class Functions:
    """The functions that are alive when this is made, by file, qualified name and first line."""

    def __init__(self) -> None:
        self._alive: dict[_Identity, list[FunctionType]] = {}
        for one in gc.get_objects():
            if type(one) is FunctionType:
                self._alive.setdefault(_identity(one.__code__), []).append(one)
        self._loops = _Loops()
        self._imported = {getattr(m, "__file__", None) for m in list(sys.modules.values())}
        self._imported |= {file for file, _, _ in self._alive}  # of modules by no name too

    def plant(self, file: Path, was: bytes, now: bytes) -> bool:
        """Exchange what differs; False where the file must be imported anew instead."""
        if str(file) not in self._imported:
            return True  # whoever imports it finds the fault in the file
        old, new = (compile(source, str(file), "exec", dont_inherit=True) for source in (was, now))
        pairs: list[tuple[CodeType, CodeType]] = []
        if not _functions_that_differ(old, new, pairs):
            return False
        found = [(f, to) for code, to in pairs for f in self._alive.get(_identity(code), ())]
        for function, code in found:
            try:
                function.__code__ = code
            except ValueError:  # it takes other variables from around it
                return False
        self._loops.compile_again({function for function, _ in found})
        return bool(found)


class _Loops:
    """The compiled functions that are alive when this is made."""

    def __init__(self) -> None:
        numba = sys.modules.get("numba.core.dispatcher")
        kinds = (numba.Dispatcher,) if numba else ()
        # by its type: a weak proxy of what is gone cannot say what it is
        self._alive = [one for one in gc.get_objects() if issubclass(type(one), kinds)]

    def compile_again(self, functions: set[FunctionType]) -> None:
        """Those of these functions and all that call them, the called ones first."""
        by_function = {one.py_func: one for one in self._alive}
        stale = [by_function[function] for function in functions if function in by_function]
        for one in stale:  # it grows
            stale += [user for user in self._alive
                      if user not in stale and any(called is one for called in _globals(user))]
        done: set[int] = set()
        while left := [one for one in stale if id(one) not in done]:
            waiting = {id(one) for one in left}
            ready = [one for one in left
                     if not any(id(called) in waiting - {id(one)} for called in _globals(one))]
            for one in ready or left:
                one._cache = sys.modules["numba.core.caching"].NullCache()
                one.recompile()
                done.add(id(one))


def _globals(dispatcher: object) -> list[object]:
    function = dispatcher.py_func
    return [function.__globals__.get(name) for name in function.__code__.co_names]


def _identity(code: CodeType) -> _Identity:
    return code.co_filename, code.co_qualname, code.co_firstlineno


def _functions_that_differ(
    old: CodeType, new: CodeType, pairs: list[tuple[CodeType, CodeType]]
) -> bool:
    """Collects them; False where what is no function differs too."""
    before, after = _inner(old), _inner(new)
    same = _own(old) == _own(new) and [c.co_name for c in before] == [c.co_name for c in after]
    if not same:
        if not old.co_flags & inspect.CO_OPTIMIZED:
            return False
        pairs.append((old, new))
    for inside in zip(before, after, strict=False):
        differ: list[tuple[CodeType, CodeType]] = []
        if not _functions_that_differ(*inside, differ):
            return False
        if differ and same and old.co_flags & inspect.CO_OPTIMIZED:
            pairs.append((old, new))
            same = False  # it is listed now
        pairs += differ
    return True


def _inner(code: CodeType) -> list[CodeType]:
    return [one for one in code.co_consts if isinstance(one, CodeType)]


def _own(code: CodeType) -> tuple[object, ...]:
    constants = [repr(one) for one in code.co_consts if not isinstance(one, CodeType)]
    return code.co_code, code.co_names, code.co_varnames, code.co_exceptiontable, constants
