"""The `<state>` of a world, in which Gazebo saves the current poses of a running simulation."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TypeVar
from xml.etree.ElementTree import Element

from aras_sim_bridge.description.kinematic_tree import compute_joint_position
from aras_sim_bridge.description.types import Geometry, Light, Link, RobotDescription
from aras_sim_bridge.errors import DescriptionError
from aras_visual_servo_base import safe_xml
from aras_visual_servo_base.poses import Pose, Vector3
from aras_visual_servo_base.safe_xml import find_text, parse_numbers, shorten

Item = TypeVar("Item", RobotDescription, Light)

_NS_PER_S = 1_000_000_000
_UNSCALED = (1.0, 1.0, 1.0)


class WorldState:
    """The `<state>` of a world.

    Attributes:
        time_ns: simulated time at which the world was saved.
        insertions: models and lights that were added while the simulation ran.
        deleted: names of models and lights that were removed.
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
        seconds, nanoseconds = parse_numbers(
            find_text(state, "sim_time"), 2, "<state>: sim_time", (0, 0)
        )
        self.time_ns = max(int(seconds) * _NS_PER_S + int(nanoseconds), 0)

    def place(self, models: list[RobotDescription], lights: list[Light], warnings: list[str]
               ) -> tuple[list[RobotDescription], list[Light]]:
        """Return the models and lights with the poses and joint positions that the `<state>` gives.

        `warnings` gets a sentence about entries of the `<state>` whose model or light does not
        exist.
        """
        states = {kind: self._list_states(kind) for kind in ("model", "light")}
        known = {"model": {m.name for m in models}, "light": {one.name for one in lights}}
        for kind, found in states.items():
            missing = sorted(found.keys() - known[kind] - self.deleted)
            if missing:
                warnings.append(f"<state> has poses for {kind}s that do not exist "
                                f"({', '.join(map(shorten, missing))}); these poses are ignored")
        def place_item(kind: str, one: Item, apply_state: Callable[[Item, Element], Item]) -> Item:
            state = states[kind].get(one.name)
            try:
                return one if state is None else apply_state(one, state)
            except DescriptionError as error:
                warnings.append(f"{error}; this part of the state is ignored")
                return one

        moving: list[str] = []
        models = [
            place_item("model", model, lambda m, state: _place_model(m, state, moving, warnings))
            for model in models
        ]
        if moving:
            warnings.append(f"<state> has velocities for {', '.join(moving)}, which are ignored; "
                            "all models start at rest")
        return models, [place_item("light", light, _place_light) for light in lights]

    def _list_states(self, kind: str) -> dict[str, Element]:
        nodes = [] if self._state is None else self._state.findall(kind)
        return {node.get("name") or "": node for node in nodes}


def _read_pose(element: Element, where: str) -> Pose | None:
    text = find_text(element, "pose")
    return None if text is None else safe_xml.parse_pose(text, f"<state>: {where}: pose")


def _list_links(state: Element, prefix: str = "") -> Iterator[tuple[str, Element]]:
    """Yield name and element of each link of a model.

    The names of links of nested models have the form inner::link.
    """
    for node in state.findall("link"):
        yield prefix + (node.get("name") or ""), node
    for inner in state.findall("model"):
        yield from _list_links(inner, f"{prefix}{inner.get('name')}::")


def _is_moving(state: Element) -> bool:
    """Return whether a link moves faster than 1 cm/s or 0.01 rad/s.

    Slower motion is the residual motion of a body at rest.
    """
    speeds = (
        parse_numbers(find_text(node, "velocity"), 6, f"<state>: link '{name}': velocity", (0.0,))
        for name, node in _list_links(state)
    )
    return any(max(map(abs, speed)) > 0.01 for speed in speeds)


def _place_light(light: Light, state: Element) -> Light:
    pose = _read_pose(state, f"light '{light.name}'")
    return light if pose is None else light.with_pose(pose)


def _place_model(model: RobotDescription, state: Element, moving: list[str],
                  warnings: list[str]) -> RobotDescription:
    """Return a model in its saved state; if it was moving, add its name to `moving`."""
    if _is_moving(state):
        moving.append(model.name)
    where = f"model '{model.name}'"
    pose = _read_pose(state, where) or Pose.from_rpy(*model.initial_pose)
    scale = parse_numbers(find_text(state, "scale"), 3, f"<state>: {where}: scale", _UNSCALED)
    links = {name: _read_pose(node, f"{where}, link '{name}'") for name, node in _list_links(state)}
    bodies = (model, *model.parts)
    missing = sorted(links.keys() - {name for body in bodies for name in body.links})
    if missing:
        warnings.append(f"<state> has poses for links of {where} that do not exist "
                        f"({', '.join(map(shorten, missing))}); these poses are ignored")
    if min(scale) <= 0.0:
        warnings.append(f"<state>: scale {scale} of {where} is ignored, because it is not positive")
        scale = _UNSCALED
    if scale != _UNSCALED:
        bodies = tuple(
            replace(
                body, links={name: _scale_link(link, scale) for name, link in body.links.items()}
            )
            for body in bodies
        )
    joints = _compute_joint_positions(model, {**links, model.root: pose})
    parts = []
    for part in bodies[1:]:
        at = links.get(part.root) or pose @ Pose.from_rpy(*part.initial_pose)
        joints |= _compute_joint_positions(part, {**links, part.root: at})
        part_pose = pose.inverse() @ at
        parts.append(replace(part, initial_pose=(part_pose.xyz, part_pose.rpy)))
    return replace(bodies[0], initial_pose=(pose.xyz, pose.rpy), initial_joints=joints,
                   parts=tuple(parts))


def _compute_joint_positions(
    model: RobotDescription, links: dict[str, Pose | None]
) -> dict[str, float]:
    """Return the positions (rad or m) of the joints whose two links have known poses.

    `links` contains the poses of links in the world, or None for an unknown pose. Unknown poses
    that follow from fixed joints are added to `links`.
    """
    for joint in model.joints.values():
        if joint.kind == "fixed" and links.get(joint.child) is None and links.get(joint.parent):
            links[joint.child] = links[joint.parent] @ joint.pose
    # Reversed, because the joints are stored from the root outwards, and poses now propagate from
    # child to parent.
    for joint in reversed(model.joints.values()):
        if joint.kind == "fixed" and links.get(joint.parent) is None and links.get(joint.child):
            links[joint.parent] = links[joint.child] @ joint.pose.inverse()
    positions = {}
    for joint in model.joints.values():
        parent, child = links.get(joint.parent), links.get(joint.child)
        if not joint.is_movable or parent is None or child is None:
            continue
        position = compute_joint_position(joint, (parent @ joint.pose).inverse() @ child)
        low, high = joint.stops
        positions[joint.name] = min(max(position, low), high)
    return positions


def _scale_link(link: Link, scale: Vector3) -> Link:
    """Return the link with scaled shapes; like in Gazebo, poses and mass are unchanged."""
    return replace(
        link,
        visuals=tuple(
            replace(one, geometry=_scale_shape(one.geometry, scale)) for one in link.visuals
        ),
        collisions=tuple(
            replace(one, geometry=_scale_shape(one.geometry, scale)) for one in link.collisions
        ),
    )


def _scale_shape(shape: Geometry, scale: Vector3) -> Geometry:
    def scale_sizes(sizes: Vector3) -> Vector3:
        return tuple(a * b for a, b in zip(sizes, scale, strict=True))

    return replace(shape, size=scale_sizes(shape.size), scale=scale_sizes(shape.scale),
                   radius=shape.radius * scale[0], length=shape.length * scale[2])
