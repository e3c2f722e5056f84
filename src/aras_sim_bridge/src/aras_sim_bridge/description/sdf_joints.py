"""Reader of SDF's `<joint>`s; a screw joint or two-axis joint becomes two joints in series."""

from collections.abc import Mapping
from dataclasses import replace
from xml.etree.ElementTree import Element

from aras_sim_bridge.description.kinematic_tree import WORLD, JointInModel
from aras_sim_bridge.description.sdf_dialects import MODEL_FRAME
from aras_sim_bridge.description.sdf_poses import read_name, read_pose
from aras_sim_bridge.errors import DescriptionError
from aras_visual_servo_base.poses import Pose
from aras_visual_servo_base.safe_xml import (
    ElementReader,
    find_text,
    parse_bool,
    parse_direction,
    parse_number,
    shorten,
)
from aras_visual_servo_base.urdf import Joint, JointLimits, Mimic

_SINGLE = ("revolute", "continuous", "prismatic", "fixed")
_TWO_AXIS_KINDS = ("universal", "revolute2")
JOINT_KINDS = (*_SINGLE, *_TWO_AXIS_KINDS, "screw")
NO_LIMIT = 1e16  # value of a joint's limit in SDF that means "no limit"


def read_joints(element: Element, model: str, poses: Mapping[str, Pose]) -> list[JointInModel]:
    """Read a `<joint>` between two links of a model, or between the world and a link.

    A universal or revolute2 joint <name> becomes a revolute joint about its `<axis>`, a massless
    link <name>_cross, and a revolute joint <name>_2 about its `<axis2>`. A screw joint becomes a
    revolute joint, a massless link <name>_nut, and a prismatic joint <name>_thread that follows the
    rotation. As in Gazebo, the child moves by -1/thread_pitch metres per rad.

    Args:
        poses: poses of the links in the model.

    Raises:
        DescriptionError: the joint is invalid; the message names it, the problem and how to fix it.
    """
    name = read_name(element, model)
    where = f"{model}, joint '{name}'"
    kind = element.get("type") or ""
    if kind not in JOINT_KINDS:
        raise DescriptionError(f"{where}: joint type '{shorten(kind)}' is not supported; use "
                               f"{', '.join(JOINT_KINDS)}")
    parent, child = find_text(element, "parent") or "", find_text(element, "child") or ""
    for end, known in ((parent, {*poses, WORLD}), (child, poses)):
        if end not in known:
            raise DescriptionError(f"{where}: link '{shorten(end)}' does not exist; correct the "
                                   "name")
    offset = read_pose(element, where)
    pose = poses[child] if offset == Pose() else poses[child] @ offset
    cut = parse_bool(find_text(element, "physics/simbody/must_be_loop_joint"), f"{where}: "
                "must_be_loop_joint", False)
    if kind == "fixed":
        return [JointInModel(Joint(name, kind, parent, child), pose)]
    if kind in _SINGLE:
        joint = _set_axis(element, "axis", Joint(name, kind, parent, child), pose, poses, where)
        return [JointInModel(joint, pose, cut)]
    between = f"{name}_{'nut' if kind == 'screw' else 'cross'}"
    first = _set_axis(element, "axis", Joint(name, "revolute", parent, between), pose, poses, where)
    if kind == "screw":
        pitch = parse_number(find_text(element, "thread_pitch"), f"{where}: thread_pitch", 1.0)
        if pitch == 0.0:
            raise DescriptionError(f"{where}: thread_pitch is 0 rad/m; give a pitch other than 0")
        second = Joint(f"{name}_thread", "prismatic", between, child, axis=first.axis,
                       limits=JointLimits(-NO_LIMIT, NO_LIMIT, NO_LIMIT, NO_LIMIT),
                       mimic=Mimic(name, -1.0 / pitch, 0.0))
    else:
        second = _set_axis(element, "axis2", Joint(f"{name}_2", "revolute", between, child), pose,
                        poses, f"{where}: axis2")
        if abs(sum(a * b for a, b in zip(first.axis, second.axis, strict=True))) > 0.999:
            raise DescriptionError(f"{where}: <axis> and <axis2> are parallel; change <axis2>")
    return [JointInModel(first, pose, False, between), JointInModel(second, pose, cut)]


def _set_axis(element: Element, tag: str, joint: Joint, pose: Pose, poses: Mapping[str, Pose],
           where: str) -> Joint:
    """Return the joint with the axis, limits and dynamics of the child element `tag`.

    `pose` is the pose of the joint's frame in the model, and `poses` are those of the links.
    """
    axis = ElementReader(element.find(tag), f"{where}: ")
    kind = joint.kind
    along = parse_direction(axis.read_text("xyz"), f"{where}: axis", (0.0, 0.0, 1.0))
    xyz = element.find(f"{tag}/xyz")
    frame = None if xyz is None else xyz.get("expressed_in")
    if frame:
        known = {MODEL_FRAME: Pose(), WORLD: Pose(), **poses}
        if frame not in known:
            raise DescriptionError(f"{where}: <xyz expressed_in='{shorten(frame)}'> names no link; "
                                   "give the axis in the joint's frame")
        along = Pose(quat=(pose.inverse() @ known[frame]).quat).apply(along)
    limit = ElementReader(element.find(f"{tag}/limit"), f"{where}: ")
    lower, upper = _read_bound(limit, "lower", -NO_LIMIT), _read_bound(limit, "upper", NO_LIMIT)
    if lower > upper:
        raise DescriptionError(
            f"{where}: lower {lower} is above upper {upper}; exchange the two limits"
        )
    free = kind == "continuous" or kind == "revolute" and lower <= -1e15 and upper >= 1e15
    effort = _read_bound(limit, "effort", NO_LIMIT)
    velocity = _read_bound(limit, "velocity", NO_LIMIT)
    limits = JointLimits(None if free else lower, None if free else upper,
                         # an effort of -1 means "no limit" in SDF
                         effort if effort >= 0.0 else NO_LIMIT,
                         velocity if velocity >= 0.0 else NO_LIMIT)
    dynamics = ElementReader(element.find(f"{tag}/dynamics"), f"{where}: ")
    damping, friction = dynamics.read_number("damping", 0.0), dynamics.read_number("friction", 0.0)
    if damping < 0.0 or friction < 0.0:
        raise DescriptionError(f"{where}: damping {damping} and friction {friction} must be ≥ 0")
    stiffness = dynamics.read_number("spring_stiffness", 0.0)
    if stiffness < 0.0:
        raise DescriptionError(f"{where}: spring_stiffness is {stiffness}; it must not be negative")
    rest = dynamics.read_number("spring_reference", 0.0)
    return replace(joint, kind="continuous" if free else kind, axis=along, limits=limits,
                   damping=damping, friction=friction, stiffness=stiffness, rest=rest)


def _read_bound(limit: ElementReader, tag: str, default: float) -> float:
    """Read a position limit; inf becomes NO_LIMIT, and -inf becomes -NO_LIMIT."""
    text = limit.read_text(tag)
    if text and text.lower().lstrip("+-") in ("inf", "infinity"):
        return -NO_LIMIT if text.startswith("-") else NO_LIMIT
    return limit.read_number(tag, default)
