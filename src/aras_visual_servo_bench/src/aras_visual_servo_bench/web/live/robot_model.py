"""Robot model of the live page: tree of joints, and coloured triangles of the links."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.description.packages import ResolvePackage, find_package
from aras_sim_bridge.errors import DescriptionError
from aras_visual_servo_base.meshes.mesh import Mesh
from aras_visual_servo_base.poses import matrix_from_xyz_rpy

from ...visualization.robot_visuals import collect_visuals

# largest number of triangles that a browser without graphics card draws fast enough
MAX_TRIANGLES = 400_000


def make_robot_model(urdf: str, resolve: ResolvePackage = find_package) -> dict[str, Any]:
    """Convert a robot description to a JSON object.

    Args:
        urdf: description of the robot.
        resolve: finds the folder of a ROS package.

    Returns:
        {"name", "root", "joints": [{name, kind, parent, child, origin, axis}], "links": {name:
        [{colour, corners}]}}. `origin` is the pose of the joint, a 4x4 matrix, row by row.
        `corners` is the base64 text of float32 numbers: for each corner of each triangle, the
        position (m, in the link's frame) and the normal.

    Raises:
        DescriptionError: the description or one of its meshes is invalid, or it has too many
            triangles.
    """
    robot = parse_urdf(urdf, resolve)
    links: dict[str, list[dict[str, Any]]] = {}
    count = 0
    for link, colour, mesh in collect_visuals(robot, urdf):
        count += len(mesh.triangles)
        links.setdefault(link, []).append({"colour": list(colour), "corners": _encode_mesh(mesh)})
    if count > MAX_TRIANGLES:
        raise DescriptionError(
            f"the meshes of {robot.name} have {count} triangles, must be at most {MAX_TRIANGLES}; "
            "use simpler meshes"
        )
    joints = [
        {
            "name": joint.name,
            "kind": joint.kind,
            "parent": joint.parent,
            "child": joint.child,
            "origin": matrix_from_xyz_rpy(joint.origin_xyz, joint.origin_rpy).ravel().tolist(),
            "axis": list(joint.axis),
        }
        for joint in robot.joints.values()
    ]
    return {"name": robot.name, "root": robot.root, "joints": joints, "links": links}


def _encode_mesh(mesh: Mesh) -> str:
    corners = np.concatenate([mesh.positions, mesh.normals], axis=1)[mesh.triangles.ravel()]
    return base64.b64encode(corners.astype("<f4").tobytes()).decode("ascii")
