"""Names that are imported when they are first used, so that a run loads only what it needs."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from importlib.util import find_spec

Getter = Callable[[str], object]
Lister = Callable[[], list[str]]


def lazy_exports(package: str, places: Mapping[str, str]) -> tuple[Getter, Lister]:
    """Return the `__getattr__` and the `__dir__` of a package that exports names of its modules.

    Both a wrong attribute and a wrong import get the nearest name of `__all__` as a suggestion.

    Args:
        package: full name of the package, as `__name__` of its `__init__`, which has `__all__`.
        places: exported name to the module that defines it; a leading dot, as in '.config', makes
            the module's name relative to the package.
    """

    def list_names() -> list[str]:
        return sorted(sys.modules[package].__all__)

    def get(name: str) -> object:
        if name in places:
            return getattr(import_module(places[name], package), name)
        if name.startswith("__") or _is_module(f"{package}.{name}"):
            raise AttributeError(f"module {package!r} has no attribute {name!r}", name=name)
        from .names import suggest  # a right name does not wait for it

        hint = suggest(name, list_names())
        # `from package import name` asks importlib first, and replaces the message of an
        # AttributeError by its own; an ImportError passes as it is.
        if sys._getframe(1).f_globals.get("__name__") == "importlib._bootstrap":
            text = f"cannot import name {name!r} from {package!r}: {hint}"
            raise ImportError(text, name=package)
        # Without `obj` the interpreter adds no second suggestion.
        raise AttributeError(f"module {package!r} has no attribute {name!r}: {hint}", name=name)

    return get, list_names


def _is_module(name: str) -> bool:
    """Tell whether there is a module of this full name, whose package is imported."""
    return name.rpartition(".")[2].isidentifier() and find_spec(name) is not None
