"""Resolution of SDF frames: poses relative to links, joints, frames and models.

After the resolution every pose is relative to the parent element. See
http://sdformat.org/tutorials?tut=pose_frame_semantics: a frame is fixed to the element that it is
`attached_to`, and a pose is expressed in the frame that it is `relative_to`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from xml.etree.ElementTree import Element

from aras_sim_bridge.description.sdf_dialects import MODEL_FRAME, rotate_axis
from aras_sim_bridge.description.sdf_poses import write_pose
from aras_sim_bridge.errors import DescriptionError
from aras_visual_servo_base import safe_xml
from aras_visual_servo_base.poses import Pose
from aras_visual_servo_base.safe_xml import find_text, shorten

WORLD_FRAME = "world"
_INSIDE_LINK = ("inertial", "visual", "collision", "sensor", "light")


class SdfFrames(dict[str, Pose]):
    """Poses of a model's or world's frames by name, relative to the model or world.

    The order of the frames in the file does not matter. It contains no frames whose pose is
    invalid, or whose base does not exist or depends on the frame itself. Looking up a frame with an
    invalid pose raises the DescriptionError of this pose.
    """

    def __init__(self, scope: Element) -> None:
        self._root = MODEL_FRAME if scope.tag == "model" else WORLD_FRAME
        super().__init__({self._root: Pose(), WORLD_FRAME: Pose()})
        self._nodes: dict[str, Element] = {}
        self._errors: dict[str, DescriptionError] = {}  # errors of invalid poses, by frame
        self._inner: dict[str, str] = {}
        for name, node, owner in _list_frames(scope):
            if self._nodes.setdefault(name, node) is node and owner:
                self._inner[name] = owner
        pending = [name for name in self._nodes if name not in self]
        while pending:
            left = [name for name in pending if not self._add_pose(name)]
            if len(left) == len(pending):
                break
            pending = left

    def _add_pose(self, name: str) -> bool:
        """Add the pose of a frame; return False if that of its base is not known."""
        base = self.base_frame(name)
        if base not in self:
            return False
        try:
            self[name] = self[base] @ _read_pose(self._nodes[name])
        except DescriptionError as error:
            self._errors[name] = error
        return True

    def __missing__(self, name: str) -> Pose:
        raise self._errors.get(name, KeyError(name))

    def base_frame(self, name: str) -> str:
        """Return the name of the frame in which the pose of the element `name` is expressed."""
        node, owner = self._nodes[name], self._inner.get(name, "")
        frame = _read_frame(node) or self._find_default_base(node)
        return (owner or self._root) if frame in ("", self._root) else frame

    def _find_default_base(self, node: Element) -> str:
        if node.tag == "joint":
            return find_text(node, "child") or ""
        return node.get("attached_to") or "" if node.tag == "frame" else ""

    def find_link(self, name: str) -> str:
        """Return the link that a frame is fixed to; return any other name unchanged."""
        visited: list[str] = []
        while name not in visited and name in self._nodes and self._nodes[name].tag == "frame":
            visited.append(name)
            on, owner = self._nodes[name].get("attached_to"), self._inner.get(name)
            if on:
                name = f"{owner}::{on}" if owner else on
        return name

    def find_kind(self, name: str) -> str:
        """Return the tag of a named element, or '' for the model and the world."""
        return self._nodes[name].tag if name in self._nodes else ""

    def list_errors(self) -> list[str]:
        """Return one sentence for each `<frame>` whose pose is undefined."""
        return [
            f"{self._errors[name]}; the frame is ignored"
            if name in self._errors
            else f"frame '{shorten(name)}' is ignored: its base '{shorten(self.base_frame(name))}' "
            "is no link, joint, frame or model of the same parent, or depends on this frame; "
            "correct the name of the base"
            for name, node in self._nodes.items()
            if node.tag == "frame" and name not in self._inner and name not in self
        ]


def _list_frames(scope: Element) -> Iterator[tuple[str, Element, str]]:
    """Yield the name, element and enclosing model of each element that has a frame.

    Elements of nested models have names of the form model::name.
    """
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


def resolve_poses(model: Element, warnings: list[str]) -> None:
    """Rewrite the poses in a model in place, so that they do not refer to other frames.

    The poses of links, frames and nested models become relative to the model, the poses of joints
    relative to their child links, and the poses of a link's elements relative to the link. Joints
    between frames become joints between the links that the frames are fixed to. Axes in the frame
    of a joint, frame or nested model are converted to the model's frame. A pose whose frame does
    not exist is unchanged; the reader of its element reports the error. Call this function for the
    nested models first.
    """
    frames = SdfFrames(model)
    where = f"model '{shorten(model.get('name') or '')}'"
    warnings += (f"{where}: {text}" for text in frames.list_errors())
    links = {name: frames.find_link(name) for name in frames}
    for node in model:
        name = node.get("name") or ""
        if name not in frames:
            continue
        at, frame = frames[name], _read_frame(node)
        if node.tag == "joint":
            _resolve_joint(node, at, frames, links)
        elif node.tag == "frame":
            write_pose(node, at, MODEL_FRAME)
            if links[name] != name:
                node.set("attached_to", links[name])
        elif node.tag in ("link", "model") and frame in frames and frames.find_kind(frame):
            write_pose(node, at)
        for part in node if node.tag == "link" else ():
            frame = _read_frame(part)
            if part.tag in _INSIDE_LINK and (frame == MODEL_FRAME or frames.find_kind(frame)
                                             ) and frame in frames:
                write_pose(part, at.inverse() @ frames[frame] @ _read_pose(part))
    placement = model.get("placement_frame")
    if placement in frames:
        del model.attrib["placement_frame"]
        write_pose(model, _read_pose(model) @ frames[placement].inverse(), _read_frame(model))


def _resolve_joint(
    joint: Element, at: Pose, frames: SdfFrames, links: Mapping[str, str]
) -> None:
    child, moved = find_text(joint, "child") or "", bool(_read_frame(joint))
    for end in (joint.find("parent"), joint.find("child")):
        name = "" if end is None else (end.text or "").strip()
        if frames.find_kind(name) == "frame" and name in links:
            end.text, moved = links[name], True
    child = links.get(child, child)
    if moved and child in frames:
        write_pose(joint, frames[child].inverse() @ at)
    for axis in (*joint.findall("axis/xyz"), *joint.findall("axis2/xyz")):
        frame = axis.get("expressed_in") or ""
        if frame in frames and frames.find_kind(frame) in ("joint", "frame", "model"):
            rotate_axis(axis, frames[frame], joint)
            axis.set("expressed_in", MODEL_FRAME)
