"""Imports that load only what a program needs: exports at first use, no unused libraries."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Mapping
from importlib import import_module
from importlib.util import find_spec

Getter = Callable[[str], object]
Lister = Callable[[], list[str]]


def lazy_exports(package: str, places: Mapping[str, str]) -> tuple[Getter, Lister]:
    """Return `__getattr__` and `__dir__` for a package that exports names of its modules.

    For a misspelt attribute or import, the error suggests the most similar name of `__all__`.

    Args:
        package: full name of the package (its `__name__`); its `__init__` must define `__all__`.
        places: module that defines each exported name; a leading dot, as in '.config', makes the
            module relative to the package.
    """

    def list_names() -> list[str]:
        return sorted(sys.modules[package].__all__)

    def get(name: str) -> object:
        if name in places:
            return getattr(import_module(places[name], package), name)
        if name.startswith("__") or _is_module(f"{package}.{name}"):
            raise AttributeError(f"module {package!r} has no attribute {name!r}", name=name)
        from .names import suggest  # imported here because only errors need it

        hint = suggest(name, list_names())
        # `from package import name` replaces the message of an AttributeError by its own, but not
        # that of an ImportError.
        if sys._getframe(1).f_globals.get("__name__") == "importlib._bootstrap":
            text = f"cannot import name {name!r} from {package!r}: {hint}"
            raise ImportError(text, name=package)
        # Without `obj` the interpreter does not add another suggestion.
        raise AttributeError(f"module {package!r} has no attribute {name!r}: {hint}", name=name)

    return get, list_names


def _is_module(name: str) -> bool:
    """Return whether a module of this full name exists; its package must be imported."""
    return name.rpartition(".")[2].isidentifier() and find_spec(name) is not None


class _MissingModule:
    """Finder of modules that reports one module as missing, to the thread that created it."""

    def __init__(self, name: str) -> None:
        self._name, self._thread = name, threading.get_ident()

    def find_spec(self, name: str, _path: object = None, _target: object = None) -> None:
        if name == self._name and threading.get_ident() == self._thread:
            raise ModuleNotFoundError(f"{name} is not imported here", name=name)


def import_without(excluded: str, module: str) -> None:
    """Import a module as if `excluded` were not installed, unless that is already imported.

    Args:
        excluded: full name of a module that `module` would import if it were installed. If that is
            part of a package, the package is still imported.
        module: full name of the module to import.
    """
    finder = _MissingModule(excluded)
    sys.meta_path.insert(0, finder)
    try:
        import_module(module)
    finally:
        sys.meta_path.remove(finder)
