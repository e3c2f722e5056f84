"""Suggestions for unknown names, names in the ROS graph, and import of 'package.module:Name'."""

from __future__ import annotations

import difflib
import importlib
from collections.abc import Callable, Iterable
from types import ModuleType
from typing import Any

Fault = type[Exception]
# Exceptions that a user's class or module may raise, and that must not end the program. They
# include SystemExit, which sys.exit raises.
USER_FAULTS = (Exception, SystemExit)


def find_nearest(name: object, known_names: Iterable[str], cutoff: float = 0.6) -> str:
    """Return the most similar known name, or '' if none is similar."""
    return next(
        iter(difflib.get_close_matches(str(name), list(map(str, known_names)), 1, cutoff)), ""
    )


def suggest(name: object, known_names: Iterable[str]) -> str:
    """Return a hint about an unknown name, for a message.

    The hint is the most similar name, or a list of all known names if none is similar.
    """
    known_names = [str(entry) for entry in known_names]
    near = find_nearest(name, known_names)
    if near:
        return f"did you mean '{near}'?"
    return f"use one of {', '.join(known_names)}" if known_names else "none is available"


def resolve_name(*names: str) -> str:
    """Join ROS names to a global name; each name is relative to the previous one.

    The result is that of nested NodeHandles. A name that starts with "/" is global, so the names
    before it have no effect.
    """
    parts: list[str] = []
    for name in names:
        name_parts = [part for part in name.split("/") if part]
        parts = name_parts if name.startswith("/") else parts + name_parts
    return "/" + "/".join(parts)


def describe_unknown(
    kind: str, name: object, known_names: Iterable[str], accepts_class: bool = False
) -> str:
    """Return the message for an unknown name: the most similar name, and all known names.

    Args:
        kind: kind of the names, for the message, such as 'scheme'.
        accepts_class: whether a name may also be 'package.module:Class'.
    """
    known_names = list(known_names)
    near = find_nearest(name, known_names, 0.5)
    hint = f"did you mean '{near}'? Or use one of" if near else "use one of"
    known_ones = ", ".join(known_names) + (", or 'package.module:Class'" if accepts_class else "")
    return f"unknown {kind} '{name}': {hint} {known_ones}"


def import_object(
    kind: str,
    name: object,
    fault: Fault,
    path: object = None,
    load: Callable[[str], ModuleType] = importlib.import_module,
) -> Any:
    """Import the object with the path 'package.module:Name'.

    Args:
        kind: kind of the object, for messages, such as 'scheme' or 'metric'.
        name: text that the user wrote: the path, or a short name for it.
        fault: class of the exceptions to raise.
        path: the path, if `name` is a short name; None if `name` is the path itself.
        load: function that imports a module.

    Raises:
        fault: the path does not have this form, the module or the object does not exist, or the
            import fails.
    """
    path = str(name if path is None else path)
    module_name, _, attribute = path.partition(":")
    if not (module_name and attribute):
        raise fault(f"{kind} '{name}': '{path}' is not of the form 'package.module:Class'")
    try:
        module = load(module_name)
    except ImportError as error:
        raise fault(
            f"{kind} '{name}': cannot import {module_name} ({error}); check that its package is "
            "built and its workspace sourced"
        ) from error
    except USER_FAULTS as error:
        raise fault(
            f"{kind} '{name}': importing {module_name} raised {format_error(error)}"
        ) from error
    if not hasattr(module, attribute):
        near = find_nearest(attribute, [n for n, v in vars(module).items() if isinstance(v, type)])
        hint = f": did you mean '{near}'?" if near else ""
        raise fault(f"{kind} '{name}': {module_name} has no {attribute}{hint}")
    return getattr(module, attribute)


def check_subclass(
    kind: str, name: str, candidate: Any, bases: tuple[type, ...], fault: Fault
) -> type:
    """Return `candidate` after checking that it is a subclass of one of the bases.

    Raises:
        fault: `candidate` is not a class, or not a subclass of any base.
    """
    if isinstance(candidate, type) and issubclass(candidate, bases):
        return candidate
    called = getattr(candidate, "__name__", str(name).rpartition(":")[2])
    expected = " or ".join(base.__name__ for base in bases)
    raise fault(f"{kind} '{name}': {called} is not a class derived from {expected}")


def format_error(error: BaseException) -> str:
    """Return the type and text of an exception on one line, for a message."""
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text}" if text else type(error).__name__
