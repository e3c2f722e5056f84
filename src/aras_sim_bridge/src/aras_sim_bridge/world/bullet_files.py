"""RobotDescription -> the files that Bullet is given.

Bullet never sees the user's files: only what was read and checked reaches it, written anew, with
principal inertias, and without what the World does itself (damping, friction, limits in effort).
Cameras draw the description, so only Bullet's own window needs visuals.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from xml.sax.saxutils import quoteattr

from aras_sim_bridge.description import shapes
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
from aras_visual_servo_base.meshes import files as mesh_files
from aras_visual_servo_base.meshes.files import write_obj, write_stl
from aras_visual_servo_base.poses import Pose, quaternion_from_matrix
from aras_visual_servo_base.urdf import ZERO, Joint

# Of a link without a visual Bullet makes pictures of the collisions: 4 ms for a plane.
_EMPTY_VISUAL = '<visual><geometry><box size="0 0 0"/></geometry></visual>'
# m: width of the rims of what rolls; what is between them is thinner
_RIM, _RADIUS_MARGIN = 1e-3, 1e-4


def is_root_fixed(description: RobotDescription, requested: bool | None = None) -> bool:
    """Whether the model's root link stays where it is put: as `requested`, if it has mass.

    True for a root named 'world' (ROS's way to bolt a robot down), a root without mass, of its own
    or of links fixed to it (no free body is without), a root that the file calls kinematic
    (`<gazebo reference="root"><kinematic>`: never moved by forces, in Gazebo too) and a static
    model.
    """
    root = give_root_mass(description).links[description.root]
    if requested is None:
        requested = description.static or root.name == "world" or root.kinematic
    return requested or root.inertial is None


def give_root_mass(description: RobotDescription) -> RobotDescription:
    """The same bodies, with mass in the root where that hangs on a fixed joint in the file.

    Many mobile robots have a massless base_link with the chassis fixed to it; Gazebo lumps the two
    together. Bullet would nail such a root to the world, so the heaviest link that is fixed to it
    lends it its inertial; as one rigid body the two move as before.
    """
    root = description.links[description.root]
    if root.inertial is not None or description.static or root.name == "world":
        return description
    found: list[tuple[Link, Pose]] = []
    pending = [(root.name, Pose())]
    while pending:
        parent, root_t_parent = pending.pop()
        for joint in description.joints.values():
            if joint.parent == parent and joint.kind == "fixed":
                pose = root_t_parent @ joint.pose
                pending.append((joint.child, pose))
                found.append((description.links[joint.child], pose))
    found = [(link, pose) for link, pose in found if link.inertial is not None]
    if not found:
        return description
    lender, root_t_lender = max(found, key=lambda pair: pair[0].inertial.mass)
    lent = lender.inertial.with_pose(root_t_lender @ lender.inertial.pose)
    links = dict(description.links)
    links[root.name] = replace(root, inertial=lent, gravity=root.gravity and lender.gravity)
    links[lender.name] = replace(lender, inertial=None)
    return replace(description, links=links)


@lru_cache(maxsize=1024)  # asked three times of each link
def find_principal_frame(inertial: Inertial) -> tuple[Pose, tuple[float, float, float]]:
    """link_T_principal: the frame of Bullet's diagonal inertia in the link, and the moments."""
    moments, axes = principal_axes(inertial.inertia)
    pose = inertial.pose @ Pose((0.0, 0.0, 0.0), quaternion_from_matrix(axes))
    return pose, tuple(float(m) for m in moments)


MEMORY_FOLDER = "/dev/shm"  # noqa: S108


class BulletFiles:
    """A model's URDF and meshes as Bullet reads them, for as long as it does; a context manager.

    They lie beside each other among the temporary files: a folder made and removed for each model
    takes half of its loading. The URDF, which is small, lies in memory where the system has files
    there: removed from a disk it takes 3 ms. Names never come again, for Bullet keeps meshes by
    them.
    """

    def __init__(self, description: RobotDescription, fixed_base: bool, visible: bool) -> None:
        """`visible`: with visuals, for Bullet's window."""
        self._paths: list[str] = []
        self._meshes: dict[str, str] = {}
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

    def write_mesh(self, filename: str) -> str:
        """Where the mesh file `filename` stands for Bullet, in its own unit."""
        if filename not in self._meshes:
            meshes = mesh_files.read(filename)
            pieces = {mesh.piece for mesh in meshes}
            # Bullet makes a convex hull of a whole STL file, and of each object of an OBJ file.
            write_file, kind = (write_obj, "obj") if len(pieces) > 1 else (write_stl, "stl")
            path = self._make_file(kind)
            write_file(meshes, path)
            self._meshes[filename] = path
        return self._meshes[filename]

    def write_plane(self, geometry: Geometry) -> str:
        """A file with a plane's picture, of which Bullet has none."""
        path = self._make_file("stl")
        write_stl(shapes.make_meshes(geometry), path)
        return path

    def _make_file(self, kind: str) -> str:
        folder = MEMORY_FOLDER if kind == "urdf" and os.access(MEMORY_FOLDER, os.W_OK) else None
        handle, path = tempfile.mkstemp(f".{kind}", "aras_sim_bridge_", folder)
        os.close(handle)
        self._paths.append(path)
        return path


def _format_numbers(values: Sequence[float]) -> str:
    return '"' + " ".join(repr(float(v)) for v in values) + '"'


def _format_origin(xyz: Vector3, rpy: Vector3) -> str:
    return f"<origin xyz={_format_numbers(xyz)} rpy={_format_numbers(rpy)}/>"


def _format_link(link: Link, concave: bool, colour: Rgba | None, files: BulletFiles | None) -> str:
    if link.inertial is None:
        pose, mass, moments = Pose(), 0.0, ZERO
    else:
        pose, moments = find_principal_frame(link.inertial)
        mass = link.inertial.mass
    # Bullet complains of moments that break the triangle inequality, and takes zeros; body.py tells
    # it the true ones.
    largest = max(moments)
    ixx, iyy, izz = moments if 2.0 * largest <= sum(moments) else (largest,) * 3
    body = (
        f"<inertial>{_format_origin(pose.xyz, pose.rpy)}<mass value=\"{mass!r}\"/>"
        f'<inertia ixx="{ixx!r}" ixy="0" ixz="0" iyy="{iyy!r}" iyz="0" izz="{izz!r}"/></inertial>'
    )
    if colour is not None:
        # Bullet keeps one material of each name for the whole model.
        look = (
                f"<material name={quoteattr(link.name)}><color rgba={_format_numbers(colour)}/>"
                "</material>"
            )
        body += "".join(f"<visual>{_format_shape(visual, files)}{look}</visual>"
                        for visual in link.visuals)
    elif link.collisions:
        body += _EMPTY_VISUAL
    for collision in link.collisions:
        # A mesh that never moves keeps its hollows (a table inside a frame); Bullet wants moving
        # meshes convex.
        hollow = ' concave="yes"' if concave and collision.geometry.kind == "mesh" else ""
        for part in (collision,) if concave else _split_round_shape(collision):
            body += f"<collision{hollow}>{_format_shape(part, files)}</collision>"
    return f"<link name={quoteattr(link.name)}>{body}</link>"


def _split_round_shape(collision: Collision) -> Iterator[Collision]:
    """A moving cylinder or capsule in three parts, so that it rolls as one line does.

    Bullet finds one point a step where two shapes touch, and keeps those that it found before where
    they were: of a cylinder that rolls, the end that it found a step earlier lags behind, and the
    weight on it drives it on by some percent. Rims at both ends touch in one point each; between
    them the shape is a little thinner.
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
    """Whether shapes of a bolted model that moves would pass through all that never moves.

    Of the joints above a link Bullet leaves out its first link's when it asks whether all are
    fixed: shapes that are fixed to that link never move, by its account.
    """
    joints = list(description.joints.values())
    first = next((joint for joint in joints if joint.parent == description.root), None)
    if first is None or description.static or not first.is_movable:
        return False
    carried = [first.child]
    for link in carried:
        carried += [one.child for one in joints if one.parent == link and not one.is_movable]
    return any(description.links[link].collisions for link in carried[1:])


def _format_empty_link(description: RobotDescription) -> str:
    """A link without mass or shape that becomes Bullet's first one."""
    name = "nobody"
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
    path = quoteattr(files.write_mesh(geometry.filename))
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
