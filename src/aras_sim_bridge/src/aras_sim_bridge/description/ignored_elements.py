"""Search for the elements of a description that the simulator ignores."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from xml.etree.ElementTree import Element

from aras_sim_bridge.description.supported_elements import (
    BLOCKS,
    GEOMETRY,
    JOINTS,
    SDF_JOINT,
    SENSORS,
    SINGLE_BLOCKS,
    SUPPORTED,
    Entry,
)
from aras_visual_servo_base.safe_xml import shorten


def describe_ignored_elements(element: Element, block: str, where: str) -> list[str]:
    """Return one sentence for each unsupported element in `element`, whose kind is `block`.

    If several places have the same unsupported element, one sentence reports them. Tags of other
    programs ("program:tag") are not reported.

    Args:
        where: name of the element in messages; '' if messages need only the names of its children.
    """
    return format_sentences(find_ignored_elements(element, block, where))


def find_ignored_elements(element: Element, block: str, where: str) -> list[tuple[str, str]]:
    """Return (place, tag) of each unsupported element in a block, in file order."""
    found: list[tuple[str, str]] = []
    _collect(element, BLOCKS[block], where, found)
    return list(dict.fromkeys(found))


def format_sentences(elements: Iterable[tuple[str, str]]) -> list[str]:
    """Return sentences that report ignored elements, given as (place, tag).

    Tags that are ignored in the same places are reported in one sentence.
    """
    places: dict[str, list[str]] = {}
    for place, tag in elements:
        places.setdefault(tag, []).append(place)
    tags: dict[tuple[str, ...], list[str]] = {}
    for tag, where in places.items():
        tags.setdefault(tuple(where), []).append(tag)
    return [f"{where[0]}{f' and {len(where) - 1} more' if len(where) > 1 else ''}: "
            + (f"{names[0]} is ignored, because it is not supported" if len(names) == 1 else
               f"{', '.join(names)} are ignored, because they are not supported")
            for where, names in tags.items()]


def _collect(element: Element, entry: Mapping[str, Entry], where: str,
             elements: list[tuple[str, str]], is_single: bool = False) -> None:
    """Add (place, tag) of the unsupported elements in `element`, whose entry is `entry`.

    `is_single` is True inside a block of SINGLE_BLOCKS.
    """
    for child in element:
        if not isinstance(child.tag, str) or ":" in child.tag:
            continue
        inside = entry.get(child.tag)
        if inside is SENSORS:
            # An unsupported type of sensor is not reported here, but by the reader of sensors.
            inside = SENSORS.get(child.get("type") or "", SUPPORTED)
        if inside is SDF_JOINT:
            inside = JOINTS.get(child.get("type") or "", SDF_JOINT)
        if inside is None and entry is GEOMETRY:
            continue
        name = f" '{shorten(child.get('name'))}'" if child.get("name") else ""
        if inside is None or isinstance(inside, tuple) and not _has_value(child, inside, element):
            elements.append((where, f"<{shorten(child.tag)}>{name}"))
        elif isinstance(inside, Mapping):
            single = is_single or any(inside is one for one in SINGLE_BLOCKS)
            label = f"{child.tag}{name}" if name or single else ""
            _collect(child, inside, ", ".join(filter(None, (where, label))), elements, single)


def _has_value(element: Element, values: tuple, block: Element) -> bool:
    """Return whether an element's value is one of `values`, see supported_elements.py."""
    text = _read_value(element)
    for value in map(str, values):
        sibling = block.find(value) if value.isidentifier() else None
        other = value if sibling is None else _read_value(sibling)
        if text.split() == other.split():
            return True
        numbers = _parse_numbers(text)
        if numbers is not None and numbers == _parse_numbers(other):
            return True
    return False


def _read_value(element: Element) -> str:
    return (element.get("value") or element.text or "").strip().lower()


def _parse_numbers(text: str) -> list[float] | None:
    try:
        return [float(word) for word in text.split()]
    except ValueError:
        return None
