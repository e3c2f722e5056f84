"""Exports of a package that are imported when they are first used.

A program therefore loads only those modules of a package that it needs.
"""

from __future__ import annotations

import sys
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
        if name.startswith("__") or _is_module(f"{package}.{name}"):
            raise AttributeError(f"module {package!r} has no attribute {name!r}", name=name)
        from .names import suggest  # imported here because it is only needed for errors

        hint = suggest(name, list_names())
        # The statement `from package import name` calls this function, too. It would replace the
        # message of an AttributeError by its own, but it does not replace that of an ImportError.
        if sys._getframe(1).f_globals.get("__name__") == "importlib._bootstrap":
            text = f"cannot import name {name!r} from {package!r}: {hint}"
            raise ImportError(text, name=package)
        # Without the argument `obj`, the interpreter does not add a suggestion of its own.
        raise AttributeError(f"module {package!r} has no attribute {name!r}: {hint}", name=name)

    return get, list_names


def _is_module(name: str) -> bool:
    """Return whether a module with this full name exists; its package must be imported."""
    return name.rpartition(".")[2].isidentifier() and find_spec(name) is not None


def import_later(place: str) -> Callable[..., Any]:
    """Import a function 'package.module:name' when a method first needs it.

    Modules import only modules of lower layers. The only exception are methods of `Run`, `Study`
    and `Results` that draw, write or compare: each calls one function of a higher layer, which it
    imports by this function.
    """
    module, _, name = place.partition(":")
    return getattr(import_module(module), name)
