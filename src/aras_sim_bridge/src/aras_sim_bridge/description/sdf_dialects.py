"""Conversion of SDF documents of any version to the form that the readers in this folder expect.

Some errors that Gazebo tolerates are corrected.
"""

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
    """Rewrite an SDF document or element in place; each corrected error causes a warning.

    - Poses become six numbers. A pose of three numbers becomes a position without rotation; degrees
      and quaternions of SDF 1.9 are converted.
    - Flags become true or false.
    - A joint axis that is given in the model's frame gets the attribute `expressed_in`. Up to SDF
      1.4, the model's frame is the default; in later versions, `<use_parent_model_frame>` selects
      it.
    """
    _unify(root, _read_version(root) < (1, 5), "", warnings)


def _read_version(root: Element) -> tuple[int, ...]:
    """Return the SDF version of the root, or the newest version if the root gives none."""
    found = re.match(r"\s*(\d+)\.(\d+)", root.get("version") or "")
    return (99,) if found is None else tuple(map(int, found.groups()))


def _unify(element: Element, old: bool, where: str, warnings: list[str]) -> None:
    """Convert an element and its children to the unified form; see `unify`.

    If `old`, joint axes are in the model's frame by default.
    """
    if element.tag in _NAMED_TAGS and element.get("name"):
        label = f"{element.tag} '{shorten(element.get('name'))}'"
        where = f"{where}, {label}" if where and not where.startswith("world") else label
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
    texts = (pose.text or "").split()
    if len(texts) == 3:
        warnings.append(f"{where} '{' '.join(map(shorten, texts))}' has three numbers, which are "
                        "read as a position without rotation; write x y z roll pitch yaw")
        texts += ["0"] * 3
    # invalid numbers are reported when the pose is read
    with contextlib.suppress(DescriptionError):
        if len(texts) == 7 and pose.get("rotation_format") == "quat_xyzw":
            given = parse_numbers(pose.text, 7, where)
            length = math.hypot(*given[3:]) or 1.0
            at = Pose(given[:3], tuple(part / length for part in given[3:]))
            texts = list(map(repr, (*at.xyz, *at.rpy)))
        elif len(texts) == 6 and pose.get("degrees") in ("true", "1"):
            texts[3:] = [repr(math.radians(parse_number(word, where))) for word in texts[3:]]
            del pose.attrib["degrees"]
        elif len(texts) == 6:
            from aras_sim_bridge.description.angle_unit_check import describe_angles_in_degrees

            angles = [parse_number(word, where) for word in texts[3:]]
            warnings += describe_angles_in_degrees(angles, f"{where}: roll pitch yaw")
    pose.text = " ".join(texts)


def _unify_flag(flag: Element, where: str, warnings: list[str]) -> bool:
    """Convert a flag to true or false; if its value is invalid, add a warning and return False."""
    word = (flag.text or "").strip().lower()
    if word in _BOOLEAN_WORDS:
        warnings.append(
            f"{where} is '{shorten(flag.text)}', which is read as {_BOOLEAN_WORDS[word]}; write "
            "true or false"
        )
        word = _BOOLEAN_WORDS[word]
    elif word and word not in ("true", "false", "1", "0"):
        warnings.append(f"{where} '{shorten(flag.text)}' is ignored, because it is neither true "
                        "nor false; write true or false")
        return False
    flag.text = word
    return bool(word)


def rotate_axis(axis: Element, pose: Pose, joint: Element) -> None:
    """Rotate a joint's axis from a frame to the frame in which `pose`, its pose, is expressed."""
    vector = parse_numbers(axis.text, 3, f"joint '{joint.get('name')}': axis")
    axis.text = " ".join(map(repr, Pose(quat=pose.quat).apply(vector)))
