"""Registries: the classes of one kind by short name, each declared in a file of the kind's folder.

    LAWS = Registry("law", "my_package.laws", (Law,), ConfigurationError)

    @LAWS.register("proportional")
    class Proportional(Law): ...

A new entry is one file in the folder. Its parameters are fields that `settings.parameter` made.
"""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import pkgutil
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple, TypeVar

from .names import (
    USER_FAULTS,
    Fault,
    check_subclass,
    describe_unknown,
    format_error,
    import_object,
    suggest,
)
from .setting_values import describe_hint
from .settings import get_default, list_annotations

C = TypeVar("C", bound=type)


class Parameter(NamedTuple):
    """What a registry's entry declares of one parameter; `default` is None where one is needed."""

    name: str
    kind: str
    default: Any
    unit: str
    bounds: str
    help: str


class Registry(Mapping[str, type]):
    """Classes of one kind by short name.

    The folder's modules are imported when an entry is first asked for: the module of the entry's
    own name, and only where that does not declare it the others one by one.
    """

    def __init__(
        self,
        kind: str,
        package: str,
        bases: tuple[type, ...],
        fault: Fault,
        fallbacks: tuple[Registry, ...] = (),
        first: tuple[str, ...] = (),
    ) -> None:
        """Args:
            kind: of the entries, for messages: 'law'.
            package: full name of the folder whose modules declare entries.
            bases: an entry derives from one of these.
            fault: exception class of wrong names and parameters.
            others: registries whose entries belong to this kind as well.
            first: modules to look into before the others, as most users need them.
        """
        self.kind, self.bases, self.fault = kind, bases, fault
        self._package, self._fallbacks, self._first = package, fallbacks, first
        self._entries: dict[str, type] = {}
        # modules of the folder that were not imported yet
        self._unimported: list[str] | None = None

    def register(self, name: str) -> Callable[[C], C]:
        """Return a class decorator that enters the class as `name`, and sets its attribute `name`.

        Raises:
            fault: the name is taken by another class.
        """

        def add_class(cls: C) -> C:
            taken = self._entries.get(name)
            if taken is not None and taken.__qualname__ != cls.__qualname__:
                raise self.fault(
                    f"{self.kind} '{name}' is already {taken.__module__}:{taken.__qualname__}"
                )
            self._entries[name] = cls
            cls.name = name
            return cls

        return add_class

    def __getitem__(self, name: str) -> type:
        registries = (self, *self._fallbacks)
        for registry in registries:
            if name in registry._list_modules():
                registry._import_module(name)
        for registry in registries:
            if name in registry._entries:
                return registry._entries[name]
        for registry in registries:
            while registry._list_modules():
                registry._import_module(registry._list_modules()[0])
                if name in registry._entries:
                    return registry._entries[name]
        raise KeyError(name)

    def __contains__(self, name: object) -> bool:
        try:
            self[name]
        except KeyError:
            return False
        return True

    def __iter__(self) -> Iterator[str]:
        while self._list_modules():
            self._import_module(self._list_modules()[0])
        return iter(
            sorted({*self._entries, *(name for other in self._fallbacks for name in other)})
        )

    def __len__(self) -> int:
        return len(list(iter(self)))

    def _list_modules(self) -> list[str]:
        """Return the names of the folder's modules that were not imported yet."""
        if self._unimported is None:
            folder = importlib.import_module(self._package).__path__
            there = sorted(module.name for module in pkgutil.iter_modules(folder))
            self._unimported = sorted(there, key=lambda name: name not in self._first)
        return self._unimported

    def _import_module(self, module: str) -> None:
        """Import a module of the folder, which enters what it declares."""
        self._list_modules().remove(module)
        importlib.import_module(f"{self._package}.{module}")

    def find(self, name: str) -> type:
        """Return the class of a short name or of 'package.module:Class'.

        Raises:
            fault: no such name, module or class, or another kind of class.
        """
        if not all(str(name).partition(":")):
            if name not in self:
                raise self.fault(describe_unknown(self.kind, name, self, accepts_class=True))
            return self[name]
        return check_subclass(self.kind, name, import_object(self.kind, name, self.fault),
            self.bases,
                        self.fault)  # fmt: skip

    def create(self, name: str, /, *arguments: object, **options: object) -> Any:
        """Return an instance of a short name or of 'package.module:Class'.

        Raises:
            fault: as `find`; options that the class does not take; what its constructor raised.
        """
        return construct(self.kind, name, self.find(name), self.fault, *arguments, **options)

    def list_parameters(self, name: str) -> tuple[Parameter, ...]:
        """Return what an entry declares of its parameters."""
        return list_parameters(self.find(name))


def list_parameters(cls: type) -> tuple[Parameter, ...]:
    """Return the parameters of a class, which are the fields of a dataclass; none of another."""
    if not dataclasses.is_dataclass(cls):
        return ()
    hints, found = list_annotations(cls), []
    for field in dataclasses.fields(cls):
        rules = field.metadata
        if not field.init or rules.get("internal"):
            continue
        needed = field.default is field.default_factory is dataclasses.MISSING
        bounds = " and ".join(
            f"{sign} {rules[key]:g}"
            for key, sign in (("least", ">="), ("above", ">"), ("most", "<="), ("below", "<"))
            if rules.get(key) is not None
        )
        found.append(Parameter(
            field.name, describe_hint(hints[field.name]), None if needed else get_default(field),
            rules.get("unit", ""), bounds or ", ".join(rules.get("choices", ())),
            rules.get("help", ""),
        ))  # fmt: skip
    return tuple(found)


def construct(
    kind: str, name: str, cls: type, fault: Fault, /, *arguments: object, **options: object
) -> Any:
    """Return an instance of a class that may be a user's: whatever it raises becomes one line.

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
        raise fault(f"{kind} '{name}': its constructor raised {format_error(error)}") from error


def check_options(
    kind: str, name: str, cls: type, fault: Fault, /, *arguments: object, **options: object
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
                raise fault(f"{kind} '{name}' takes no '{option}': {suggest(option, taken)}")
    try:
        signature.bind(*arguments, **options)
    except TypeError as error:
        raise fault(f"{kind} '{name}': {error}") from error
