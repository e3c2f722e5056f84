"""Settings as dataclasses, read from YAML files, ROS parameters, launch arguments and overrides.

The annotation of a field defines the type of its value. Its metadata (see `parameter`) define the
bounds. Supported annotations are float, int, bool, str, Path, Any, None, tuples (of fixed length,
or `tuple[float, ...]`), Mapping, other dataclasses, and unions of these, such as `float | None`.
For a union, the types are tried in the order of the annotation.

- Numbers must be finite. A whole number is also a float; true and false are not numbers. Numbers
  that YAML 1.1 reads as texts, such as 1e1 and -.5, are accepted as floats.
- A value of the type int must be written without a decimal point and without an exponent. 10.0 and
  1e1 are errors.
- A list of floats may be given as a text, as in a launch argument: '0 0 0.05'.
- In Python, values may also be NumPy arrays, NumPy numbers, `range` objects or paths.
- Keys are texts. A key that is a whole number is converted to a text.

An error message has one line. It names the full path of the key, its value, and what is expected,
or the most similar known name. The caller chooses the class of the exception, `fault`.
"""

from __future__ import annotations

import contextlib
import copyreg
import dataclasses
import numbers
import types
import typing
from collections.abc import Iterable, Mapping
from math import isfinite
from pathlib import Path
from types import NoneType
from typing import Any, TypeVar

from .names import find_nearest
from .setting_values import (
    NOTHING,
    Fault,
    as_number,
    check_value,
    convert_to_file_types,
    describe_expected,
    describe_mismatch,
    describe_unknown_key,
    find_below,
    format_value,
    join_path,
    list_annotations,
    list_fields,
    parse_word,
)

T = TypeVar("T")


def _make_view(values: dict[str, Any]) -> types.MappingProxyType:
    return types.MappingProxyType(values)


# Python cannot pickle read-only views of mappings, but settings are sent to other processes.
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
    renamed: Mapping[str, str] = NOTHING,
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
        default: default value; if there is none, the setting is required.
        unit: unit of the value, for messages and tables, such as 'm' or '1/s'.
        least, above, most, below: bounds of a number, or of each number in a list or mapping: >=,
            >, <=, <.
        choices: valid texts.
        renamed: mapping from old names of choices to their new names, for error messages.
        expected: description of valid values, for messages; '' to derive it from the annotation.
        name: True if the value is a name (a text), so that a whole number is converted to a text.
            For example, roslaunch reads start:=2016 as a number.
        splits_words: True if a text is converted to the list of its words.
        infinite: whether infinity is valid.
        internal: True if users cannot set the field.
        shorthand: whether users may give the value of this field instead of a mapping with the
            values of all fields.
        importable: True if a class is converted to the text 'package.module:Class'.
        help: description of the setting, for tables and --help.
    """
    rules = {
        "unit": unit, "least": least, "above": above, "most": most, "below": below,
        "choices": tuple(choices), "renamed": dict(renamed), "expected": expected, "name": name,
        "splits_words": splits_words, "infinite": infinite, "internal": internal,
        "shorthand": shorthand, "importable": importable, "help": help,
    }  # fmt: skip
    if isinstance(default, dict):
        return dataclasses.field(default_factory=lambda: dict(default), metadata=rules)
    return dataclasses.field(default=default, metadata=rules)


def get_default(field: dataclasses.Field) -> Any:
    """Return the default of a field; `dataclasses.MISSING` for a required field."""
    if field.default_factory is not dataclasses.MISSING:
        return field.default_factory()
    return field.default


def list_defaults(cls: type) -> dict[str, Any]:
    """Return the defaults of all fields that have one and that users can set."""
    defaults = {name: get_default(field) for name, field in list_fields(cls).items()}
    return {name: value for name, value in defaults.items() if value is not dataclasses.MISSING}


def build(cls: type[T], values: Any, where: str, fault: Fault) -> T:
    """Create a dataclass from a mapping.

    Args:
        where: start of the names of keys in messages, such as 'start' or 'goal.yaml: '.

    Raises:
        fault: a key is unknown or missing, a value is invalid, or the class rejects the values.
    """
    fields = list_fields(cls)
    if values is not None and not isinstance(values, Mapping):
        short = [name for name, field in fields.items() if field.metadata.get("shorthand")]
        values = {short[0]: values} if short else values
    found = convert_fields(cls, values, where, fault)
    for name, field in fields.items():
        if name not in found and get_default(field) is dataclasses.MISSING:
            expected = describe_expected(list_annotations(cls)[name], field.metadata)
            raise fault(f"{join_path(where, name)} is missing: give {expected}")
    return cls(**found)


def convert_fields(cls: type, values: Any, where: str, fault: Fault) -> dict[str, Any]:
    """Convert the values of a mapping to the types of a dataclass's fields.

    It raises the errors of `build`, except those for missing keys.
    """
    if not isinstance(values, Mapping):
        place = where.rstrip(": ~") or cls.__name__
        raise fault(f"{place} is {format_value(values)}, must be a mapping")
    _check_keys(cls, values, where, fault)
    fields, hints = list_fields(cls), list_annotations(cls)
    return {
        key: convert(value, hints[key], join_path(where, key), fault, fields[key].metadata)
        for key, value in values.items()
    }


def _check_keys(cls: type, keys: Iterable[str], where: str, fault: Fault) -> None:
    known = list_fields(cls)
    for key in keys:
        if key not in known:
            renamed = getattr(cls, "renamed_keys", NOTHING)
            raise fault(describe_unknown_key(where, key, known, renamed, find_below(cls, key)))


def read(
    values: Mapping[str, Any], key: str, hint: Any, where: str, fault: Fault,
    default: Any = dataclasses.MISSING,
) -> Any:  # fmt: skip
    """Return one value from a mapping, for example from a ROS controller's parameters.

    The mapping may contain unrelated keys.

    Args:
        hint: annotation of the expected type.
        where: full name of the mapping on the parameter server.
        default: value that is returned if the key is missing or null; if there is no default, the
            key is required.

    Raises:
        fault: the value is missing or has another type.
    """
    place = f"parameter {where}/{key}"
    if values.get(key) is not None:
        return convert(values[key], hint, place, fault)
    if default is dataclasses.MISSING:
        raise fault(f"{place} is missing: give {describe_expected(hint)}")
    return default


def convert(
    value: Any, hint: Any, where: str, fault: Fault, rules: Mapping[str, Any] = NOTHING
) -> Any:
    """Convert a value to the type of an annotation, and check it.

    `rules` are those that `parameter` declares.

    Raises:
        fault: the value cannot be converted or violates a rule.
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
    value: Any, hint: Any, where: str, fault: Fault, rules: Mapping[str, Any] = NOTHING
) -> Any:
    if type(value) is hint and (hint in (str, bool, NoneType) or hint is float and isfinite(value)):
        return value  # no conversion is necessary; this is the most frequent case
    origin = typing.get_origin(hint) or hint
    if origin in (typing.Union, types.UnionType):
        return _convert_union(value, hint, where, fault, rules)
    if origin is Any:
        return value
    if dataclasses.is_dataclass(hint):
        return value if isinstance(value, hint) else build(hint, value, where, fault)
    if origin is tuple:
        return _convert_tuple(value, hint, where, fault, rules)
    if origin is Mapping:
        return _convert_mapping(value, hint, where, fault)
    found = None
    if hint is float:
        found = as_number(value, bool(rules.get("infinite")))
    elif hint is Path:
        found = Path(value) if isinstance(value, str | Path) else None
    elif hint is int:
        fits = isinstance(value, numbers.Integral) and as_number(value) is not None
        found = int(value) if fits else None
    elif isinstance(value, hint):  # accept only a value of this type, without conversion
        found = value
    if found is None:
        raise fault(describe_mismatch(value, hint, where, rules))
    return found


def _convert_union(
    value: Any, hint: Any, where: str, fault: Fault, rules: Mapping[str, Any]
) -> Any:
    kinds = typing.get_args(hint)
    classes = [kind for kind in kinds if dataclasses.is_dataclass(kind)]
    if classes and isinstance(value, Mapping):
        # Choose the class with the most equal or similar keys, because the user probably means this
        # class.
        def count_known_keys(cls: type) -> int:
            return sum(key in list_fields(cls) or find_nearest(key, list_fields(cls)) != ""
                       for key in value)  # fmt: skip

        known = [cls for cls in classes if value.keys() <= list_fields(cls).keys()]
        return build(known[0] if known else max(classes, key=count_known_keys), value, where, fault)
    # If the value is a mapping (or a sequence), and only one type of the union is a mapping (or a
    # tuple), convert the value to this type. The error message then names the invalid item.
    if isinstance(value, Mapping | list | tuple):
        expected = Mapping if isinstance(value, Mapping) else tuple
        alike = [kind for kind in kinds if expected in (kind, typing.get_origin(kind))]
        if len(alike) == 1:
            return _convert(value, alike[0], where, fault, rules)
    for kind in kinds:
        with contextlib.suppress(fault):
            return _convert(value, kind, where, fault)
    raise fault(describe_mismatch(value, hint, where, rules))


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
        raise fault(describe_mismatch(value, hint, where, rules))
    if set(parts) == set(map(type, items)) == {float} and all(map(isfinite, items)):
        return tuple(items)
    return tuple([
        _convert(item, part, f"{where}[{i}]", fault)
        for i, (item, part) in enumerate(zip(items, parts, strict=True))
    ])  # fmt: skip


def _convert_mapping(value: Any, hint: Any, where: str, fault: Fault) -> Mapping[str, Any]:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        value = to_mapping(value)
    if not isinstance(value, Mapping):
        raise fault(describe_mismatch(value, hint, where.rstrip(": ")))
    kind = (typing.get_args(hint) or (str, Any))[1]
    found = {}
    for key, item in value.items():
        name = str(key) if type(key) is int else key
        if not isinstance(name, str):
            raise fault(f"{where} has the key {format_value(key)}; write all keys as texts")
        found[name] = item if kind is Any else _convert(item, kind, join_path(where, name), fault)
    return types.MappingProxyType(found)


def check(settings: Any, fault: Fault, where: str = "") -> None:
    """Convert and check those fields of a dataclass instance that differ from their defaults.

    Raises:
        fault: a value is invalid; the message names the field, its value and what is expected.
    """
    hints = list_annotations(type(settings))
    for name, field in list_fields(type(settings)).items():
        value = getattr(settings, name)
        if value is field.default:
            continue
        found = convert(value, hints[name], join_path(where, name), fault, field.metadata)
        if found is not value:
            # A frozen dataclass allows no other assignment.
            object.__setattr__(settings, name, found)


def to_mapping(settings: Any) -> dict[str, Any]:
    """Return a mapping of those fields that differ from their defaults, as input for `build`."""
    found = {}
    for name, field in list_fields(type(settings)).items():
        value = getattr(settings, name)
        if value != get_default(field):
            found[name] = _to_plain(value)
    return found


def _to_plain(value: Any) -> Any:
    """Convert the value of a field to lists, numbers, texts and mappings."""
    if dataclasses.is_dataclass(value):
        return to_mapping(value)
    if isinstance(value, Mapping):
        return {key: _to_plain(item) for key, item in value.items()}
    return list(map(_to_plain, value)) if isinstance(value, tuple) else value


class SettingsBase:
    """Base class of settings that users construct in Python.

    Wrong keywords raise the same errors as wrong keys in a file.

    Attributes:
        fault: class of the exceptions to raise.
    """

    fault: Fault = ValueError

    def __new__(cls, *values: Any, **named: Any) -> SettingsBase:
        """Reject positional arguments and unknown keywords. `__init__` checks the values."""
        if values:
            example = next(iter(list_fields(cls)))
            raise cls.fault(
                f"{cls.__name__}({format_value(values[0])}): give values by name, as in "
                f"{cls.__name__}({example}=...)"
            )
        _check_keys(cls, named, "", cls.fault)
        return super().__new__(cls)


def check_bounds(settings: Any, fault: Fault) -> None:
    """Check the bounds of a dataclass instance without converting its values.

    Use it if the values have already been converted, for example to arrays.

    Raises:
        fault: a value is out of bounds; the message names the field, its value and the bound.
    """
    for name, field in list_fields(type(settings)).items():
        check_value(getattr(settings, name), name, fault, field.metadata)
