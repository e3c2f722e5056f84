"""Change the keys of an experiment by dotted paths such as `start.side`."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any

from aras_visual_servo_base.setting_values import merge
from aras_visual_servo_base.yaml_files import parse_yaml

from ..errors import StudyError
from .camera_specs import DEFAULT_PRESET
from .cameras import PRESET_KEY
from .starts import CameraPoseSpec, RandomStart, RelativeStart

CAMERAS_KEY = "cameras"
# Keys of an experiment whose values are objects of the classes in PLACE_TYPES.
PLACE_KEYS = ("start", "goal")
PLACE_TYPES = (CameraPoseSpec, RandomStart, RelativeStart)


def parse_overrides(arguments: Iterable[str]) -> dict[str, Any]:
    """Parse the overrides of a command line: `key=value`, with the value in YAML.

    Raises:
        StudyError: an argument has no '=', or its value is not valid YAML.
    """
    found = {}
    for word in arguments:
        key, equals, text = word.partition("=")
        if not (equals and key.strip()):
            raise StudyError(f"'{word}' is not an override: write key=value, as in gain=2.0")
        found[key.strip()] = parse_yaml(text, f"the value of '{key.strip()}'", StudyError)
    return found


def with_override(values: Mapping[str, Any], key: str, value: Any) -> dict[str, Any]:
    """Return a copy of an experiment's keys with the value of one dotted key changed.

    If the new value is a mapping, its keys are merged into the current value. A mapping for a
    camera that is given by the name of a preset changes settings of this preset. Two new values
    replace the current value instead: a `start` or `goal` of another type, and the mapping
    `cameras`.

    Raises:
        StudyError: a value on the path of the dotted key is not a mapping.
    """
    changes, base, path = value, dict(values), key.split(".")
    for part in reversed(path):
        changes = {part: changes}
    if key == CAMERAS_KEY or key in PLACE_KEYS and not _is_same_kind(base.get(key), value):
        base.pop(key, None)
    return merge(_expand_presets(base, changes, key), changes)


def with_overrides(values: Mapping[str, Any], settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return a copy of an experiment's keys with the values of several dotted keys changed.

    Shorter paths are applied first, for example `start` before `start.side`. Paths of equal length
    are applied in the order of `settings`.
    """
    changed = dict(values)
    for key, value in sorted(settings.items(), key=lambda item: item[0].count(".")):
        changed = with_override(changed, key, value)
    return changed


def _expand_presets(
    base: Mapping[str, Any], changes: Mapping[str, Any], key: str, above: str = ""
) -> dict[str, Any]:
    """Return `base` with the names of camera presets replaced by {'preset': name} where necessary.

    This is necessary for a camera whose settings `changes` contains, because settings can be merged
    into a mapping but not into a name.

    Args:
        base: keys and values of the experiment, or of a mapping in it.
        changes: keys and values that the caller merges into the result.
        key: the dotted key that is changed, for the error message.
        above: dotted path of `base` in the experiment, with a final dot; '' for the experiment.
    """
    found = dict(base)
    for name, value in changes.items():
        place = f"{above}{name}"
        if not isinstance(value, Mapping) or name not in found and not is_camera_key(place):
            continue
        here = found.get(name, DEFAULT_PRESET)
        if isinstance(here, str) and is_camera_key(place):
            here = {PRESET_KEY: here}
        if isinstance(here, Mapping):
            found[name] = _expand_presets(here, value, key, f"{place}.")
        elif key.startswith(f"{place}."):
            raise StudyError(
                f"'{key}' cannot be set: {place} is {here!r}, which has no keys; write {place} as "
                "a mapping"
            )
    return found


def is_camera_key(key: str) -> bool:
    """Return True if the value of a dotted key can be the name of a camera preset."""
    parts = key.split(".")
    return parts == ["camera"] or len(parts) == 3 and (parts[0], parts[2]) == ("cameras", "model")


def _is_same_kind(current: Any, value: Any) -> bool:
    """Return True if a new start or goal has the same type as the current one.

    It has the same type if the keys of both mappings belong to one class of PLACE_TYPES, and `kind`
    is not changed.
    """
    if not (isinstance(current, Mapping) and isinstance(value, Mapping)):
        return False
    if "kind" in value and value["kind"] != current.get("kind"):
        return False
    names = {*current, *value}
    return any(names <= {f.name for f in dataclasses.fields(kind)} for kind in PLACE_TYPES)
