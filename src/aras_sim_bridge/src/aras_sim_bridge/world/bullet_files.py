"""Temporary URDF and mesh files through which a RobotDescription is loaded into Bullet.

Bullet never reads the user's files. It reads new files that contain the checked data and principal
inertias. They do not contain damping, friction and effort limits, which World applies itself. They
contain visuals only for Bullet's own window, because the camera images are rendered from the
description.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from xml.sax.saxutils import quoteattr

from aras_sim_bridge.description import shape_meshes
from aras_sim_bridge.description.gazebo_materials import WHITE
from aras_sim_bridge.description.inertia import principal_axes
from aras_sim_bridge.description.types import (
    Collision,
    Geometry,
    Inertial,
    Link,
    Rgba,
    RobotDescription,
    Vector3,
    Visual,
)
from aras_visual_servo_base.meshes.files import write_obj, write_stl
from aras_visual_servo_base.poses import Pose, quaternion_from_matrix
from aras_visual_servo_base.urdf import ZERO, Joint

# Visual of a link that has none. Without a visual, Bullet would build graphics from the link's
# collision shapes, which takes 4 ms for a plane.
_EMPTY_VISUAL = '<visual><geometry><box size="0 0 0"/></geometry></visual>'
# _RIM is the width of the two rims of a rolling shape, m. Between the rims, the radius of the shape
# is smaller by _RADIUS_MARGIN, m. See _split_round_shape.
_RIM, _RADIUS_MARGIN = 1e-3, 1e-4


def is_root_fixed(description: RobotDescription, requested: bool | None = None) -> bool:
    """Return whether the root link of a model is fixed in the world.

    A root without mass is always fixed; links that are fixed to the root count towards its mass.
    Otherwise `requested` decides. If `requested` is None, the root is fixed in three cases: the
    model is static, the root is named 'world' (the ROS convention), or the root is marked as
    kinematic with `<gazebo reference="root"><kinematic>`. In Gazebo, too, forces do not move a
    kinematic link.
    """
    root = give_root_mass(description).links[description.root]
    if requested is None:
        requested = description.static or root.name == "world" or root.kinematic
    return requested or root.inertial is None


def give_root_mass(description: RobotDescription) -> RobotDescription:
    """Return the description with mass in the root link, if a link that is fixed to it has mass.

    Many mobile robots have a massless base_link to which the chassis is fixed. Gazebo merges the
    two, but Bullet would fix a massless root in the world. Therefore the inertial of the heaviest
    link that is fixed to the root is moved to the root. This does not change the motion, because
    both links belong to one rigid body.
    """
    root = description.links[description.root]
    if root.inertial is not None or description.static or root.name == "world":
        return description
    found: list[tuple[Link, Pose]] = []
    pending = [(root.name, Pose())]
    while pending:
        parent, root_t_parent = pending.pop()
        for joint in description.list_child_joints(parent):
            if joint.kind == "fixed":
                pose = root_t_parent @ joint.pose
                pending.append((joint.child, pose))
                found.append((description.links[joint.child], pose))
    found = [(link, pose) for link, pose in found if link.inertial is not None]
    if not found:
        return description
    heaviest, root_t_heaviest = max(found, key=lambda pair: pair[0].inertial.mass)
    lent = heaviest.inertial.with_pose(root_t_heaviest @ heaviest.inertial.pose)
    links = dict(description.links)
    links[root.name] = replace(root, inertial=lent, gravity=root.gravity and heaviest.gravity)
    links[heaviest.name] = replace(heaviest, inertial=None)
    return replace(description, links=links)


@lru_cache(maxsize=1024)  # cached, because each link needs the result three times
def find_principal_frame(inertial: Inertial) -> tuple[Pose, tuple[float, float, float]]:
    """Return the pose link_T_principal of the principal axes, and the principal moments.

    The unit of the moments is kg m².
    """
    moments, axes = principal_axes(inertial.inertia)
    pose = inertial.pose @ Pose((0.0, 0.0, 0.0), quaternion_from_matrix(axes))
    return pose, tuple(float(m) for m in moments)


MEMORY_FOLDER = "/dev/shm"  # noqa: S108


class BulletFiles:
    """Temporary URDF and mesh files of one model; a context manager that removes them.

    The files are placed directly in the temporary folder, because creating and removing a folder
    for each model would take half of the loading time. The URDF is small; it is written to a file
    system in memory if there is one, because removing it from a disk takes 3 ms. File names are
    unique, because Bullet caches meshes by name.
    """

    def __init__(self, description: RobotDescription, fixed_base: bool, visible: bool) -> None:
        """Write the files. They contain visuals for Bullet's window only if `visible` is True."""
        self._paths: list[str] = []
        self._meshes: dict[tuple[str, str, bool], str] = {}
        parts = ['<?xml version="1.0"?>', f"<robot name={quoteattr(description.name)}>"]
        try:
            for link in description.links.values():
                colour = description.colours.get(link.name, WHITE) if visible else None
                fixed = fixed_base and link.name == description.root
                parts.append(_format_link(link, fixed, colour, self))
            if fixed_base and _needs_empty_link(description):
                parts.append(_format_empty_link(description))
            parts += [
                _format_joint(joint, description.static) for joint in description.joints.values()
            ]
            parts.append("</robot>")
            self.urdf = self._make_file("urdf")
            with open(self.urdf, "w", encoding="utf-8") as file:
                file.write("\n".join(parts))
        except BaseException:
            self.remove()
            raise

    def __enter__(self) -> BulletFiles:
        return self

    def __exit__(self, *_: object) -> None:
        self.remove()

    def remove(self) -> None:
        """Remove the files."""
        while self._paths:
            with suppress(FileNotFoundError):
                os.remove(self._paths.pop())

    def write_mesh(self, geometry: Geometry) -> str:
        """Write a copy of a mesh that Bullet can read, in the unit of its file; return its path."""
        key = geometry.filename, geometry.submesh, geometry.is_centred
        if key not in self._meshes:
            meshes = shape_meshes.read_mesh(geometry)
            pieces = {mesh.piece for mesh in meshes}
            # Bullet builds one convex hull per STL file, and one per object of an OBJ file.
            # Therefore several pieces need an OBJ file.
            write_file, kind = (write_obj, "obj") if len(pieces) > 1 else (write_stl, "stl")
            path = self._make_file(kind)
            write_file(meshes, path)
            self._meshes[key] = path
        return self._meshes[key]

    def write_plane(self, geometry: Geometry) -> str:
        """Write a mesh that shows a plane, because Bullet does not draw planes; return its path."""
        path = self._make_file("stl")
        write_stl(shape_meshes.make_meshes(geometry), path)
        return path

    def _make_file(self, kind: str) -> str:
        folder = MEMORY_FOLDER if kind == "urdf" and os.access(MEMORY_FOLDER, os.W_OK) else None
        handle, path = tempfile.mkstemp(f".{kind}", "aras_sim_bridge_", folder)
        os.close(handle)
        self._paths.append(path)
        return path


def _format_numbers(values: Sequence[float]) -> str:
    return '"' + " ".join(map(repr, map(float, values))) + '"'


def _format_origin(xyz: Vector3, rpy: Vector3) -> str:
    return f"<origin xyz={_format_numbers(xyz)} rpy={_format_numbers(rpy)}/>"


def _format_link(link: Link, concave: bool, colour: Rgba | None, files: BulletFiles | None) -> str:
    if link.inertial is None:
        pose, mass, moments = Pose(), 0.0, ZERO
    else:
        pose, moments = find_principal_frame(link.inertial)
        mass = link.inertial.mass
    # Bullet sets principal moments that violate the triangle inequality to zero. Therefore load
    # moments that fulfil it; bullet_body.py sets the true ones afterwards.
    largest = max(moments)
    ixx, iyy, izz = moments if 2.0 * largest <= sum(moments) else (largest,) * 3
    body = (
        f"<inertial>{_format_origin(pose.xyz, pose.rpy)}<mass value=\"{mass!r}\"/>"
        f'<inertia ixx="{ixx!r}" ixy="0" ixz="0" iyy="{iyy!r}" iyz="0" izz="{izz!r}"/></inertial>'
    )
    if colour is not None:
        # Name the material after the link: Bullet stores the materials of a whole model by name, so
        # equal names would share one material.
        material = (
                f"<material name={quoteattr(link.name)}><color rgba={_format_numbers(colour)}/>"
                "</material>"
            )
        body += "".join(f"\n<visual>{_format_shape(visual, files)}{material}</visual>"
                        for visual in link.visuals)
    elif link.collisions:
        body += _EMPTY_VISUAL
    for collision in link.collisions:
        # A mesh that never moves may be concave, such as a table with a frame below it. Bullet
        # requires moving meshes to be convex.
        hollow = ' concave="yes"' if concave and collision.geometry.kind == "mesh" else ""
        for part in (collision,) if concave else _split_round_shape(collision):
            # Bullet splits lines of more than 8191 bytes, so each shape needs its own line.
            body += f"\n<collision{hollow}>{_format_shape(part, files)}</collision>"
    return f"<link name={quoteattr(link.name)}>{body}</link>"


def _split_round_shape(collision: Collision) -> Iterator[Collision]:
    """Split a moving cylinder or capsule into a middle part and two rims, so that it rolls freely.

    A rolling cylinder needs a contact point at both ends, but Bullet finds only one point per pair
    of shapes in each step. The point at the other end is from an earlier step and lags behind, so
    that the weight on it accelerates the cylinder. Each rim has its own contact point; the middle
    part is slightly thinner and touches nothing.
    """
    shape, half = collision.geometry, 0.5 * collision.geometry.length
    if shape.kind not in ("cylinder", "capsule"):
        yield collision
        return
    thinner = min(_RADIUS_MARGIN, 0.01 * shape.radius)
    if shape.kind == "capsule":
        middle = replace(shape, radius=shape.radius - thinner)
        rim = Geometry("sphere", radius=shape.radius)
    else:
        middle = replace(shape, radius=shape.radius - thinner, length=0.98 * shape.length)
        rim = replace(shape, length=min(_RIM, half))
        half -= 0.5 * rim.length
    yield replace(collision, geometry=middle)
    for end in (-half, half):
        yield replace(collision, geometry=rim).with_pose(collision.pose @ Pose((0.0, 0.0, end)))


def _needs_empty_link(description: RobotDescription) -> bool:
    """Return whether an empty first link is needed so that moving links collide with static bodies.

    If the first link moves, Bullet wrongly treats the links that are fixed to it as static, and
    does not test them against other static bodies. This does not happen if the first link is empty
    and fixed.
    """
    first = next(iter(description.list_child_joints(description.root)), None)
    if first is None or description.static or not first.is_movable:
        return False
    fixed_links = [first.child]
    for link in fixed_links:
        fixed_links += [one.child for one in description.list_child_joints(link)
                        if not one.is_movable]
    return any(description.links[link].collisions for link in fixed_links[1:])


def _format_empty_link(description: RobotDescription) -> str:
    """Return the URDF text of a link without mass and shapes, which becomes Bullet's first link."""
    name = "empty"
    while name in description.links or name in description.joints:
        name += "_"
    return _format_link(Link(name, None), False, None, None) + _format_joint(
        Joint(name, "fixed", description.root, name), True)


def _format_shape(part: Visual | Collision, files: BulletFiles) -> str:
    shape = _format_geometry(part.geometry, files)
    if isinstance(part, Visual) and part.geometry.kind == "plane":
        shape = f"<mesh filename={quoteattr(files.write_plane(part.geometry))}/>"
    return f"{_format_origin(part.origin_xyz, part.origin_rpy)}<geometry>{shape}</geometry>"


def _format_geometry(geometry: Geometry, files: BulletFiles) -> str:
    if geometry.kind == "box":
        return f"<box size={_format_numbers(geometry.size)}/>"
    if geometry.kind in ("cylinder", "capsule"):
        return f'<{geometry.kind} radius="{geometry.radius!r}" length="{geometry.length!r}"/>'
    if geometry.kind == "sphere":
        return f'<sphere radius="{geometry.radius!r}"/>'
    if geometry.kind == "plane":
        return f"<plane normal={_format_numbers(geometry.normal)}/>"
    path = quoteattr(files.write_mesh(geometry))
    return f"<mesh filename={path} scale={_format_numbers(geometry.scale)}/>"


def _format_joint(joint: Joint, static: bool) -> str:
    kind = "fixed" if static else joint.kind
    limit = ""
    if kind in ("revolute", "prismatic") and joint.limits is not None:
        limit = (
            f'<limit lower="{joint.limits.lower!r}" upper="{joint.limits.upper!r}" '
            f'effort="{joint.limits.effort!r}" velocity="{joint.limits.velocity!r}"/>'
        )
    axis = f"<axis xyz={_format_numbers(joint.axis)}/>" if kind != "fixed" else ""
    return (
        f'<joint name={quoteattr(joint.name)} type="{kind}">'
        f"{_format_origin(joint.origin_xyz, joint.origin_rpy)}<parent "
        f"link={quoteattr(joint.parent)}/>"
        f"<child link={quoteattr(joint.child)}/>{axis}{limit}</joint>"
    )
