"""A robot as a browser draws it: its tree of joints, and triangles in colours."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.description.packages import ResolvePackage, find
from aras_sim_bridge.errors import DescriptionError
from aras_visual_servo_base.meshes.mesh import Mesh
from aras_visual_servo_base.poses import transform

from ...drawing.parts import parts

LARGEST = 400_000  # triangles; a browser without a graphics card draws no more at a useful rate


def robot_model(urdf: str, resolve: ResolvePackage = find) -> dict[str, Any]:
    """Plain numbers for JSON.

    Returns:
        {"name", "joints": [{name, kind, parent, child, origin: 16 numbers row by row, axis}],
        "links": {name: [{colour, corners}]}}; corners: base64 of float32, position (m, in the
        link) and normal of each corner of each triangle.

    Raises:
        DescriptionError: the description, or one of its meshes, cannot be used.
    """
    robot = parse_urdf(urdf, resolve)
    links: dict[str, list[dict[str, Any]]] = {}
    count = 0
    for link, colour, mesh in parts(robot, urdf):
        count += len(mesh.triangles)
        links.setdefault(link, []).append({"colour": list(colour), "corners": _encoded(mesh)})
    if count > LARGEST:
        raise DescriptionError(f"{robot.name} has {count} triangles; a page draws {LARGEST}")
    joints = [
        {
            "name": joint.name,
            "kind": joint.kind,
            "parent": joint.parent,
            "child": joint.child,
            "origin": transform(joint.origin_xyz, joint.origin_rpy).ravel().tolist(),
            "axis": list(joint.axis),
        }
        for joint in robot.joints.values()
    ]
    return {"name": robot.name, "root": robot.root, "joints": joints, "links": links}


def _encoded(mesh: Mesh) -> str:
    corners = np.concatenate([mesh.positions, mesh.normals], axis=1)[mesh.triangles.ravel()]
    return base64.b64encode(corners.astype("<f4").tobytes()).decode("ascii")
