"""Settings as dataclasses: one reader for YAML files, ROS parameters, launch arguments, overrides.

The annotation of a field says what kind of value it takes, its metadata (see `parameter`) what
bounds it. Known annotations: float, int, bool, str, Path, Any, None, tuples (of fixed length, or
`tuple[float, ...]`), Mapping, other dataclasses, and unions of these, tried in the order written.

- A number is finite. A whole number is one too; true and false are none. What YAML 1.1 takes for a
  text though it is a number (1e1, -.5) is a number.
- A whole number is written as one: neither 10.0 nor 1e1.
- A list of numbers may be given as a text, as in a launch argument: '0 0 0.05'.
- In Python, NumPy arrays and numbers, ranges and paths are taken as the lists, numbers and texts
  that a file would hold.
- Keys are texts; a whole number as a key is its digits.

Every fault is one line: the full path of the key, its value, what is wanted, the nearest name.
`fault` is the exception class that is raised, the caller's own.
"""

from __future__ import annotations

import contextlib
import copyreg
import dataclasses
import functools
import numbers
import types
import typing
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from .names import find_nearest, suggest
from .setting_values import (
    Fault,
    as_number,
    check_value,
    convert_to_file_types,
    describe_hint,
    format_value,
    join_path,
    parse_word,
)

T = TypeVar("T")
NO_RULES: Mapping[str, Any] = types.MappingProxyType({})
_MISSING = object()


def _make_view(values: dict[str, Any]) -> types.MappingProxyType:
    return types.MappingProxyType(values)


# Python does not pickle read-only views by itself; settings go to other processes.
copyreg.pickle(types.MappingProxyType, lambda view: (_make_view, (dict(view),)))


def parameter(
    default: Any = dataclasses.MISSING,
    unit: str = "",
    *,
    least: float | None = None,
    above: float | None = None,
    most: float | None = None,
    below: float | None = None,
    choices: Iterable[str] = (),
    renamed: Mapping[str, str] = types.MappingProxyType({}),
    expected: str = "",
    name: bool = False,
    splits_words: bool = False,
    infinite: bool = False,
    internal: bool = False,
    shorthand: bool = False,
    importable: bool = False,
    help: str = "",
) -> Any:
    """Declare a setting: a dataclass field with the rules for its value.

    Args:
        default: value where none is given; left out: the setting is needed.
        unit: for messages and tables: 'm', '1/s'.
        least, above, most, below: bounds of a number, and of each in a list or mapping.
        choices: the texts that there are.
        renamed: new names of choices by their old names, for the error message.
        wanted: what to say instead of the annotation's words.
        name: a whole number stands for its digits: roslaunch makes one of start:=2016.
        words: a text stands for the list of its words.
        infinite: infinity is a number too.
        internal: not to be given from outside.
        shorthand: a value that is no mapping, given for the whole dataclass, is this field's.
        importable: a class stands for its 'package.module:Class'.
        help: what it does, for tables and --help.
    """
    rules = {
        "unit": unit, "least": least, "above": above, "most": most, "below": below,
        "choices": tuple(choices), "renamed": dict(renamed), "expected": expected, "name": name,
        "splits_words": splits_words,
        "infinite": infinite, "internal": internal, "shorthand": shorthand,
        "importable": importable, "help": help,
    }  # fmt: skip
    if isinstance(default, dict):
        return dataclasses.field(default_factory=lambda: dict(default), metadata=rules)
    return dataclasses.field(default=default, metadata=rules)


def get_default(field: dataclasses.Field) -> Any:
    """The default of a field, whichever way it is kept."""
    if field.default is not dataclasses.MISSING:
        return field.default
    return field.default_factory()


def list_defaults(cls: type) -> dict[str, Any]:
    """Default of every field that may be given and has one."""
    return {
        name: get_default(field)
        for name, field in _list_fields(cls).items()
        if not _is_required(field)
    }


def build(cls: type[T], values: Any, where: str, fault: Fault) -> T:
    """Make a dataclass of a mapping.

    Args:
        where: the mapping's own name, for messages: '', 'start', 'parameter ~', 'goal.yaml: '.

    Raises:
        fault: an unknown or missing key, a wrong value, or what the class itself refuses.
    """
    short = _find_shorthand(cls)
    if short and not isinstance(values, Mapping) and values is not None:
        values = {short: values}
    found = convert_fields(cls, values, where, fault)
    for name, field in _list_fields(cls).items():
        if name not in found and _is_required(field):
            raise fault(
                f"{join_path(where, name)} is missing, must be {_describe_type(cls, field)}"
            )
    return cls(**found)


def convert_fields(cls: type, values: Any, where: str, fault: Fault) -> dict[str, Any]:
    """The values as the dataclass's fields want them, by name; raises as `build`."""
    if not isinstance(values, Mapping):
        place = where.rstrip(": ~") or cls.__name__
        raise fault(f"{place} is {format_value(values)}, must be keys with values")
    known, hints, found = _list_fields(cls), list_annotations(cls), {}
    for key, value in values.items():
        if key not in known:
            renamed = getattr(cls, "renamed_keys", {})
            raise fault(describe_unknown_key(where, key, known, renamed))
        found[key] = convert(value, hints[key], join_path(where, key), fault, known[key].metadata)
    return found


def read(
    values: Mapping[str, Any],
    key: str,
    hint: Any,
    where: str,
    fault: Fault,
    default: Any = _MISSING,
) -> Any:
    """One value of a mapping that may hold others' keys too, as of a ROS controller.

    Args:
        hint: annotation of what is wanted.
        where: full name of the mapping on the parameter server.
        default: where the key is absent, or null; needed if there is none.

    Raises:
        fault: it is missing, or of another kind.
    """
    place = f"parameter {where}/{key}"
    if values.get(key) is not None:
        return convert(values[key], hint, place, fault)
    if default is _MISSING:
        raise fault(f"{place} is missing, must be {describe_hint(hint)}")
    return default


def describe_unknown_key(
    where: str,
    key: Any,
    known_keys: Iterable[str],
    renamed: Mapping[str, str] = types.MappingProxyType({}),
) -> str:
    """Return the message for an unknown key: its new name after a renaming, or a similar key.

    renamed: new names by old name; a settings class declares them as `renamed_keys`.
    """
    head, colon, path = join_path(where, key).rpartition(": ")
    kind = path if path.startswith("parameter ") else f"key '{path}'"
    if key in renamed:
        return f"{head}{colon}{kind} is now called '{renamed[key]}'"
    return f"{head}{colon}unknown {kind}: {suggest(key, known_keys)}"


@functools.lru_cache(maxsize=64)
def list_annotations(cls: type) -> dict[str, Any]:
    """Of a dataclass's fields, by name."""
    return typing.get_type_hints(cls)


@functools.lru_cache(maxsize=64)
def _list_fields(cls: type) -> dict[str, dataclasses.Field]:
    return {
        field.name: field
        for field in dataclasses.fields(cls)
        if field.init and not field.metadata.get("internal")
    }


@functools.lru_cache(maxsize=64)
def _find_shorthand(cls: type) -> str:
    """The field for which a value stands that is no mapping; '': there is none."""
    names = (name for name, field in _list_fields(cls).items() if field.metadata.get("shorthand"))
    return next(names, "")


def _is_required(field: dataclasses.Field) -> bool:
    return field.default is field.default_factory is dataclasses.MISSING


def convert(
    value: Any, hint: Any, where: str, fault: Fault, rules: Mapping[str, Any] = NO_RULES
) -> Any:
    """The value as the annotation wants it, within the rules of `parameter`.

    Raises:
        fault: it cannot be.
    """
    value = convert_to_file_types(value)
    if rules.get("name") and type(value) is int:
        value = str(value)
    if rules.get("importable") and isinstance(value, type):
        if "<locals>" in value.__qualname__:
            raise fault(
                f"{where} is {format_value(value)}, which cannot be imported: define the class at "
                "the top level of a module"
            )
        value = f"{value.__module__}:{value.__qualname__}"
    if rules.get("splits_words") and isinstance(value, str):
        value = value.split()
    found = _convert(value, hint, where, fault, rules)
    if not dataclasses.is_dataclass(found):
        check_value(found, where, fault, rules)
    return found


def _convert(
    value: Any, hint: Any, where: str, fault: Fault, rules: Mapping[str, Any] = NO_RULES
) -> Any:
    origin = typing.get_origin(hint) or hint
    if origin in (typing.Union, types.UnionType):
        return _convert_union(value, hint, where, fault, rules)
    if origin is Any:
        return value
    if dataclasses.is_dataclass(hint):
        return value if isinstance(value, hint) else build(hint, value, where, fault)
    if origin is tuple:
        return _convert_tuple(value, hint, where, fault, rules)
    if _is_kind(hint, Mapping):
        return _convert_mapping(value, hint, where, fault)
    if hint is float:
        found = as_number(value, bool(rules.get("infinite")))
    elif hint is Path:
        found = Path(value) if isinstance(value, str | Path) else None
    elif hint is int:
        fits = isinstance(value, numbers.Integral) and as_number(value) is not None
        found = int(value) if fits else None
    else:  # bool, str and None are taken as they are
        found = value if isinstance(value, hint) else None
    if found is None and hint is not type(None) or hint is type(None) and value is not None:
        words = (
            "a number, or .inf" if hint is float and rules.get("infinite") else describe_hint(hint)
        )
        if hint is str and rules.get("choices"):
            words = "one of " + ", ".join(rules["choices"])
        raise fault(f"{where} is {format_value(value)}, must be {rules.get('expected') or words}")
    return found


def _convert_union(
    value: Any, hint: Any, where: str, fault: Fault, rules: Mapping[str, Any]
) -> Any:
    kinds = typing.get_args(hint)
    if isinstance(value, Mapping):
        # A mapping was meant for the class whose keys are like its own: that one may complain.
        classes = [kind for kind in kinds if dataclasses.is_dataclass(kind)]
        if classes:
            return build(
                max(classes, key=lambda cls: _count_known_keys(value, cls)), value, where, fault
            )
    wanted = Mapping if isinstance(value, Mapping) else tuple
    alike = [kind for kind in kinds if _is_kind(kind, wanted)]
    if isinstance(value, Mapping | list | tuple) and len(alike) == 1:  # may complain likewise
        return _convert(value, alike[0], where, fault, rules)
    for kind in kinds:
        with contextlib.suppress(fault):
            return _convert(value, kind, where, fault)
    raise fault(
        f"{where} is {format_value(value)}, must be {rules.get('expected') or describe_hint(hint)}"
    )


def _is_kind(hint: Any, kind: type) -> bool:
    origin = typing.get_origin(hint) or hint
    return isinstance(origin, type) and issubclass(origin, kind)


def _count_known_keys(values: Mapping, cls: type) -> int:
    """How many of the keys are a field of the class, or near to one."""
    known = _list_fields(cls)
    return sum(key in known or bool(find_nearest(key, known)) for key in values)


def _convert_tuple(
    value: Any, hint: Any, where: str, fault: Fault, rules: Mapping[str, Any]
) -> tuple:
    parts = typing.get_args(hint) or (Any, ...)
    items = value
    if isinstance(value, str) and parts[0] is float:
        items = [parse_word(word) for word in value.split()]
    if parts[-1] is Ellipsis and isinstance(items, list | tuple):
        parts = (parts[0],) * len(items)
    if not isinstance(items, list | tuple) or len(items) != len(parts):
        raise fault(
            f"{where} is {format_value(value)}, must be "
            f"{rules.get('expected') or describe_hint(hint)}"
        )
    return tuple(
        _convert(item, part, f"{where}[{i}]", fault)
        for i, (item, part) in enumerate(zip(items, parts, strict=True))
    )


def _convert_mapping(value: Any, hint: Any, where: str, fault: Fault) -> Mapping[str, Any]:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        value = to_mapping(value)
    if not isinstance(value, Mapping):
        raise fault(f"{where.rstrip(': ')} is {format_value(value)}, must be {describe_hint(hint)}")
    kind = (typing.get_args(hint) or (str, Any))[1]
    found = {}
    for key, item in value.items():
        name = str(key) if type(key) is int else key
        if not isinstance(name, str):
            raise fault(f"{where} has the key {format_value(key)}, must be a text")
        found[name] = item if kind is Any else _convert(item, kind, join_path(where, name), fault)
    return _make_view(found)


def check(settings: Any, fault: Fault, where: str = "") -> None:
    """Convert and check the fields of a dataclass, however it was made; defaults are right.

    Raises:
        fault: naming the field, its value and what is wanted.
    """
    hints = list_annotations(type(settings))
    for name, field in _list_fields(type(settings)).items():
        value = getattr(settings, name)
        if value is field.default:
            continue
        found = convert(value, hints[name], join_path(where, name), fault, field.metadata)
        if found is not value:
            object.__setattr__(settings, name, found)  # it may be frozen


def to_mapping(settings: Any) -> dict[str, Any]:
    """The fields of a dataclass that differ from their defaults, as `build` takes them."""
    found = {}
    for name, field in _list_fields(type(settings)).items():
        value = getattr(settings, name)
        if _is_required(field) or value != get_default(field):
            found[name] = _to_plain(value)
    return found


def _to_plain(value: Any) -> Any:
    """Lists, numbers, texts and mappings of a field's value."""
    if dataclasses.is_dataclass(value):
        return to_mapping(value)
    if isinstance(value, Mapping):
        return {key: _to_plain(item) for key, item in value.items()}
    return list(map(_to_plain, value)) if isinstance(value, tuple) else value


class KeywordSettings:
    """Base of settings that users construct: wrong keywords are refused as a file's keys are.

    Attributes:
        fault: exception class to raise.
    """

    fault: Fault = ValueError

    def __new__(cls, *values: Any, **named: Any) -> KeywordSettings:
        """Refuse positional arguments and unknown keywords; `__init__` takes the rest."""
        known = _list_fields(cls)
        if values:
            example = next(iter(known))
            raise cls.fault(
                f"{cls.__name__}({format_value(values[0])}): give values by name, as in "
                f"{cls.__name__}({example}=...)"
            )
        for key in named:
            if key not in known:
                renamed = getattr(cls, "renamed_keys", {})
                raise cls.fault(describe_unknown_key("", key, known, renamed))
        return super().__new__(cls)


def check_bounds(settings: Any, fault: Fault) -> None:
    """Check the bounds of a dataclass whose values have been converted already, to arrays, say.

    Raises:
        fault: naming the field, its value and the bound.
    """
    for name, field in _list_fields(type(settings)).items():
        check_value(getattr(settings, name), name, fault, field.metadata)


def _describe_type(cls: type, field: dataclasses.Field) -> str:
    return field.metadata.get("expected") or describe_hint(list_annotations(cls)[field.name])
