"""Modified copies of descriptions, for Gazebo's set_link_properties and set_joint_properties.

    simulation.world.change_model("robot", change_joint(model.description, "elbow", damping=0.5))
"""

import math
from dataclasses import replace
from types import MappingProxyType

from aras_sim_bridge.description.inertia import make_inertial
from aras_sim_bridge.description.types import RobotDescription
from aras_sim_bridge.errors import WorldError
from aras_visual_servo_base.pose_checks import check_vector
from aras_visual_servo_base.poses import Vector3
from aras_visual_servo_base.urdf import JointLimits


def change_link(description: RobotDescription, link: str, mass: float, com: Vector3,
              inertia: tuple[float, float, float, float, float, float],
              gravity: bool) -> RobotDescription:
    """Return the description with another mass, centre of mass and inertia of one link.

    Args:
        description: description of the model.
        link: name of the link.
        mass: mass, kg.
        com: centre of mass in the link frame, m.
        inertia: (ixx, ixy, ixz, iyy, iyz, izz) about the centre of mass in the link's axes, kg m².
        gravity: whether gravity acts on the link.

    Raises:
        WorldError, DescriptionError: unknown link, a number that is not finite, a mass that is not
            positive, or a tensor with a negative principal moment.
    """
    if link not in description.links:
        raise WorldError(
            f"link '{link}' does not exist; existing links: {', '.join(description.links)}"
        )
    where = f"link '{link}'"
    (mass,) = check_vector((mass,), f"{where}: mass", WorldError, 1)
    com = check_vector(com, f"{where}: com", WorldError)
    inertia = check_vector(inertia, f"{where}: inertia", WorldError, 6)
    if mass <= 0.0:
        raise WorldError(f"{where}: mass is {mass} kg; it must be positive")
    inertial = make_inertial(where, mass, com, (0.0, 0.0, 0.0), inertia, [])
    changed = replace(description.links[link], inertial=inertial, gravity=bool(gravity))
    return replace(description, links=MappingProxyType({**description.links, link: changed}))


def change_joint(description: RobotDescription, joint: str, damping: float | None = None,
               friction: float | None = None, lower: float | None = None,
               upper: float | None = None) -> RobotDescription:
    """Return the description with changed parameters of one joint.

    A parameter that is None is not changed.

    Args:
        description: description of the model.
        joint: name of the joint.
        damping: viscous damping, N m s/rad or N s/m.
        friction: Coulomb friction, N m or N.
        lower, upper: stops, rad or m. If both are given, a continuous joint becomes revolute.

    Raises:
        WorldError: the joint is unknown or fixed, a number is not finite, damping or friction is
            negative, or the lower stop is above the upper stop.
    """
    present = description.joints.get(joint)
    if present is None or not present.is_movable:
        raise WorldError(f"joint '{joint}' is not a moving joint; moving joints: "
                         f"{', '.join(description.list_moving_joints()) or 'none'}")
    where = f"joint '{joint}'"
    values = {"damping": damping, "friction": friction, "lower": lower, "upper": upper}
    for name, value in values.items():
        if value is not None and not math.isfinite(value):
            raise WorldError(f"{where}: {name} {value} is not finite; give a finite number")
        if value is not None and name in ("damping", "friction") and value < 0.0:
            raise WorldError(f"{where}: {name} {value} must not be negative")
    changed = replace(present, damping=present.damping if damping is None else float(damping),
                      friction=present.friction if friction is None else float(friction))
    if lower is not None or upper is not None:
        changed = replace(changed, **_change_stops(changed, lower, upper, where))
    return replace(description, joints=MappingProxyType({**description.joints, joint: changed}))


def _change_stops(joint: object, lower: float | None, upper: float | None, where: str) -> dict:
    limits = joint.limits or JointLimits(None, None, math.inf, math.inf)
    low = limits.lower if lower is None else float(lower)
    high = limits.upper if upper is None else float(upper)
    if low is None or high is None:
        raise WorldError(f"{where} has no stops yet; give both lower and upper")
    if low > high:
        raise WorldError(f"{where}: the lower stop {low} is above the upper {high}; exchange them")
    kind = "revolute" if joint.kind == "continuous" else joint.kind
    return {"kind": kind, "limits": replace(limits, lower=low, upper=high)}
