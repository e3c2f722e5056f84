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
        # Modules of the package that have not been imported yet; None until the modules are listed.
        self._unimported: list[str] | None = None

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
        """Return the names of the package's modules that have not been imported yet."""
        if self._unimported is None:
            folder = importlib.import_module(self._package).__path__
            there = sorted(module.name for module in pkgutil.iter_modules(folder))
            self._unimported = sorted(there, key=lambda name: name not in self._first)
        return self._unimported

    def _import_module(self, module: str) -> None:
        """Import a module of the package; its decorators register its classes."""
        self._list_modules().remove(module)
        importlib.import_module(f"{self._package}.{module}")

    def find(self, name: str) -> type:
        """Return the class for a short name or 'package.module:Class'.

        Raises:
            fault: the name, module or class does not exist, or the class is of another kind.
        """
        if not all(str(name).partition(":")):
            if name not in self:
                raise self.fault(describe_unknown(self.kind, name, self, accepts_class=True))
            return self[name]
        return check_subclass(self.kind, name, import_object(self.kind, name, self.fault),
            self.bases,
                        self.fault)  # fmt: skip

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
    """Create an instance of a registered class or of a user's class.

    Every exception that the constructor raises is converted to a `fault` with a message of one
    line.

    Raises:
        fault: an option is unknown, a required one is missing, or the constructor fails.
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
    """Check that the constructor of a class accepts these arguments and options.

    Raises:
        fault: an option is unknown or a required argument is missing. For an unknown option, the
            message suggests the most similar one.
    """
    try:
        signature = inspect.signature(cls)
    except (TypeError, ValueError):
        return  # the class has no signature, so the options cannot be checked
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
