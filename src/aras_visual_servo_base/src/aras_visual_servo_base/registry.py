"""Registry of classes of one kind, such as control laws, which are selected by short names.

    LAWS = Registry("law", "my_package.laws", (Law,), ConfigurationError)

    @LAWS.register("proportional")
    class Proportional(Law): ...

Each class is declared in a module of one package, here `my_package.laws`. To add an entry, add one
file to the package's folder. The parameters of the class are declared with `settings.parameter`.
"""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import pkgutil
from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
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
from .setting_values import BOUNDS, describe_expected, list_annotations, list_fields
from .settings import get_default

C = TypeVar("C", bound=type)


class Parameter(NamedTuple):
    """Declaration of one parameter of a registered class.

    The parameter is required if `default` is None.
    """

    name: str
    kind: str
    default: Any
    unit: str
    bounds: str
    help: str


class Registry(Mapping[str, type]):
    """Mapping from short names to classes of one kind.

    The package's modules are imported when an entry is first needed. The module with the name of
    the entry is imported first. If it does not declare the entry, the other modules are imported
    one by one.
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
        """Create an empty registry.

        Args:
            kind: kind of the entries, for messages, such as 'law'.
            package: full name of the package whose modules declare entries.
            bases: base classes. Each entry must be derived from one of them.
            fault: class of the exceptions for wrong names and parameters.
            fallbacks: registries of the same kind, in which a name is searched if it is not in this
                one.
            first: modules to import before the package's other modules, because most users need
                them.
        """
        self.kind, self.bases, self.fault = kind, bases, fault
        self._package, self._fallbacks, self._first = package, fallbacks, first
        self._entries: dict[str, type] = {}

    def register(self, name: str) -> Callable[[C], C]:
        """Return a decorator that registers a class as `name` and sets its attribute `name`.

        Raises:
            fault: another class is registered under this name.
        """

        def add_class(cls: C) -> C:
            taken = self._entries.get(name)
            if taken is not None and taken.__qualname__ != cls.__qualname__:
                raise self.fault(
                    f"{self.kind} '{name}' already exists "
                    f"({taken.__module__}:{taken.__qualname__}); use another name"
                )
            self._entries[name] = cls
            cls.name = name
            return cls

        return add_class

    @cached_property
    def _unimported(self) -> list[str]:
        """Names of the package's modules that have not been imported yet."""
        folder = importlib.import_module(self._package).__path__
        names = sorted(module.name for module in pkgutil.iter_modules(folder))
        return sorted(names, key=lambda name: name not in self._first)

    def _import_module(self, module: str) -> None:
        """Import a module of the package; its decorators register its classes."""
        self._unimported.remove(module)
        importlib.import_module(f"{self._package}.{module}")

    def __getitem__(self, name: str) -> type:
        registries = (self, *self._fallbacks)
        for registry in registries:
            if name in registry._unimported:
                registry._import_module(name)
        for registry in registries:
            if name in registry._entries:
                return registry._entries[name]
        for registry in registries:
            while registry._unimported:
                registry._import_module(registry._unimported[0])
                if name in registry._entries:
                    return registry._entries[name]
        raise KeyError(name)

    def __iter__(self) -> Iterator[str]:
        while self._unimported:
            self._import_module(self._unimported[0])
        return iter(sorted(set(self._entries).union(*self._fallbacks)))

    def __len__(self) -> int:
        return len(list(iter(self)))

    def find(self, name: str) -> type:
        """Return the class for a short name or 'package.module:Class'.

        Raises:
            fault: the name, module or class does not exist, or the class is of another kind.
        """
        if not all(str(name).partition(":")):
            if name not in self:
                raise self.fault(describe_unknown(self.kind, name, self, accepts_class=True))
            return self[name]
        found = import_object(self.kind, name, self.fault)
        return check_subclass(self.kind, name, found, self.bases, self.fault)

    def create(self, name: str, /, *arguments: object, **options: object) -> Any:
        """Create an instance of the class for a short name or 'package.module:Class'.

        Raises:
            fault: `find` or the constructor fails, or an option is not a parameter of the
                constructor.
        """
        return construct(self.kind, name, self.find(name), self.fault, *arguments, **options)

    def list_parameters(self, name: str) -> tuple[Parameter, ...]:
        """Return the declarations of an entry's parameters."""
        return list_parameters(self.find(name))


def list_parameters(cls: type) -> tuple[Parameter, ...]:
    """Return the parameters of a dataclass, which are its fields. Other classes have none."""
    if not dataclasses.is_dataclass(cls):
        return ()
    hints, found = list_annotations(cls), []
    for name, field in list_fields(cls).items():
        rules, default = field.metadata, get_default(field)
        bounds = " and ".join(
            f"{sign} {rules[key]:g}" for key, sign, _ in BOUNDS if rules.get(key) is not None
        )
        found.append(Parameter(
            name, describe_expected(hints[name]),
            None if default is dataclasses.MISSING else default, rules.get("unit", ""),
            bounds or ", ".join(rules.get("choices", ())), rules.get("help", ""),
        ))  # fmt: skip
    return tuple(found)


def construct(
    kind: str, name: str, cls: type, fault: Fault, /, *arguments: object, **options: object
) -> Any:
    """Create an instance of a registered class or of a user's class.

    The arguments are compared with the constructor's signature only if the constructor fails. Every
    exception that it raises is converted to a `fault` with a message of one line.

    Raises:
        fault: an option is unknown (the message suggests the most similar one), a required argument
            is missing, or the constructor fails.
    """
    try:
        return cls(*arguments, **options)
    except fault:
        raise
    except USER_FAULTS as error:
        reason = _explain_arguments(cls, arguments, options)
        reason = reason or f": its constructor raised {format_error(error)}"
        raise fault(f"{kind} '{name}'{reason}") from error


def _explain_arguments(cls: type, arguments: tuple, options: Mapping[str, object]) -> str:
    """Return why the constructor of a class does not accept arguments; '' if it accepts them."""
    try:
        signature = inspect.signature(cls)
    except (TypeError, ValueError):
        return ""  # the class has no signature, so the arguments cannot be checked
    kinds = {key: one.kind for key, one in signature.parameters.items()}
    named = (inspect.Parameter.KEYWORD_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    taken = sorted(key for key, kind in kinds.items() if kind in named)
    if inspect.Parameter.VAR_KEYWORD not in kinds.values():
        for option in options:
            if option not in taken:
                return f" takes no '{option}': {suggest(option, taken)}"
    try:
        signature.bind(*arguments, **options)
    except TypeError as error:
        return f": {error}"
    return ""
