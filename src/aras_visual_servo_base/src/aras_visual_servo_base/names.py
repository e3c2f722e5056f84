"""Names: the nearest known one, names of the ROS graph, classes by 'package.module:Class'."""

from __future__ import annotations

import difflib
import importlib
import inspect
from collections.abc import Callable, Iterable, Mapping
from types import ModuleType
from typing import Any

Fault = type[Exception]
# What a user's class or module may raise: it must end nothing but itself, sys.exit no more than
# the rest.
USER_FAULTS = (Exception, SystemExit)


def likely(name: object, known: Iterable[str], cutoff: float = 0.6) -> str:
    """The known name that is nearest; '' where none is near."""
    return next(iter(difflib.get_close_matches(str(name), list(map(str, known)), 1, cutoff)), "")


def nearest(name: object, known: Iterable[str]) -> str:
    """What to say to an unknown name: the nearest known one as a question, or all of them."""
    known = [str(entry) for entry in known]
    near = likely(name, known)
    return f"did you mean '{near}'?" if near else f"known are {', '.join(known) or 'none'}"


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


def unknown(kind: str, name: object, known: Iterable[str], own: bool = False) -> str:
    """A message that lists all known names, the nearest one first; `own`: a class may be named."""
    known = list(known)
    near = likely(name, known, 0.5)
    hint = f"did you mean '{near}'? " if near else ""
    known_ones = ", ".join(known) + (", or 'package.module:Class'" if own else "")
    return f"unknown {kind} '{name}': {hint}known are {known_ones}"


def imported(
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
        raise fault(f"{kind} '{name}': importing {module_name} raised {words(error)}") from error
    if not hasattr(module, attribute):
        near = likely(attribute, [n for n, v in vars(module).items() if isinstance(v, type)])
        hint = f": did you mean '{near}'?" if near else ""
        raise fault(f"{kind} '{name}': {module_name} has no {attribute}{hint}")
    return getattr(module, attribute)


def find_class(
    kind: str, name: str, known: Mapping[str, type], bases: tuple[type, ...], fault: Fault
) -> type:
    """The class of a short name or of 'package.module:Class'.

    Args:
        kind: what is looked for, for messages: 'scheme', 'law', 'feature'.
        name: as the user wrote it.
        known: short names.
        bases: it has to derive from one of these.

    Raises:
        fault: no such name, module or class, or another kind of class.
    """
    if name in known:
        return known[name]
    if not all(str(name).partition(":")):
        raise fault(unknown(kind, name, known, own=True))
    return subclass(kind, name, imported(kind, name, fault), bases, fault)


def subclass(kind: str, name: str, found: Any, bases: tuple[type, ...], fault: Fault) -> type:
    """What was found, if it is a class derived from one of the bases; raises `fault` else."""
    if isinstance(found, type) and issubclass(found, bases):
        return found
    called = getattr(found, "__name__", str(name).rpartition(":")[2])
    expected = " or ".join(base.__name__ for base in bases)
    raise fault(f"{kind} '{name}': {called} is not a class derived from {expected}")


def construct(
    kind: str, name: str, cls: type, fault: Fault, *arguments: object, **options: object
) -> Any:
    """An instance of a class that may be a user's: whatever it raises becomes one line.

    Raises:
        fault: an option that it has not, one that it needs and was not given, or the constructor
            failed.
    """
    check_options(kind, name, cls, fault, *arguments, **options)
    try:
        return cls(*arguments, **options)
    except fault:
        raise
    except USER_FAULTS as error:
        raise fault(f"{kind} '{name}': its constructor raised {words(error)}") from error


def check_options(
    kind: str, name: str, cls: type, fault: Fault, *arguments: object, **options: object
) -> None:
    """Refuse options that a class's constructor does not take, by name.

    Raises:
        fault: naming the option, and the nearest one that there is.
    """
    try:
        signature = inspect.signature(cls)
    except (TypeError, ValueError):
        return  # one that does not say what it takes
    taken = sorted(
        key for key, one in signature.parameters.items()
        if one.kind in (one.KEYWORD_ONLY, one.POSITIONAL_OR_KEYWORD)
    )  # fmt: skip
    if not any(one.kind is one.VAR_KEYWORD for one in signature.parameters.values()):
        for option in options:
            if option not in taken:
                hint = nearest(option, taken)
                raise fault(f"{kind} '{name}' takes no '{option}': {hint}")
    try:
        signature.bind(*arguments, **options)
    except TypeError as error:
        raise fault(f"{kind} '{name}': {error}") from error


def words(error: BaseException) -> str:
    """An exception for a message: its type and text on one line."""
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text}" if text else type(error).__name__
