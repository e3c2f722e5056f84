"""The whole state of an object, by what it holds, compared with another's to the bit."""

from __future__ import annotations

import ast
import importlib
import inspect
import pkgutil
import re
import struct
import textwrap
import threading
import types
import weakref
from collections import deque
from collections.abc import Iterator, Mapping, Set
from functools import cache, cached_property, partial
from typing import Any

import numpy as np
from numba.core.dispatcher import Dispatcher

from aras_visual_servo_controller.seeing.ring_buffer import RecentErrors

# What is equal where it is the same object, or has no state that counts.
OPAQUE = (
    type, types.ModuleType, types.BuiltinFunctionType, Dispatcher, property, re.Pattern,
    type(threading.Lock()), type(threading.RLock()), threading.Thread, threading.Event,
    threading.Condition, threading.local, weakref.ref, types.GeneratorType,
)  # fmt: skip


def differences(old: Any, new: Any, ignored: Mapping[str, str] | None = None) -> list[str]:
    """Where two objects differ, as 'path: what stands there and here'; classes seen do not count.

    ignored: regular expressions of paths that may differ, each with the reason.
    """
    found: list[str] = []
    Comparison(found, tuple(re.compile(path) for path in ignored or ())).compare("", old, new)
    return found


def parts(thing: Any) -> list[Any]:
    """All that an object holds, itself included."""
    comparison = Comparison([], ())
    comparison.compare("", thing, thing)
    return [old for old, _ in comparison.seen.values()]


def left_by(thing: Any, method: str) -> set[str]:
    """What methods of an object's classes assign and this one, which begins anew, leaves."""
    found = set()
    for name in _assigned(type(thing), method) & vars(thing).keys():
        before, mark = getattr(thing, name), _Mark()
        setattr(thing, name, mark)
        try:
            getattr(thing, method)()
        except Exception:  # it works with what is there
            continue
        finally:
            kept = getattr(thing, name) is mark
            setattr(thing, name, before)
        if kept:
            found.add(name)
    return found


class _Mark:
    """What stands for anything that was there before."""


@cache
def _assigned(cls: type, method: str) -> set[str]:
    """Attributes that methods assign, but for those that make an object and this one."""
    found = set()
    for one in cls.__mro__:
        if not one.__module__.startswith("aras_"):
            continue
        for node in ast.walk(ast.parse(textwrap.dedent(inspect.getsource(one)))):
            if isinstance(node, ast.FunctionDef) and node.name not in ("__init__", method):
                found |= {
                    each.attr for each in ast.walk(node)
                    if isinstance(each, ast.Attribute) and isinstance(each.ctx, ast.Store)
                    and isinstance(each.value, ast.Name) and each.value.id == "self"}  # fmt: skip
    return found


class Comparison:
    """Walks two objects side by side; each pair once."""

    def __init__(self, found: list[str], ignored: tuple[re.Pattern, ...]) -> None:
        self.found, self.ignored = found, ignored
        self.seen: dict[tuple[int, int], Any] = {}

    def compare(self, path: str, old: Any, new: Any) -> None:
        """Note where they differ below this path."""
        if any(pattern.fullmatch(path) for pattern in self.ignored):
            return None
        pair = id(old), id(new)
        if pair in self.seen:
            return None
        self.seen[pair] = old, new  # kept, so that no other object gets its number
        if type(old) is not type(new):
            return self._differ(path, old, new)
        if isinstance(old, np.ndarray):
            if old.dtype != new.dtype or old.shape != new.shape:
                return self._differ(path, old, new)
            if old.dtype == object or old.tobytes() != new.tobytes():
                for index in np.ndindex(old.shape):
                    at = ", ".join(str(k) for k in index)
                    self.compare(f"{path}[{at}]", old[index], new[index])
            return None
        if isinstance(old, float | np.floating):
            if struct.pack("d", old) != struct.pack("d", new):
                self._differ(path, old, new)
            return None
        if isinstance(old, int | str | bytes | bool | complex | np.generic | None):
            if old != new and not (old != old and new != new):
                self._differ(path, old, new)
            return None
        if isinstance(old, OPAQUE):
            return None
        if isinstance(old, RecentErrors):  # what lies behind its end is nobody's
            held = [(each.stamps.copy(), each.errors.copy()) for each in (old, new)]
            return self.compare(f"{path}.held", *held)
        if isinstance(old, np.random.Generator):
            state, other = old.bit_generator.state, new.bit_generator.state
            return self.compare(f"{path}.state", state, other)
        if isinstance(old, Mapping):
            if list(old) != list(new):
                return self._differ(path, list(old), list(new))
            for key in old:
                self.compare(f"{path}[{key!r}]", old[key], new[key])
            return None
        if isinstance(old, Set):
            return None if old == new else self._differ(path, old, new)
        if isinstance(old, list | tuple | deque):
            self._sequence(path, old, new)
        for name, (mine, other) in _attributes(old, new).items():
            self.compare(f"{path}.{name}", mine, other)
        return None

    def _sequence(self, path: str, old: Any, new: Any) -> None:
        if len(old) != len(new):
            return self._differ(path, f"{len(old)} entries", f"{len(new)} entries")
        for k, (mine, other) in enumerate(zip(old, new, strict=True)):
            self.compare(f"{path}[{k}]", mine, other)
        return None

    def _differ(self, path: str, old: Any, new: Any) -> None:
        self.found.append(f"{path}: {_short(old)} instead of {_short(new)}")


class _Absent:
    def __repr__(self) -> str:
        return "nothing"


def _attributes(old: Any, new: Any) -> dict[str, tuple[Any, Any]]:
    both = [dict(_held(thing)) for thing in (old, new)]
    names = dict.fromkeys([*both[0], *both[1]])
    for thing, held in zip((old, new), both, strict=True):
        for name in names.keys() - held.keys():
            lazy = isinstance(getattr(type(thing), name, None), cached_property)
            held[name] = getattr(thing, name) if lazy else _Absent()
    return {name: (both[0][name], both[1][name]) for name in names}


def _held(thing: Any) -> Iterator[tuple[str, Any]]:
    """What an object, a function or a method holds, by name."""
    if isinstance(thing, types.MethodType):
        yield "__self__", thing.__self__
        yield "__func__", thing.__func__.__qualname__
        return
    if isinstance(thing, partial):
        yield from (("func", thing.func), ("args", thing.args), ("keywords", thing.keywords))
        return
    if isinstance(thing, types.FunctionType):
        yield "__qualname__", thing.__qualname__
        for name, cell in zip(thing.__code__.co_freevars, thing.__closure__ or (), strict=True):
            try:
                yield name, cell.cell_contents
            except ValueError:  # nothing was put into it yet
                continue
        return
    yield from getattr(thing, "__dict__", {}).items()
    for cls in type(thing).__mro__:
        slots = cls.__dict__.get("__slots__", ())
        for name in (slots,) if isinstance(slots, str) else slots:
            if name not in ("__dict__", "__weakref__") and hasattr(thing, name):
                yield name, getattr(thing, name)


def _short(thing: Any) -> str:
    text = repr(thing).replace("\n", "")
    return text if len(text) <= 120 else text[:117] + "..."


def with_method(package: types.ModuleType, names: tuple[str, ...]) -> dict[str, type]:
    """Classes of a package, by their names, that define one of these methods themselves."""
    found = {}
    for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        try:
            loaded = importlib.import_module(module.name)
        except ImportError:
            continue  # of ROS, where there is none
        for cls in vars(loaded).values():
            if isinstance(cls, type) and cls.__module__ == module.name and any(
                isinstance(cls.__dict__.get(name), types.FunctionType) for name in names
            ):
                found[f"{cls.__module__}.{cls.__qualname__}"] = cls
    return found

