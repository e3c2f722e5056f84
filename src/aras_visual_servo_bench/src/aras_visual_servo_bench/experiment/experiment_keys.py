"""Dotted keys of an experiment: check that a key exists, and find its unit."""

from __future__ import annotations

import dataclasses
import types
import typing
from collections.abc import Mapping
from typing import Any

from aras_visual_servo_base.names import suggest
from aras_visual_servo_base.setting_values import list_annotations
from aras_visual_servo_controller.settings import ControllerSettings

from ..errors import StudyError
from .experiment import Experiment


def find_unit(key: str) -> str:
    """Return the unit of the value of a dotted key, such as `start.side`.

    Return '' if the value has no unit or the key does not exist. Also return '' if the unit depends
    on other settings: `start.turn` is in rad or in degrees, depending on the type of the start.
    """
    head, _, rest = key.partition(".")
    kind, path = (
        (ControllerSettings, rest)
        if head == "controller_parameters" and rest
        else (Experiment, key)
    )
    try:
        found = _find_fields(path, kind)
    # A study can give its list of cases any name, so `key` may be this name and not a setting.
    except StudyError:
        return ""
    units = {field.metadata.get("unit", "") for field in found}
    return units.pop().partition(", the")[0].replace(", ", " or ") if len(units) == 1 else ""


def check_key(key: str) -> None:
    """Check that an experiment has this dotted key.

    Raises:
        StudyError: there is no such key; the message suggests the most similar one.
    """
    _find_fields(key, Experiment)


def _find_fields(key: str, kind: type) -> list[dataclasses.Field]:
    """Return the fields of dataclass `kind` that a dotted key can refer to.

    There are several if a value on the path can have several types, such as types of starts. There
    are none if the key is below a mapping that accepts any keys, such as `controller_parameters`.
    """
    kinds: tuple[type, ...] = (kind,)
    so_far = ""
    for part in key.split("."):
        known = [f for kind in kinds for f in dataclasses.fields(kind)]
        found = [f for f in known if f.name == part]
        if not found:
            renamed = {old: new for kind in kinds
                       for old, new in getattr(kind, "renamed_keys", {}).items()}  # fmt: skip
            if part in renamed:
                raise StudyError(f"key '{so_far}{part}' is now called '{so_far}{renamed[part]}'")
            near = suggest(part, [f.name for f in known]).replace("'", "")
            remedy = near.replace("did you mean ", f"did you mean {so_far}")
            raise StudyError(f"an experiment has no '{key}': {remedy}")
        so_far += f"{part}."
        hints = [list_annotations(kind) for kind in kinds]
        hint = next(h[part] for h in hints if part in h)
        is_union = typing.get_origin(hint) in (typing.Union, types.UnionType)
        options = typing.get_args(hint) if is_union else (hint,)
        if any(_has_free_keys(option) for option in options):
            # A key below this mapping is not checked here; the code that reads the mapping checks
            # it.
            return found if so_far == f"{key}." else []
        kinds = tuple(option for option in options if dataclasses.is_dataclass(option))
        if not kinds and so_far != f"{key}.":
            raise StudyError(f"an experiment has no '{key}': {so_far[:-1]} has no keys below it; "
                             f"set {so_far[:-1]} itself")
    return found


def _has_free_keys(hint: Any) -> bool:
    origin = typing.get_origin(hint)
    return isinstance(origin, type) and issubclass(origin, Mapping)
