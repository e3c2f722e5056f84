"""Classes by name: short names of what is shipped, 'package.module:Class' for a user's own."""

from __future__ import annotations

import difflib
import importlib
import inspect
from collections.abc import Iterable, Mapping

from .errors import ConfigurationError


def unknown(
    kind: str, name: object, known: Iterable[str], own: bool = False
) -> ConfigurationError:
    """An error that lists the known names, the nearest one first; `own`: a class may be named."""
    known = list(known)
    near = difflib.get_close_matches(str(name), known, 1, cutoff=0.5)
    hint = f"did you mean '{near[0]}'? " if near else ""
    known_ones = ", ".join(known) + (", or 'package.module:Class'" if own else "")
    return ConfigurationError(f"unknown {kind} '{name}': {hint}known are {known_ones}")


def find_class(
    kind: str, name: str, known: Mapping[str, type], bases: tuple[type, ...]
) -> type:
    """The class of a short name or of 'package.module:Class'.

    Args:
        kind: what is looked for, for messages: 'scheme', 'law', 'feature'.
        name: as the user wrote it.
        known: short names.
        bases: it has to derive from one of these.

    Raises:
        ConfigurationError: no such name, module or class, or another kind of class.
    """
    if name in known:
        return known[name]
    module_name, colon, class_name = str(name).partition(":")
    if not (module_name and colon and class_name):
        raise unknown(kind, name, known, own=True)
    try:
        module = importlib.import_module(module_name)
    except ImportError as error:
        raise ConfigurationError(
            f"{kind} '{name}': cannot import {module_name} ({error}); is its package built and "
            "its workspace sourced?"
        ) from error
    except (Exception, SystemExit) as error:
        raise ConfigurationError(
            f"{kind} '{name}': importing {module_name} raised {words(error)}"
        ) from error
    found = getattr(module, class_name, None)
    if found is None:
        classes = [n for n, v in vars(module).items() if isinstance(v, type)]
        near = difflib.get_close_matches(class_name, classes, 1)
        hint = f": did you mean '{near[0]}'?" if near else ""
        raise ConfigurationError(f"{kind} '{name}': {module_name} has no {class_name}{hint}")
    if not (isinstance(found, type) and issubclass(found, bases)):
        expected = " or ".join(base.__name__ for base in bases)
        raise ConfigurationError(
            f"{kind} '{name}': {class_name} is not a class derived from {expected}"
        )
    return found


def construct(kind: str, name: str, cls: type, *arguments: object, **options: object) -> object:
    """An instance of a class that may be a user's: whatever it raises becomes one line.

    Raises:
        ConfigurationError: an option that it has not, one that it needs and was not given, or the
            constructor failed.
    """
    check_options(kind, name, cls, *arguments, **options)
    try:
        return cls(*arguments, **options)
    except ConfigurationError:
        raise
    except (Exception, SystemExit) as error:
        raise ConfigurationError(
            f"{kind} '{name}': its constructor raised {words(error)}"
        ) from error


def check_options(
    kind: str, name: str, cls: type, *arguments: object, **options: object
) -> None:
    """Refuse options that a class's constructor does not take, by name.

    Raises:
        ConfigurationError: naming the option, and the nearest one that there is.
    """
    try:
        signature = inspect.signature(cls)
    except (TypeError, ValueError):
        return  # one that does not say what it takes
    taken = {
        key for key, one in signature.parameters.items()
        if one.kind in (one.KEYWORD_ONLY, one.POSITIONAL_OR_KEYWORD)
    }  # fmt: skip
    if not any(one.kind is one.VAR_KEYWORD for one in signature.parameters.values()):
        for option in options:
            if option not in taken:
                near = difflib.get_close_matches(option, taken, 1)
                known = f"it takes {', '.join(sorted(taken)) or 'none'}"
                hint = f"did you mean '{near[0]}'?" if near else known
                raise ConfigurationError(f"{kind} '{name}' takes no '{option}': {hint}")
    try:
        signature.bind(*arguments, **options)
    except TypeError as error:
        raise ConfigurationError(f"{kind} '{name}': {error}") from error


def words(error: BaseException) -> str:
    """An exception for a message: its type and text on one line."""
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text}" if text else type(error).__name__
