"""Checks before a model is loaded into Bullet, and the start positions of its joints."""

import logging
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

from aras_sim_bridge.description.inertia import principal_axes
from aras_sim_bridge.description.types import Geometry, Inertial, Link, RobotDescription
from aras_sim_bridge.errors import UnknownJointError, WorldError
from aras_visual_servo_base.pose_checks import check_pose
from aras_visual_servo_base.poses import Pose
from aras_visual_servo_base.urdf import Joint

logger = logging.getLogger(__name__)
# Largest length (m) and mass (kg) of a model's parts. Beyond this length, coordinates in double
# precision do not resolve a micrometre, and Bullet's bounding boxes overflow.
LARGEST = 1e9
# Smallest size of a shape (m) and smallest mass of a link (kg).
SMALLEST = 1e-9
# Largest number of links of a model. PyBullet returns no data for models with more links.
MOST_LINKS = 128


def check_simulable(description: RobotDescription, name: str) -> None:
    """Check that a model has finite sizes, valid inertias and at most MOST_LINKS links.

    Raises:
        WorldError: the message names the model, the link or joint, the fault and the remedy.
    """
    if len(description.links) > MOST_LINKS:
        raise WorldError(f"model '{name}' has {len(description.links)} links; Bullet simulates "
                         f"at most {MOST_LINKS} in one model: merge links that are fixed to each "
                         "other, or split the model")
    for link in description.links.values():
        for where, size, smallest in _list_sizes(link):
            if not size <= LARGEST:  # this condition is also true if `size` is NaN
                raise WorldError(f"model '{name}', link '{link.name}': {where} is {size:.4g} m, "
                                 f"must be at most {LARGEST:.0e} m; reduce it")
            if size < smallest:
                raise WorldError(f"model '{name}', link '{link.name}': {where} is {size:.4g} m, "
                                 f"must be at least {smallest:.0e} m; increase it")
        if link.inertial is not None and not description.static:
            _check_inertial(link.inertial, f"model '{name}', link '{link.name}'")
    for joint in description.joints.values():
        distance = math.hypot(*joint.origin_xyz)
        if not distance <= LARGEST:
            raise WorldError(
                f"model '{name}', joint '{joint.name}': <origin> is {distance:.4g} m from the "
                f"parent link, must be at most {LARGEST:.0e} m; correct xyz"
            )
    if not description.static:
        _check_joints(description, name)


def _list_sizes(link: Link) -> Iterator[tuple[str, float, float]]:
    """Yield the name, the value and the smallest valid value (m) of each length of a link."""
    if link.inertial is not None:
        yield "the offset of the centre of mass", math.hypot(*link.inertial.origin_xyz), 0.0
    for kind, parts in (("visual", link.visuals), ("collision", link.collisions)):
        for part in parts:
            yield f"the offset of a {kind}", math.hypot(*part.origin_xyz), 0.0
            for size in _list_extents(part.geometry):
                yield f"the {part.geometry.kind} size of a {kind}", size, SMALLEST


def _list_extents(geometry: Geometry) -> tuple[float, ...]:
    if geometry.kind == "box":
        return geometry.size
    if geometry.kind == "mesh":
        return tuple(abs(factor) for factor in geometry.scale)
    return tuple(size for size in (geometry.radius, geometry.length) if size)


def _check_inertial(inertial: Inertial, where: str) -> None:
    if not SMALLEST <= inertial.mass <= LARGEST:
        raise WorldError(f"{where}: a mass of {inertial.mass:.4g} kg is not between "
                         f"{SMALLEST:.0e} and {LARGEST:.0e} kg; correct its <inertial>")
    if not all(map(math.isfinite, inertial.inertia)):
        raise WorldError(
            f"{where}: the inertia tensor {inertial.inertia} is not finite; correct it"
        )
    moments = sorted(float(moment) for moment in principal_axes(inertial.inertia)[0])
    if moments[0] < -1e-9 * moments[2] or not moments[2] > 0.0:
        raise WorldError(f"{where}: the inertia tensor has the principal moments "
                         f"{', '.join(f'{m:.4g}' for m in moments)} kg m²; they must be positive; "
                         "correct it")
    radius = math.sqrt(moments[2] / inertial.mass)
    if not SMALLEST <= radius <= LARGEST:
        raise WorldError(f"{where}: an inertia of {moments[2]:.4g} kg m² does not fit a mass of "
                         f"{inertial.mass:.4g} kg, because the radius of gyration would be "
                         f"{radius:.4g} m; correct the mass or the inertia")


def _check_joints(description: RobotDescription, name: str) -> None:
    """Check that every moving joint moves some mass."""
    for joint in _list_massless_joints(description):
        raise WorldError(
            f"model '{name}': joint '{joint.name}' moves link '{joint.child}', which has no mass; "
            "add an <inertial> to this link"
        )


def _list_massless_joints(description: RobotDescription) -> list[Joint]:
    """Return the moving joints below which no link has mass."""
    parents = {joint.child: joint.parent for joint in description.joints.values()}
    with_mass: set[str] = set()  # names of links that have mass, or a descendant with mass
    for link in description.links.values():
        name_above = link.name if link.inertial is not None else None
        while name_above is not None and name_above not in with_mass:
            with_mass.add(name_above)
            name_above = parents.get(name_above)
    return [joint for joint in description.joints.values()
            if joint.is_movable and joint.child not in with_mass]


def fix_massless_joints(description: RobotDescription, name: str) -> RobotDescription:
    """Return the description with the joints fixed that move no mass; a warning is logged for each.

    Gazebo leaves out the links below such a joint. Here they remain visible.
    """
    massless = [] if description.static else _list_massless_joints(description)
    if not massless:
        return description
    joints = dict(description.joints)
    for joint in massless:
        logger.warning("model '%s': joint '%s' does not move, because it moves no mass; add an "
                       "<inertial> to link '%s'", name, joint.name, joint.child)
        joints[joint.name] = replace(joint, kind="fixed", mimic=None)
    for joint in description.joints.values():
        leader = None if joint.mimic is None else joints[joint.mimic.joint]
        if joints[joint.name].is_movable and leader is not None and not leader.is_movable:
            logger.warning("model '%s': joint '%s' moves freely, because joint '%s', which it "
                           "mimics, does not move", name, joint.name, leader.name)
            joints[joint.name] = replace(joint, mimic=None)
    return replace(description, joints=MappingProxyType(joints))


def check_start_pose(pose: object, name: str) -> Pose:
    """Return the pose of a model with a normalised quaternion; a zero quaternion is the identity.

    Raises:
        WorldError: a number is not finite, or the position is too far away.
    """
    pose = check_pose(pose, f"model '{name}'", WorldError, zero_is_identity=True)
    if math.hypot(*pose.xyz) > LARGEST:
        raise WorldError(f"model '{name}': position {pose.xyz} is beyond {LARGEST:.0e} m")
    return pose


def compute_start_positions(
    descriptions: Sequence[RobotDescription], name: str, positions: Mapping[str, float]
) -> list[dict[str, float]]:
    """Return the start positions of the joints (rad or m), one mapping per description.

    A model consists of several descriptions if joints do not connect all its links. Joints that
    mimic one in `positions` follow it.

    Raises:
        WorldError: a joint does not exist or does not move, or a position is not finite.
    """
    every = tuple(joint for one in descriptions for joint in one.list_moving_joints())
    for joint, value in positions.items():
        if joint not in every:
            raise UnknownJointError(name, joint, every)
        if not math.isfinite(value):
            raise WorldError(f"model '{name}', joint '{joint}': position {value} is not finite; "
                             "give a finite number")
    starts = []
    for description in descriptions:
        moving = description.list_moving_joints()
        start = {joint: float(value) for joint, value in positions.items() if joint in moving}
        for _ in moving:  # repeated, because a joint may mimic one that mimics another one
            for joint in moving:
                mimic = description.joints[joint].mimic
                if mimic is not None and joint not in positions:
                    start[joint] = mimic.multiplier * start.get(mimic.joint, 0.0) + mimic.offset
        starts.append(start)
    return starts
