"""SDF of all versions, and what Gazebo's parser forgives, as one form for the readers after it."""

from __future__ import annotations

import contextlib
import math
import re
from xml.etree.ElementTree import Element

from aras_sim_bridge.errors import DescriptionError
from aras_visual_servo_base.poses import Pose
from aras_visual_servo_base.safe_xml import parse_bool, parse_number, parse_numbers, shorten

MODEL_FRAME = "__model__"
_FLAGS = {"static", "kinematic", "self_collide", "use_parent_model_frame", "allow_auto_disable",
          "must_be_base_link", "enable_wind", "scale_to_hfov", "cast_shadows"}
_BOOLEAN_WORDS = {"yes": "true", "on": "true", "no": "false", "off": "false"}
_NAMED_TAGS = ("world", "model", "link", "joint", "visual", "collision", "sensor", "light")


def unify(root: Element, warnings: list[str]) -> None:
    """Rewrite an SDF document, or an element of one, in place; each repair is a sentence.

    Poses become six numbers: three are a position, and SDF 1.9's degrees and quaternions are
    converted. Flags become true or false. The frame of a joint's axis stands in `expressed_in`:
    the model's up to SDF 1.4 and with `<use_parent_model_frame>`.
    """
    _unify(root, _read_version(root) < (1, 5), "", warnings)


def _read_version(root: Element) -> tuple[int, ...]:
    """The version that the root names; one that names none is read as the newest."""
    found = re.match(r"\s*(\d+)\.(\d+)", root.get("version") or "")
    return (99,) if found is None else tuple(map(int, found.groups()))


def _unify(element: Element, old: bool, where: str, warnings: list[str]) -> None:
    """old: whether axes are in the model's frame unless they say otherwise."""
    if element.tag in _NAMED_TAGS and element.get("name"):
        own = f"{element.tag} '{shorten(element.get('name'))}'"
        where = f"{where}, {own}" if where and not where.startswith("world") else own
    for child in list(element):
        if child.tag == "pose":
            _unify_pose(child, f"{where or 'SDF'}: pose", warnings)
        elif child.tag in _FLAGS or child.tag == "gravity" and element.tag == "link":
            if not _unify_flag(child, f"{where or 'SDF'}: {child.tag}", warnings):
                element.remove(child)
        else:
            _unify(child, old, where, warnings)
    if element.tag in ("axis", "axis2"):
        flag, xyz = element.find("use_parent_model_frame"), element.find("xyz")
        if flag is not None:
            element.remove(flag)
        in_model = old if flag is None else parse_bool(flag.text, "use_parent_model_frame", False)
        if in_model and xyz is not None:
            xyz.set("expressed_in", MODEL_FRAME)


def _unify_pose(pose: Element, where: str, warnings: list[str]) -> None:
    words = (pose.text or "").split()
    if len(words) == 3:
        warnings.append(f"{where} '{' '.join(map(shorten, words))}' has three numbers, read as a "
                        "position without rotation; write six: x y z roll pitch yaw")
        words += ["0"] * 3
    with contextlib.suppress(DescriptionError):  # what is no number is named where it is read
        if len(words) == 7 and pose.get("rotation_format") == "quat_xyzw":
            given = parse_numbers(pose.text, 7, where)
            length = math.hypot(*given[3:]) or 1.0
            at = Pose(given[:3], tuple(part / length for part in given[3:]))
            words = list(map(repr, (*at.xyz, *at.rpy)))
        elif len(words) == 6 and pose.get("degrees") in ("true", "1"):
            words[3:] = [repr(math.radians(parse_number(word, where))) for word in words[3:]]
            del pose.attrib["degrees"]
        elif len(words) == 6:
            from aras_sim_bridge.description.units import describe_angles_in_degrees

            angles = [parse_number(word, where) for word in words[3:]]
            warnings += describe_angles_in_degrees(angles, f"{where}: roll pitch yaw")
    pose.text = " ".join(words)


def _unify_flag(flag: Element, where: str, warnings: list[str]) -> bool:
    """Whether the flag says anything; a word that does not is a sentence in `warnings`."""
    word = (flag.text or "").strip().lower()
    if word in _BOOLEAN_WORDS:
        warnings.append(
            f"{where} is '{shorten(flag.text)}', read as {_BOOLEAN_WORDS[word]}; write true or "
            "false"
        )
        word = _BOOLEAN_WORDS[word]
    elif word and word not in ("true", "false", "1", "0"):
        warnings.append(f"{where} is '{shorten(flag.text)}', which is neither true nor false; "
                        "left out")
        return False
    flag.text = word
    return bool(word)


def rotate_axes(joint: Element, pose: Pose, inner: str) -> None:
    """Give the axes of a joint of the model `inner` as the model around it has them, in which the
    inner one has `pose`."""
    for axis in (*joint.findall("axis/xyz"), *joint.findall("axis2/xyz")):
        frame = axis.get("expressed_in")
        if frame == MODEL_FRAME:
            there = Pose((0.0, 0.0, 0.0), pose.quat)
            vector = there.apply(parse_numbers(axis.text, 3, f"joint '{joint.get('name')}': axis"))
            axis.text = " ".join(map(repr, vector))
        elif frame:
            axis.set("expressed_in", f"{inner}::{frame}")
