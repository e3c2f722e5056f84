"""libgazebo_grasp_fix.so: the grippers of a model that hold what they grasp."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from xml.etree.ElementTree import Element

from aras_sim_bridge.description.types import GraspArm, GraspDescription, Link
from aras_visual_servo_base.safe_xml import (
    find_text,
    parse_bool,
    parse_integer,
    parse_number,
    shorten,
)

_WHERE = "plugin gazebo_grasp_fix"


def read(plugin: Element) -> GraspDescription:
    """What the plug-in's elements say, with upstream's defaults.

    Raises:
        DescriptionError: an element that is no number.
    """
    def read_value(tag: str, default: float) -> float:
        return parse_number(find_text(plugin, tag), f"{_WHERE}: {tag}", default)

    most = parse_integer(find_text(plugin, "max_grip_count"), f"{_WHERE}: max_grip_count", 10)
    return GraspDescription(
        arms=tuple(_read_arm(arm) for arm in plugin.findall("arm")),
        angle=math.radians(read_value("forces_angle_tolerance", 120.0)),
        rate=read_value("update_rate", 5.0),
        most=most,
        threshold=parse_integer(find_text(plugin, "grip_count_threshold"),
                          f"{_WHERE}: grip_count_threshold", most // 2),
        release_tolerance=read_value("release_tolerance", 0.005),
        collides=not parse_bool(find_text(plugin, "disable_collisions_on_attach"),
                           f"{_WHERE}: disable_collisions_on_attach", False),
    )


def _read_arm(arm: Element) -> GraspArm:
    fingers = tuple((node.text or "").strip() for node in arm.findall("gripper_link"))
    return GraspArm(find_text(arm, "arm_name") or "", find_text(arm, "palm_link") or "", fingers)


def check_grasps(grasps: list[GraspDescription], links: Mapping[str, Link], warnings: list[str]
             ) -> list[GraspDescription]:
    """The plug-ins that can grasp, with the arms that the model has; a warning names all else."""
    whole = []
    for one in grasps:
        if one.rate <= 0.0 or one.angle < math.pi / 2:
            wrong = (f"update_rate is {one.rate:g} Hz; give a positive one" if one.rate <= 0.0 else
                     f"forces_angle_tolerance is {math.degrees(one.angle):g} degrees; forces are "
                     "opposed from 90 degrees on, so nothing is grasped, as in Gazebo")
            warnings.append(f"{_WHERE}: {wrong}; left out")
            continue
        arms: dict[str, GraspArm] = {}
        for arm in one.arms:
            problem, arm = _check_arm(arm, links, warnings)
            if arm.name in arms:
                problem = "there is an arm of this name already"
            if problem:
                warnings.append(f"{_WHERE}: arm '{shorten(arm.name)}': {problem}; left out")
            else:
                arms[arm.name] = arm
        if arms:
            whole.append(replace(one, arms=tuple(arms.values())))
        else:
            warnings.append(f"{_WHERE}: it has no <arm> whose links exist; left out")
    return whole


def _check_arm(arm: GraspArm, links: Mapping[str, Link], warnings: list[str]
             ) -> tuple[str, GraspArm]:
    """Why an arm cannot grasp, empty where it can; the arm with the fingers that exist."""
    for finger in arm.fingers:
        if finger not in links:
            warnings.append(f"{_WHERE}: arm '{shorten(arm.name)}': gripper_link "
                            f"'{shorten(finger)}' does not exist; it is left out")
    fingers = tuple(one for one in arm.fingers if one in links)
    arm = replace(arm, fingers=fingers)
    if not arm.name or not arm.palm or not fingers:
        return "it needs <arm_name>, <palm_link> and <gripper_link>s that exist", arm
    if arm.palm not in links:
        return f"palm_link '{shorten(arm.palm)}' does not exist", arm
    if not any(links[one].collisions for one in fingers):
        return "no gripper_link has a <collision>", arm
    return "", arm
