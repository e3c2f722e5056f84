"""Expansion of Gazebo's `<include>`s and nested models into plain elements of one document.

A model folder contains the file model.config, which names the SDF file. packages.find_model finds
the folder of a model. The models ground_plane and sun, which most worlds include, are built in.
"""

from __future__ import annotations

import copy
import os
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from aras_sim_bridge.description import sdf_dialects, sdf_frames, supported_elements
from aras_sim_bridge.description.packages import MODEL_PATH, OWN_MODELS, find_model
from aras_sim_bridge.description.sdf_poses import write_pose
from aras_sim_bridge.errors import DescriptionError
from aras_visual_servo_base import safe_xml
from aras_visual_servo_base.poses import Pose
from aras_visual_servo_base.safe_xml import find_text, parse_bool, parse_number, shorten

CONFIG_FILE = "model.config"

_BUILT_IN = {
    "sun": """<light name="sun" type="directional"><pose>0 0 10 0 0 0</pose>
<diffuse>0.8 0.8 0.8 1</diffuse><specular>0.2 0.2 0.2 1</specular>
<direction>-0.4834 0.0967 -0.8701</direction>
<attenuation><range>1000</range><constant>0.9</constant>
<linear>0.01</linear><quadratic>0.001</quadratic></attenuation></light>""",
    "ground_plane": """<model name="ground_plane"><static>1</static><link name="link">
<collision name="collision">
<geometry><plane><normal>0 0 1</normal><size>100 100</size></plane></geometry>
<surface><friction><ode><mu>100</mu></ode></friction></surface></collision>
<visual name="visual">
<geometry><plane><normal>0 0 1</normal><size>100 100</size></plane></geometry>
<material><script><name>Gazebo/Grey</name></script></material></visual></link></model>""",
}


def find_folder(uri: str, base: str | None) -> str:
    """Return the folder that an `<include>`'s URI names.

    Args:
        base: folder to which relative paths are relative.

    Raises:
        DescriptionError: the scheme is not supported, or the folder does not exist.
    """
    if not uri:
        raise DescriptionError("it has no <uri>")
    scheme, separator, rest = uri.partition("://")
    if separator and scheme not in ("model", "file"):
        raise DescriptionError(f"the scheme {scheme}:// is not supported; download the model into "
                               f"{OWN_MODELS} and write model://<its folder>")
    if scheme == "model" and separator:
        name, _, inside = rest.strip("/").partition("/")
        found = find_model(name)
        path = os.path.normpath(os.path.join(found or "", inside))
        if found is None or not os.path.isdir(path) or os.path.commonpath([path, found]) != found:
            raise DescriptionError(f"the folder '{rest}' is not in {MODEL_PATH}, {OWN_MODELS}, or "
                                   "a folder that a package exports as gazebo_model_path; copy the "
                                   "model there")
        return path
    path = rest if separator else uri
    if not os.path.isabs(path) and base is not None:
        path = os.path.join(base, path)
    if not os.path.isdir(path):
        raise DescriptionError(f"there is no folder {path}")
    return path


def read_model(folder: str, warnings: list[str]) -> Element:
    """Read the model or light of a model folder; its mesh paths become absolute.

    Raises:
        DescriptionError: model.config is missing, its SDF file is missing, or this file has no
            model.
    """
    config = _parse(Path(folder) / CONFIG_FILE)
    names = [((node.text or "").strip(), parse_number(node.get("version"), CONFIG_FILE, 0.0))
             for node in config.findall("sdf")]
    if not names:
        raise DescriptionError(f"{folder}/{CONFIG_FILE} names no <sdf> file")
    file = Path(folder) / max(names, key=lambda pair: pair[1])[0]
    root = _parse(file)
    scope = root if root.find("world") is None else root.find("world")
    found = next((child for child in scope if child.tag in ("model", "light")), None)
    if found is None:
        raise DescriptionError(f"{file} has no <model> and no <light>; add one")
    sdf_dialects.unify(root, warnings)
    for uri in found.iter("uri"):
        text = (uri.text or "").strip()
        if text and "://" not in text and not os.path.isabs(text):
            uri.text = os.path.join(folder, text)
    return found


def _parse(file: Path) -> Element:
    try:
        return safe_xml.parse(file.read_text(encoding="utf-8"), str(file))
    except (OSError, UnicodeDecodeError) as error:
        raise DescriptionError(f"{file} cannot be read: {error}") from None


def expand(scope: Element, warnings: list[str], base: str | None = None,
             chain: tuple[str, ...] = ()) -> Iterator[Element]:
    """Return the elements of a world or model without includes and nested models.

    An include is replaced by the model that it names, and a nested model by its links and joints.

    An include that cannot be resolved is omitted, with a sentence in `warnings`.

    Args:
        base: folder to which relative paths are relative.
        chain: folders that are being read, to detect recursive includes.
    """
    for child in scope:
        if child.tag == "include":
            uri = find_text(child, "uri") or ""
            try:
                yield _include(child, uri, warnings, base, chain)
            except DescriptionError as error:
                warnings.append(f"<include> of '{shorten(uri)}' is ignored: {error}")
        elif child.tag == "model":
            try:
                yield _flatten(child, warnings, base, chain)
            except DescriptionError as error:
                warnings.append(f"model '{shorten(child.get('name') or '')}' is ignored: {error}")
        elif child.tag == "population":
            whole = Element(child.tag, child.attrib)
            whole.extend(expand(child, warnings, base, chain))
            yield whole
        else:
            yield child


def _include(include: Element, uri: str, warnings: list[str], base: str | None,
              chain: tuple[str, ...]) -> Element:
    name = uri.strip().removeprefix("model://").strip("/")
    if name in _BUILT_IN:
        found, folder = ElementTree.fromstring(_BUILT_IN[name]), None
    else:
        folder = os.path.realpath(find_folder(uri.strip(), base))
        if folder in chain:
            round_trip = [os.path.basename(one) for one in (*chain[chain.index(folder):], folder)]
            raise DescriptionError(f"it includes itself: {' → '.join(round_trip)}; remove one "
                                   "of these includes")
        found = read_model(folder, warnings)
    name = find_text(include, "name") or found.get("name") or ""
    found.set("name", name)
    where = f"<include> of '{shorten(name)}'"
    warnings += supported_elements.describe_ignored_elements(include, "include", where)
    if parse_bool(include.get("merge"), f"{where}: merge", False):
        warnings.append(f"{where}: merge is not supported, so the model's name precedes the names "
                        "of the included links")
    if find_text(include, "placement_frame"):
        found.set("placement_frame", find_text(include, "placement_frame"))
    found.extend(include.findall("plugin"))
    for tag in ("pose", "static"):
        given = include.find(tag)
        if given is not None:
            for old in found.findall(tag):
                found.remove(old)
            found.append(given)
    if found.tag == "light" or folder is None:
        return found
    return _flatten(found, warnings, folder, (*chain, folder))


def _flatten(model: Element, warnings: list[str], base: str | None,
          chain: tuple[str, ...]) -> Element:
    """Return a model with the links and joints of its nested models, renamed to inner::name."""
    if model.find("model") is None and model.find("include") is None:
        sdf_frames.resolve_poses(model, warnings)
        return model
    whole = Element("model", model.attrib)
    whole.extend(expand(model, warnings, base, chain))
    sdf_frames.resolve_poses(whole, warnings)
    flat = Element("model", whole.attrib)
    for child in whole:
        if child.tag != "model":
            flat.append(child)
            continue
        inner = child.get("name") or ""
        at = _read_pose(child, inner)
        for part in copy.deepcopy(child):
            if part.tag in ("link", "frame"):
                write_pose(part, at @ _read_pose(part, inner))
                part.set("name", f"{inner}::{part.get('name')}")
                if part.get("attached_to"):
                    part.set("attached_to", f"{inner}::{part.get('attached_to')}")
            elif part.tag == "joint":
                part.set("name", f"{inner}::{part.get('name')}")
                _place_axes(part, at, inner)
                for end in (part.find("parent"), part.find("child")):
                    if end is not None and (end.text or "").strip() != "world":
                        end.text = f"{inner}::{(end.text or '').strip()}"
            elif part.tag != "plugin":
                continue
            flat.append(part)
    return flat


def _place_axes(joint: Element, pose: Pose, inner: str) -> None:
    """Convert a joint's axes from the model `inner` to the enclosing model.

    `pose` is the pose of the inner model in the enclosing model.
    """
    for axis in (*joint.findall("axis/xyz"), *joint.findall("axis2/xyz")):
        frame = axis.get("expressed_in")
        if frame == sdf_dialects.MODEL_FRAME:
            sdf_dialects.rotate_axis(axis, pose, joint)
        elif frame:
            axis.set("expressed_in", f"{inner}::{frame}")


def _read_pose(element: Element, model: str) -> Pose:
    return safe_xml.parse_pose(find_text(element, "pose"), f"model '{shorten(model)}': pose")
