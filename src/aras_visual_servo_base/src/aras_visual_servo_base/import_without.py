"""Import a module without a slow optional library of it."""

from __future__ import annotations

import importlib
import sys
import threading


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
        importlib.import_module(module)
    finally:
        sys.meta_path.remove(finder)
