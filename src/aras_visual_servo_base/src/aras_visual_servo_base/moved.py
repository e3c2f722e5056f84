"""Old names of modules that have moved: they go on to work, and mean the same module."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Mapping, Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import spec_from_loader
from types import ModuleType


class MovedModules(MetaPathFinder):
    """Finds modules of one package by the names that they had.

    `from package.old import Name` then gives the class of `package.room.new` itself, so that
    imports in users' packages, "package.module:Class" in their settings, and pickles stay valid.
    """

    def __init__(self, package: str, moved: Mapping[str, str]) -> None:
        """moved: old to new name, both relative to the package, e.g. {"goal": "goals.goal"}."""
        self._moved = {f"{package}.{old}": f"{package}.{new}" for old, new in moved.items()}

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """The module under its new name; None for one that has not moved."""
        new = self._moved.get(fullname)
        return None if new is None else spec_from_loader(fullname, _Alias(new))


class _Alias(Loader):
    """Loads nothing: gives the module that has another name."""

    def __init__(self, name: str) -> None:
        self._name = name

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        module = importlib.import_module(self._name)
        self._own_spec = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        module.__spec__ = self._own_spec  # importlib has put the alias's there


def keep_old_names(package: str, moved: Mapping[str, str]) -> None:
    """Let modules of `package` be imported by their old names too.

    Args:
        package: its full name, as `__name__` of its `__init__`.
        moved: old to new name of each module, relative to the package.
    """
    sys.meta_path.append(MovedModules(package, moved))
