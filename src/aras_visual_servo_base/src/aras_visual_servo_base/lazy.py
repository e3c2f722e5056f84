"""Names that are imported when they are first used, so that a run loads only what it needs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from importlib import import_module


class LazyClasses(Mapping[str, type]):
    """Classes by short name; looking one up imports its module.

    Membership, iteration and length import nothing.
    """

    def __init__(self, package: str, places: Mapping[str, str]) -> None:
        """places: short name to 'module:Class', the module relative to `package`, as '.points'."""
        self._places = {
            name: (package, *place.split(":")) for name, place in places.items()
        }

    def __getitem__(self, name: str) -> type:
        package, module, cls = self._places[name]
        return getattr(import_module(module, package), cls)

    def __contains__(self, name: object) -> bool:
        return name in self._places

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)

    def __or__(self, other: LazyClasses) -> LazyClasses:
        both = LazyClasses("", {})
        both._places = {**self._places, **other._places}
        return both


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
