"""`<state>`: what Gazebo's window writes of a running world when it saves it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from xml.etree.ElementTree import Element

from aras_sim_bridge.description.types import Geometry, Light, Link, RobotDescription
from aras_visual_servo_base import safe_xml
from aras_visual_servo_base.poses import Pose, Vector3
from aras_visual_servo_base.safe_xml import numbers, shorten, text_of

_NS_PER_S = 1_000_000_000
_UNSCALED = (1.0, 1.0, 1.0)


class WorldState:
    """A world's `<state>`; None is that of a world without one.

    time_ns: simulated time at which it was saved. insertions: models and lights that came while it
    ran. deleted: names of what went.
    """

    def __init__(self, state: Element | None) -> None:
        self._state = state
        self.insertions: list[Element] = []
        self.deleted: set[str] = set()
        self.time_ns = 0
        if state is None:
            return
        self.insertions = [child for node in state.findall("insertions") for child in node]
        self.deleted = {(name.text or "").strip() for node in state.findall("deletions")
                        for name in node.findall("name")}
        seconds, nanoseconds = numbers(text_of(state, "sim_time"), 2, "<state>: sim_time", (0, 0))
        self.time_ns = max(int(seconds) * _NS_PER_S + int(nanoseconds), 0)

    def placed(self, models: list[RobotDescription], lights: list[Light], warnings: list[str]
               ) -> tuple[list[RobotDescription], list[Light]]:
        """Models and lights where the state has them; a sentence in `warnings` for what it says
        in vain."""
        states = {kind: self._named(kind) for kind in ("model", "light")}
        known = {"model": {m.name for m in models}, "light": {one.name for one in lights}}
        for kind, found in states.items():
            lost = sorted(found.keys() - known[kind] - self.deleted)
            if lost:
                warnings.append(f"<state> places {kind}s that do not exist: "
                                f"{', '.join(map(shorten, lost))}; ignored")
        moving = [m.name for m in models if _moves(states["model"].get(m.name))]
        if moving:
            warnings.append(f"<state> has {', '.join(moving)} in motion; all begins at rest")
        return ([_placed_model(m, states["model"].get(m.name), warnings) for m in models],
                [_placed_light(one, states["light"].get(one.name)) for one in lights])

    def _named(self, kind: str) -> dict[str, Element]:
        nodes = [] if self._state is None else self._state.findall(kind)
        return {node.get("name") or "": node for node in nodes}


def _pose(element: Element, where: str) -> Pose | None:
    text = text_of(element, "pose")
    return None if text is None else safe_xml.pose(text, f"<state>: {where}: pose")


def _links(state: Element, prefix: str = "") -> Iterator[tuple[str, Element]]:
    """Names and elements of a model's links and, as inner::link, of those of the models in it."""
    for node in state.findall("link"):
        yield prefix + (node.get("name") or ""), node
    for inner in state.findall("model"):
        yield from _links(inner, f"{prefix}{inner.get('name')}::")


def _moves(state: Element | None) -> bool:
    """Whether a link is faster than what is left of a body at rest: 1 cm/s or 0.01 rad/s."""
    if state is None:
        return False
    speeds = (numbers(text_of(node, "velocity"), 6, f"<state>: link '{name}': velocity", (0.0,))
              for name, node in _links(state))
    return any(max(map(abs, speed)) > 0.01 for speed in speeds)


def _placed_light(light: Light, state: Element | None) -> Light:
    pose = None if state is None else _pose(state, f"light '{light.name}'")
    return light if pose is None else light.at(pose)


def _placed_model(model: RobotDescription, state: Element | None, warnings: list[str]
                  ) -> RobotDescription:
    if state is None:
        return model
    where = f"model '{model.name}'"
    pose = _pose(state, where) or Pose.from_rpy(*model.initial_pose)
    scale = numbers(text_of(state, "scale"), 3, f"<state>: {where}: scale", _UNSCALED)
    links = {name: _pose(node, f"{where}, link '{name}'") for name, node in _links(state)}
    lost = sorted(links.keys() - model.links.keys())
    if lost:
        warnings.append(f"<state> places links of {where} that do not exist: "
                        f"{', '.join(map(shorten, lost))}; ignored")
    if min(scale) <= 0.0:
        warnings.append(f"<state>: {where}: scale {scale} is not positive; ignored")
        scale = _UNSCALED
    shaped = model.links
    if scale != _UNSCALED:
        shaped = {name: _scaled(link, scale) for name, link in shaped.items()}
    return replace(
        model, links=shaped, initial_pose=(pose.xyz, pose.rpy),
        initial_joints=_joint_positions(model, {**links, model.root: pose}))


def _joint_positions(model: RobotDescription, links: dict[str, Pose | None]) -> dict[str, float]:
    """rad or m of the joints whose two links have a pose in the world."""
    for joint in model.joints.values():
        if joint.kind == "fixed" and links.get(joint.child) is None and links.get(joint.parent):
            links[joint.child] = links[joint.parent] @ joint.pose
    for joint in reversed(model.joints.values()):  # a joint's own frame stands on its child
        if joint.kind == "fixed" and links.get(joint.parent) is None and links.get(joint.child):
            links[joint.parent] = links[joint.child] @ joint.pose.inverse()
    positions = {}
    for joint in model.joints.values():
        parent, child = links.get(joint.parent), links.get(joint.child)
        if not joint.moves or parent is None or child is None:
            continue
        moved = (parent @ joint.pose).inverse() @ child
        if joint.kind == "prismatic":
            position = sum(a * x for a, x in zip(joint.axis, moved.xyz, strict=True))
        else:
            along = sum(a * x for a, x in zip(joint.axis, moved.quat, strict=False))
            position = math.remainder(2.0 * math.atan2(along, moved.quat[3]), 2.0 * math.pi)
        low, high = joint.stops
        positions[joint.name] = min(max(position, low), high)
    return positions


def _scaled(link: Link, scale: Vector3) -> Link:
    """The link's shapes larger, in place, as Gazebo scales; its mass stays."""
    return replace(
        link,
        visuals=tuple(replace(one, geometry=_larger(one.geometry, scale)) for one in link.visuals),
        collisions=tuple(replace(one, geometry=_larger(one.geometry, scale))
                         for one in link.collisions))


def _larger(shape: Geometry, scale: Vector3) -> Geometry:
    def times(sizes: Vector3) -> Vector3:
        return tuple(a * b for a, b in zip(sizes, scale, strict=True))

    return replace(shape, size=times(shape.size), scale=times(shape.scale),
                   radius=shape.radius * scale[0], length=shape.length * scale[2])
