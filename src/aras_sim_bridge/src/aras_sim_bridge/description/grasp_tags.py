"""Reader of libgazebo_grasp_fix.so, the plug-in that attaches grasped objects to a gripper."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from xml.etree.ElementTree import Element

from aras_sim_bridge.description.types import GraspFixPlugin, GripperDescription, Link
from aras_visual_servo_base.safe_xml import ElementReader, find_text, shorten

_WHERE = "plugin gazebo_grasp_fix"


def read(plugin: Element) -> GraspFixPlugin:
    """Read the plug-in's elements; a missing element gets its default in gazebo_grasp_fix.

    Raises:
        DescriptionError: an element is not a number.
    """
    reader = ElementReader(plugin, f"{_WHERE}: ")
    most = reader.read_integer("max_grip_count", 10)
    return GraspFixPlugin(
        arms=tuple(_read_arm(arm) for arm in plugin.findall("arm")),
        angle=math.radians(reader.read_number("forces_angle_tolerance", 120.0)),
        rate=reader.read_number("update_rate", 5.0),
        most=most,
        threshold=reader.read_integer("grip_count_threshold", most // 2),
        release_tolerance=reader.read_number("release_tolerance", 0.005),
        collides=not reader.read_bool("disable_collisions_on_attach", False),
    )


def _read_arm(arm: Element) -> GripperDescription:
    fingers = tuple((node.text or "").strip() for node in arm.findall("gripper_link"))
    return GripperDescription(
        find_text(arm, "arm_name") or "", find_text(arm, "palm_link") or "", fingers
    )


def check_grasps(grasps: list[GraspFixPlugin], links: Mapping[str, Link], warnings: list[str]
             ) -> list[GraspFixPlugin]:
    """Return the plug-ins that have valid settings and at least one valid arm.

    Invalid arms are removed from the others. A warning names each plug-in and each arm that is left
    out.
    """
    whole = []
    for one in grasps:
        if one.rate <= 0.0 or one.angle < math.pi / 2:
            wrong = (f"update_rate is {one.rate:g} Hz; give a rate above 0 Hz"
                     if one.rate <= 0.0 else
                     f"forces_angle_tolerance is {math.degrees(one.angle):g} degrees, but opposing "
                     "forces need at least 90 degrees; increase it")
            warnings.append(f"{_WHERE} is ignored: {wrong}")
            continue
        arms: dict[str, GripperDescription] = {}
        for arm in one.arms:
            problem, arm = _check_arm(arm, links, warnings)
            if arm.name in arms:
                problem = "another arm has the same name"
            if problem:
                warnings.append(f"{_WHERE}: arm '{shorten(arm.name)}' is ignored: {problem}")
            else:
                arms[arm.name] = arm
        if arms:
            whole.append(replace(one, arms=tuple(arms.values())))
        else:
            warnings.append(f"{_WHERE} is ignored, because it has no valid <arm>; add or correct "
                            "one")
    return whole


def _check_arm(arm: GripperDescription, links: Mapping[str, Link], warnings: list[str]
             ) -> tuple[str, GripperDescription]:
    """Return why an arm cannot grasp ('' if it can), and a copy of the arm.

    The copy has only those fingers that are links of the model.
    """
    for finger in arm.fingers:
        if finger not in links:
            warnings.append(f"{_WHERE}: gripper_link '{shorten(finger)}' of arm "
                            f"'{shorten(arm.name)}' is ignored, because this link does not exist")
    fingers = tuple(one for one in arm.fingers if one in links)
    arm = replace(arm, fingers=fingers)
    if not arm.name or not arm.palm or not fingers:
        return "give <arm_name>, <palm_link>, and a <gripper_link> that exists", arm
    if arm.palm not in links:
        return f"palm_link '{shorten(arm.palm)}' does not exist", arm
    if not any(links[one].collisions for one in fingers):
        return "no gripper_link has a <collision>", arm
    return "", arm
