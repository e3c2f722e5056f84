"""Keys of an experiment by dotted paths: `gain`, `start.side`,
`controller_parameters.max_velocity`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any

from aras_visual_servo_base.setting_values import merge
from aras_visual_servo_base.yaml_files import parse_yaml

from ..errors import StudyError
from .cameras import DEFAULT_PRESET, PRESET_KEY
from .starts import CameraPose, RelativeStart, Sampler

CAMERAS_KEY = "cameras"
PLACE_KEYS = ("start", "goal")  # keys of an experiment whose values are of several kinds
PLACE_TYPES = (CameraPose, Sampler, RelativeStart)


def parse_overrides(arguments: Iterable[str]) -> dict[str, Any]:
    """Overrides as they are written on a command line, `key=value`, the value being YAML.

    Raises:
        StudyError: a word without '=', or a value that is no YAML.
    """
    found = {}
    for word in arguments:
        key, equals, text = word.partition("=")
        if not (equals and key.strip()):
            raise StudyError(f"'{word}' is no override: write key=value, as in gain=2.0")
        found[key.strip()] = parse_yaml(text, f"the value of '{key.strip()}'", StudyError)
    return found


def with_override(values: Mapping[str, Any], key: str, value: Any) -> dict[str, Any]:
    """A copy of an experiment's keys with the value laid over them under a dotted key.

    Nothing else changes: a value that has keys itself is laid over those that are there, and a key
    below `camera` or a camera's `model` over the preset that these name. `start` and `goal` are
    values of several kinds: keys of another kind replace them. So do other `cameras`, whose names
    say which there are.

    Raises:
        StudyError: on the way is something that has no keys.
    """
    changes, base, path = value, dict(values), key.split(".")
    for part in reversed(path):
        changes = {part: changes}
    if key == CAMERAS_KEY or key in PLACE_KEYS and not _is_same_kind(base.get(key), value):
        base.pop(key, None)
    return merge(_expand_presets(base, changes, key), changes)


def with_overrides(values: Mapping[str, Any], settings: Mapping[str, Any]) -> dict[str, Any]:
    """The same with several, by dotted key: wholes before their parts, else in their order."""
    changed = dict(values)
    for key, value in sorted(settings.items(), key=lambda item: item[0].count(".")):
        changed = with_override(changed, key, value)
    return changed


def _expand_presets(
    base: Mapping[str, Any], changes: Mapping[str, Any], key: str, above: str = ""
) -> dict[str, Any]:
    """The base, with the presets that it names below `changes` written as keys."""
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
                "keys with values"
            )
    return found


def is_camera_key(key: str) -> bool:
    """Whether under this dotted key of an experiment the name of a preset may be written."""
    parts = key.split(".")
    return parts == ["camera"] or len(parts) == 3 and (parts[0], parts[2]) == ("cameras", "model")


def _is_same_kind(current: Any, value: Any) -> bool:
    """Whether keys of a start or a goal can be of one kind with those that are there."""
    if not (isinstance(current, Mapping) and isinstance(value, Mapping)):
        return False
    if "kind" in value and value["kind"] != current.get("kind"):
        return False
    names = {*current, *value}
    return any(names <= {f.name for f in dataclasses.fields(kind)} for kind in PLACE_TYPES)
