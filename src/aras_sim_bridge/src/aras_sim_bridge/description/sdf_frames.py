"""Frames of SDF: poses that are given by a link, a joint, a frame or a model, each in the frame of
the element around it, as the readers after this want them.

See http://sdformat.org/tutorials?tut=pose_frame_semantics: a frame is fixed to what it is
`attached_to`, a pose is in the frame that it is `relative_to`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from aras_sim_bridge.description.sdf_dialects import MODEL_FRAME
from aras_sim_bridge.errors import DescriptionError
from aras_visual_servo_base import safe_xml
from aras_visual_servo_base.poses import Pose
from aras_visual_servo_base.safe_xml import find_text, parse_numbers, shorten

WORLD_FRAME = "world"
_INSIDE_LINK = ("inertial", "visual", "collision", "sensor", "light")


class Frames(Mapping[str, Pose]):
    """The frames of a model or a world by name, in that of the model or the world; the order in
    the file does not count. One that does not exist, or is relative to itself, raises KeyError."""

    def __init__(self, scope: Element) -> None:
        root = MODEL_FRAME if scope.tag == "model" else WORLD_FRAME
        self._roots = (root, WORLD_FRAME)
        self._root = root
        self._nodes: dict[str, Element] = {}
        self._inner: dict[str, str] = {}
        for name, node, owner in _list_frames(scope):
            if self._nodes.setdefault(name, node) is node and owner:
                self._inner[name] = owner
        self._cache: dict[str, Pose] = dict.fromkeys(self._roots, Pose())

    def __getitem__(self, name: str) -> Pose:
        if name not in self._cache:
            node = self._nodes[name]
            self._cache[name] = None  # what comes back to it meanwhile is relative to itself
            try:
                at = self[self.base_frame(name)] @ _read_pose(node)
            except BaseException:
                del self._cache[name]
                raise
            self._cache[name] = at
        if self._cache[name] is None:
            raise KeyError(name)
        return self._cache[name]

    def __iter__(self) -> Iterator[str]:
        return iter((*self._roots, *self._nodes))

    def __len__(self) -> int:
        return len(self._roots) + len(self._nodes)

    def base_frame(self, name: str) -> str:
        """The frame in which the pose of a named element is given."""
        node, owner = self._nodes[name], self._inner.get(name, "")
        frame = _read_frame(node) or self._find_default_base(node)
        return (owner or self._root) if frame in ("", self._root) else frame

    def _find_default_base(self, node: Element) -> str:
        if node.tag == "joint":
            return find_text(node, "child") or ""
        return node.get("attached_to") or "" if node.tag == "frame" else ""

    def find_link(self, name: str) -> str:
        """The link that a frame is fixed to; the name itself where it is no frame."""
        seen: list[str] = []
        while name not in seen and name in self._nodes and self._nodes[name].tag == "frame":
            seen.append(name)
            on, owner = self._nodes[name].get("attached_to"), self._inner.get(name)
            if on:
                name = f"{owner}::{on}" if owner else on
        return name

    def find_kind(self, name: str) -> str:
        """The tag of a named element, '' for the model or the world themselves."""
        return self._nodes[name].tag if name in self._nodes else ""

    def list_errors(self) -> list[str]:
        """A sentence on each `<frame>` that has no place."""
        return [
            f"frame '{shorten(name)}' is left out: '{shorten(self.base_frame(name))}' is no link, "
            "joint, frame or model there, or depends on this frame itself"
            for name, node in self._nodes.items()
            if node.tag == "frame" and name not in self._inner and not has_pose(self, name)
        ]


def _list_frames(scope: Element) -> Iterator[tuple[str, Element, str]]:
    """Name, element and model around it of what has a frame; what is in models has their names
    before its own."""
    for node in scope:
        name = node.get("name") or ""
        if node.tag in ("link", "joint", "frame", "model") and name:
            yield name, node, ""
        if node.tag == "model":
            for inner in node:
                if inner.tag in ("link", "frame") and inner.get("name"):
                    yield f"{name}::{inner.get('name')}", inner, name


def _read_frame(node: Element) -> str:
    pose = node.find("pose")
    return "" if pose is None else pose.get("relative_to") or pose.get("frame") or ""


def _read_pose(node: Element) -> Pose:
    where = f"{node.tag} '{shorten(node.get('name') or '')}': pose"
    return safe_xml.parse_pose(find_text(node, "pose"), where)


def _set_pose(node: Element, pose: Pose, frame: str = "") -> None:
    for old in node.findall("pose"):
        node.remove(old)
    written = ElementTree.SubElement(node, "pose")
    written.text = " ".join(map(repr, (*pose.xyz, *pose.rpy)))
    if frame:
        written.set("relative_to", frame)


def resolve_poses(model: Element, warnings: list[str]) -> None:
    """Rewrite the poses in a model, in place: those of links, frames and models in the model's
    frame, a joint's in its child's, those of what is in a link in the link's.

    The models in it are rewritten already. What is given by a frame that does not exist stays as it
    is, for its reader to name. A joint between frames is one between the links that these are
    fixed to; an axis that is given in a joint's or a frame's is given in the model's.
    """
    frames = Frames(model)
    where = f"model '{shorten(model.get('name') or '')}'"
    warnings += (f"{where}: {text}" for text in frames.list_errors())
    places = {name: frames[name] for name in frames if has_pose(frames, name)}
    links = {name: frames.find_link(name) for name in places}
    for node in model:
        name = node.get("name") or ""
        if name not in places:
            continue
        at, frame = places[name], _read_frame(node)
        if node.tag == "joint":
            _resolve_joint(node, at, frames, places, links)
        elif node.tag == "frame":
            _set_pose(node, at, MODEL_FRAME)
            if links[name] != name:
                node.set("attached_to", links[name])
        elif node.tag in ("link", "model") and frame in places and frames.find_kind(frame):
            _set_pose(node, at)
        for part in node if node.tag == "link" else ():
            frame = _read_frame(part)
            if part.tag in _INSIDE_LINK and (frame == MODEL_FRAME or frames.find_kind(frame)
                                             ) and frame in places:
                _set_pose(part, at.inverse() @ places[frame] @ _read_pose(part))
    placement = model.get("placement_frame")
    if placement in places:
        del model.attrib["placement_frame"]
        _set_pose(model, _read_pose(model) @ places[placement].inverse(), _read_frame(model))


def has_pose(frames: Frames, name: str) -> bool:
    """Whether a frame has a place; one whose pose is wrong has none, which its reader names."""
    try:
        return name in frames
    except DescriptionError:
        return False


def _resolve_joint(joint: Element, at: Pose, frames: Frames, places: Mapping[str, Pose],
                   links: Mapping[str, str]) -> None:
    child, moved = find_text(joint, "child") or "", bool(_read_frame(joint))
    for end in (joint.find("parent"), joint.find("child")):
        name = "" if end is None else (end.text or "").strip()
        if frames.find_kind(name) == "frame" and name in links:
            end.text, moved = links[name], True
    child = links.get(child, child)
    if moved and child in places:
        _set_pose(joint, places[child].inverse() @ at)
    for axis in (*joint.findall("axis/xyz"), *joint.findall("axis2/xyz")):
        frame = axis.get("expressed_in") or ""
        if frame in places and frames.find_kind(frame) in ("joint", "frame", "model"):
            there = Pose((0.0, 0.0, 0.0), places[frame].quat)
            vector = there.apply(parse_numbers(axis.text, 3, f"joint '{joint.get('name')}': axis"))
            axis.text = " ".join(map(repr, vector))
            axis.set("expressed_in", MODEL_FRAME)
