"""Names that are imported when they are first used, so that a run loads only what it needs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module


def lazy_exports(package: str, places: Mapping[str, str]) -> Callable[[str], object]:
    """The `__getattr__` of a package that exports names of its modules.

    Args:
        package: its full name, as `__name__` of its `__init__`.
        places: exported name to the module that has it, relative to the package, as '.config'.
    """

    def exported(name: str) -> object:
        if name not in places:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(places[name], package), name)

    return exported
