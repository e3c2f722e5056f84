"""Names: the nearest known one, names of the ROS graph, objects by 'package.module:Name'."""

from __future__ import annotations

import difflib
import importlib
from collections.abc import Callable, Iterable
from types import ModuleType
from typing import Any

Fault = type[Exception]
# What a user's class or module may raise: it must end nothing but itself, sys.exit no more than
# the rest.
USER_FAULTS = (Exception, SystemExit)


def find_nearest(name: object, known_names: Iterable[str], cutoff: float = 0.6) -> str:
    """The known name that is nearest; '' where none is near."""
    return next(
        iter(difflib.get_close_matches(str(name), list(map(str, known_names)), 1, cutoff)), ""
    )


def suggest(name: object, known_names: Iterable[str]) -> str:
    """What to say to an unknown name: the nearest known one as a question, or all of them."""
    known_names = [str(entry) for entry in known_names]
    near = find_nearest(name, known_names)
    return f"did you mean '{near}'?" if near else f"known are {', '.join(known_names) or 'none'}"


def resolve_name(*names: str) -> str:
    """Return the global name in the ROS graph of the last name, each relative to those before it.

    As a chain of NodeHandles resolves them: a name that begins with "/" is global, and those before
    it do not count.
    """
    parts: list[str] = []
    for name in names:
        own = [part for part in name.split("/") if part]
        parts = own if name.startswith("/") else parts + own
    return "/" + "/".join(parts)


def describe_unknown(
    kind: str, name: object, known_names: Iterable[str], accepts_class: bool = False
) -> str:
    """A message that lists all known names, the nearest one first; `accepts_class`: a class may be
    named.
    """
    known_names = list(known_names)
    near = find_nearest(name, known_names, 0.5)
    hint = f"did you mean '{near}'? " if near else ""
    known_ones = ", ".join(known_names) + (", or 'package.module:Class'" if accepts_class else "")
    return f"unknown {kind} '{name}': {hint}known are {known_ones}"


def import_object(
    kind: str,
    name: object,
    fault: Fault,
    path: object = None,
    load: Callable[[str], ModuleType] = importlib.import_module,
) -> Any:
    """What 'package.module:Name' stands for.

    Args:
        kind: what is looked for, for messages: 'scheme', 'metric'.
        name: as the user wrote it.
        path: 'package.module:Name', where the name is another.
        load: how modules are imported.

    Raises:
        fault: no such form, module or attribute, or the module raised.
    """
    path = str(name if path is None else path)
    module_name, _, attribute = path.partition(":")
    if not (module_name and attribute):
        raise fault(f"{kind} '{name}': '{path}' is not of the form 'package.module:Class'")
    try:
        module = load(module_name)
    except ImportError as error:
        raise fault(
            f"{kind} '{name}': cannot import {module_name} ({error}); is its package built and "
            "its workspace sourced?"
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
    """What was found, if it is a class derived from one of the bases; raises `fault` else."""
    if isinstance(candidate, type) and issubclass(candidate, bases):
        return candidate
    called = getattr(candidate, "__name__", str(name).rpartition(":")[2])
    expected = " or ".join(base.__name__ for base in bases)
    raise fault(f"{kind} '{name}': {called} is not a class derived from {expected}")


def format_error(error: BaseException) -> str:
    """An exception for a message: its type and text on one line."""
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text}" if text else type(error).__name__
