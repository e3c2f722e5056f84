"""The `<joint>`s of SDF: one with several axes, or with a thread, is several in a row."""

from collections.abc import Mapping
from dataclasses import replace
from xml.etree.ElementTree import Element

from aras_sim_bridge.description.assembly import WORLD, PlacedJoint
from aras_sim_bridge.description.sdf_dialects import MODEL_FRAME
from aras_sim_bridge.description.sdf_poses import name_of, pose_of
from aras_sim_bridge.errors import DescriptionError
from aras_visual_servo_base.poses import Pose
from aras_visual_servo_base.safe_xml import direction, number, shorten, text_of, truth
from aras_visual_servo_base.urdf import Joint, JointLimits, Mimic

_SINGLE = ("revolute", "continuous", "prismatic", "fixed")
_CROSSED = ("universal", "revolute2")
JOINT_KINDS = (*_SINGLE, *_CROSSED, "screw")
ENDLESS = 1e16  # as SDF writes that a joint has no limit


def read_joints(element: Element, model: str, poses: Mapping[str, Pose]) -> list[PlacedJoint]:
    """Read a `<joint>` between links that are at `poses` in the model, or the world and one.

    A universal joint <name> is a revolute one about its `<axis>`, which moves a link <name>_cross
    without mass, and <name>_2 about its `<axis2>`; so is a revolute2. A screw is a revolute joint,
    which moves <name>_nut, and a prismatic one, <name>_thread, that follows it: as in Gazebo the
    child moves by -1/thread_pitch m a rad.

    Raises:
        DescriptionError: naming the joint, what is wrong with it and how to fix it.
    """
    name = name_of(element, model)
    where = f"{model}, joint '{name}'"
    kind = element.get("type") or ""
    if kind not in JOINT_KINDS:
        raise DescriptionError(f"{where}: joint type '{shorten(kind)}' is not supported; use "
                               f"{', '.join(JOINT_KINDS)}")
    parent, child = text_of(element, "parent") or "", text_of(element, "child") or ""
    for end, known in ((parent, {*poses, WORLD}), (child, poses)):
        if end not in known:
            raise DescriptionError(f"{where}: link '{shorten(end)}' does not exist")
    own = pose_of(element, where)
    pose = poses[child] if own == Pose() else poses[child] @ own
    cut = truth(text_of(element, "physics/simbody/must_be_loop_joint"), f"{where}: "
                "must_be_loop_joint", False)
    if kind == "fixed":
        return [PlacedJoint(Joint(name, kind, parent, child), pose)]
    if kind in _SINGLE:
        joint = _about(element, "axis", Joint(name, kind, parent, child), pose, poses, where)
        return [PlacedJoint(joint, pose, cut)]
    between = f"{name}_{'nut' if kind == 'screw' else 'cross'}"
    first = _about(element, "axis", Joint(name, "revolute", parent, between), pose, poses, where)
    if kind == "screw":
        pitch = number(text_of(element, "thread_pitch"), f"{where}: thread_pitch", 1.0)
        if pitch == 0.0:
            raise DescriptionError(f"{where}: thread_pitch is 0 rad/m; a screw needs a thread")
        second = Joint(f"{name}_thread", "prismatic", between, child, axis=first.axis,
                       limits=JointLimits(-ENDLESS, ENDLESS, ENDLESS, ENDLESS),
                       mimic=Mimic(name, -1.0 / pitch, 0.0))
    else:
        second = _about(element, "axis2", Joint(f"{name}_2", "revolute", between, child), pose,
                        poses, f"{where}: axis2")
        if abs(sum(a * b for a, b in zip(first.axis, second.axis, strict=True))) > 0.999:
            raise DescriptionError(f"{where}: its two axes are the same; give <axis2> another one")
    return [PlacedJoint(first, pose, False, between), PlacedJoint(second, pose, cut)]


def _about(element: Element, tag: str, joint: Joint, pose: Pose, poses: Mapping[str, Pose],
           where: str) -> Joint:
    """Return the joint, whose frame is at `pose`, with the axis, limits and dynamics of `tag`."""
    axis = element.find(tag)
    kind = joint.kind
    along = direction(text_of(axis, "xyz"), f"{where}: axis", (0.0, 0.0, 1.0))
    frame = "" if axis is None or axis.find("xyz") is None else axis.find("xyz").get("expressed_in")
    if frame:
        known = {MODEL_FRAME: Pose(), WORLD: Pose(), **poses}
        if frame not in known:
            raise DescriptionError(f"{where}: <xyz expressed_in='{shorten(frame)}'> names no link; "
                                   "give the axis in the joint's frame")
        turn = Pose((0.0, 0.0, 0.0), (pose.inverse() @ known[frame]).quat)
        along = turn.apply(along)
    limit = None if axis is None else axis.find("limit")
    dynamics = None if axis is None else axis.find("dynamics")
    lower = _bound(limit, "lower", f"{where}: lower", -ENDLESS)
    upper = _bound(limit, "upper", f"{where}: upper", ENDLESS)
    if lower > upper:
        raise DescriptionError(f"{where}: lower {lower} is above upper {upper}")
    free = kind == "continuous" or kind == "revolute" and lower <= -1e15 and upper >= 1e15
    effort = _bound(limit, "effort", f"{where}: effort", ENDLESS)
    velocity = _bound(limit, "velocity", f"{where}: velocity", ENDLESS)
    limits = JointLimits(None if free else lower, None if free else upper,
                         effort if effort >= 0.0 else ENDLESS,  # SDF: -1 is no limit
                         velocity if velocity >= 0.0 else ENDLESS)
    damping = number(text_of(dynamics, "damping"), f"{where}: damping", 0.0)
    friction = number(text_of(dynamics, "friction"), f"{where}: friction", 0.0)
    if damping < 0.0 or friction < 0.0:
        raise DescriptionError(f"{where}: damping {damping} and friction {friction} must be ≥ 0")
    stiffness = number(text_of(dynamics, "spring_stiffness"), f"{where}: spring_stiffness", 0.0)
    if stiffness < 0.0:
        raise DescriptionError(f"{where}: spring_stiffness is {stiffness}; it must not be negative")
    rest = number(text_of(dynamics, "spring_reference"), f"{where}: spring_reference", 0.0)
    return replace(joint, kind="continuous" if free else kind, axis=along, limits=limits,
                   damping=damping, friction=friction, stiffness=stiffness, rest=rest)


def _bound(limit: Element | None, tag: str, where: str, default: float) -> float:
    """A limit; SDF's words for none are the default with its sign."""
    text = text_of(limit, tag)
    if text and text.lower().lstrip("+-") in ("inf", "infinity"):
        return -ENDLESS if text.startswith("-") else ENDLESS
    return number(text, where, default)
