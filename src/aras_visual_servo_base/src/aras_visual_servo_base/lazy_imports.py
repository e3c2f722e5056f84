"""Lazy imports, which reduce the start time of programs.

A package's exported names are imported when they are first used. In addition, a library can be
imported without those libraries that it imports by itself but the program does not need.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Mapping
from importlib import import_module
from importlib.util import find_spec
from typing import Any

Getter = Callable[[str], object]
Lister = Callable[[], list[str]]


def lazy_exports(package: str, places: Mapping[str, str]) -> tuple[Getter, Lister]:
    """Return the functions `__getattr__` and `__dir__` for a package's `__init__` module.

    They import an exported name from its module when it is first used. For a misspelt name, the
    error suggests the most similar name of `__all__`.

    Args:
        package: full name of the package (its `__name__`). Its `__init__` must define `__all__`.
        places: for each exported name, the module that defines it. If the module's name starts with
            a dot, as in '.config', it is relative to the package.
    """

    def list_names() -> list[str]:
        return sorted(sys.modules[package].__all__)

    def get(name: str) -> object:
        if name in places:
            return getattr(import_module(places[name], package), name)
        is_module = name.isidentifier() and find_spec(f"{package}.{name}") is not None
        if name.startswith("__") or is_module:
            raise AttributeError(f"module {package!r} has no attribute {name!r}", name=name)
        from .names import suggest  # imported here because it is only needed for errors

        hint = suggest(name, list_names())
        # `from package import name` also calls this function. Python then replaces the message of
        # an AttributeError by its own, but it keeps the message of an ImportError.
        if sys._getframe(1).f_globals.get("__name__") == "importlib._bootstrap":
            text = f"cannot import name {name!r} from {package!r}: {hint}"
            raise ImportError(text, name=package)
        # Without the argument `obj`, the interpreter does not add a suggestion of its own.
        raise AttributeError(f"module {package!r} has no attribute {name!r}: {hint}", name=name)

    return get, list_names


def import_later(place: str) -> Callable[..., Any]:
    """Import and return the function 'package.module:name'.

    Modules are ordered in layers and import only modules of lower layers at their top. This
    function is for the few methods that call a function of a higher layer: those of `Run`, `Study`
    and `Results` that draw, write or compare results.
    """
    module, _, name = place.partition(":")
    return getattr(import_module(module), name)


class _MissingModule:
    """Import finder that makes one module appear missing, but only in its own thread."""

    def __init__(self, name: str) -> None:
        self._name, self._thread = name, threading.get_ident()

    def find_spec(self, name: str, _path: object = None, _target: object = None) -> None:
        if name == self._name and threading.get_ident() == self._thread:
            raise ModuleNotFoundError(f"{name} is not imported here", name=name)


def import_without(excluded: str, module: str) -> None:
    """Import a module as if `excluded` were not installed.

    If `excluded` is already imported, import the module normally.

    Args:
        excluded: full name of the module that must not be imported. If this is a submodule, its
            parent package is still imported.
        module: full name of the module to import.
    """
    finder = _MissingModule(excluded)
    sys.meta_path.insert(0, finder)
    try:
        import_module(module)
    finally:
        sys.meta_path.remove(finder)
