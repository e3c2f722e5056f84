"""Write the files of a target for a simulated world: URDF, mesh and texture.

    rosrun aras_visual_servo_bench target_files four_dots --size 0.1 0.1 --out DIR
    (or python3 -m aras_visual_servo_bench.targets.target_files)

The face of a flat target is in the plane z = 0 of the target frame, and its normal is the z axis.
The model is static and has no collision shape, unless the target is on a movable box.
"""

from __future__ import annotations

import argparse
import sys
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from aras_visual_servo_camera.polygons import signed_area

from ..errors import ExperimentError, catch_write_errors, require
from .geometry import Target
from .target_factory import find_default_size
from .target_spec import SupportBoxSpec, TargetSpec, Vector2
from .temporary_folders import make_scratch_folder

if TYPE_CHECKING:
    from .solids import SolidTarget

OCCLUDER_HEIGHT = 5e-4  # distance of an occluder from the face of its target, m
URDF = """<?xml version="1.0"?>
<robot name="{name}">
  <link name="{name}">
    <visual>
      <geometry><mesh filename="{mesh}"{scale}/></geometry>
    </visual>{more}
  </link>
  {physics}
</robot>
"""
SCALE = ' scale="{!r} {!r} {!r}"'
STATIC = "<gazebo><static>true</static></gazebo>"
BOX = """
    <visual name="box"><origin xyz="0 0 {z!r}"/><geometry><box size="{size}"/></geometry></visual>
    <collision><origin xyz="0 0 {z!r}"/><geometry><box size="{size}"/></geometry></collision>
    <inertial><origin xyz="0 0 {z!r}"/><mass value="{mass!r}"/>
      <inertia ixx="{ixx!r}" iyy="{iyy!r}" izz="{izz!r}" ixy="0" ixz="0" iyz="0"/></inertial>"""
FRICTION = '<gazebo reference="{name}"><mu1>{friction!r}</mu1></gazebo>'
GREY = '<gazebo reference="{name}"><material>Gazebo/Grey</material></gazebo>'
OCCLUDER = """
    <visual name="occluder">
      <origin xyz="0 0 {z:.9g}" rpy="0 0 0"/>
      <geometry><mesh filename="{mesh}"/></geometry>
    </visual>"""


def write_target(
    target: Target, folder: Path, name: str = "target", meshes: str = "",
    occluder: tuple[Vector2, Vector2] | None = None, box: SupportBoxSpec | None = None,
) -> Path:
    """Write the files of a target, and return the path of its URDF.

    Args:
        target: geometry of a flat or solid target.
        folder: folder into which the files are written.
        name: name of the files, of the model and of its link.
        meshes: URL of `folder` with which the paths of meshes in the URDF start; '': the absolute
            path of `folder`.
        occluder: lower and upper corner (x, y), m, of a white rectangle on the target; None: no
            occluder.
        box: movable box under the target; None: no box.

    Raises:
        ExperimentError: the target is neither flat nor solid, or the folder cannot be written to.
    """
    if target.is_solid:
        return _write_solid(target, folder, name)
    vertices = target.vertices()
    require(
        bool(np.abs(vertices[:, 2]).max() < 1e-9),
        "target.shape 'aras' is part of the robot description and has no files: use another shape",
    )
    where = meshes or f"file://{folder.resolve()}"
    with catch_write_errors(f"the target into {folder}", ExperimentError):
        folder.mkdir(parents=True, exist_ok=True)
        if target.is_textured:
            # The corners of each triangle are counter-clockwise when viewed from above.
            faces = [(0, 3, 2), (0, 2, 1)]
            material = f"Kd 1 1 1\nmap_Kd {name}.png\n"
            is_written = cv2.imwrite(str(folder / f"{name}.png"), target.pixels)
            require(is_written,
                    f"cannot write the target's texture into {folder}: give a writable folder")
        else:
            faces, material = triangulate(vertices[:, :2]), "Kd 0 0 0\n"
        _write_mesh(folder, name, vertices, faces, material)
        more = ""
        if occluder is not None:
            _write_white_rectangle(folder, f"{name}_occluder", occluder)
            more = OCCLUDER.format(z=OCCLUDER_HEIGHT, mesh=f"{where}/{name}_occluder.obj")
        physics = STATIC
        if box is not None:
            physics = FRICTION.format(name=name, friction=box.friction)
            more += _make_box(box)
        path = folder / f"{name}.urdf"
        mesh = f"{where}/{name}.obj"
        path.write_text(URDF.format(name=name, mesh=mesh, scale="", more=more, physics=physics))
    return path


def _write_solid(target: SolidTarget, folder: Path, name: str) -> Path:
    """Write the URDF of a static solid, and return its path."""
    with catch_write_errors(f"the target into {folder}", ExperimentError):
        folder.mkdir(parents=True, exist_ok=True)
        path, mesh = folder / f"{name}.urdf", target.coloured_path or target.path
        grey = "" if target.has_colour else GREY.format(name=name)
        if target.is_temporary:
            mesh = folder.resolve() / f"{name}.obj"
            mesh.write_text(target.path.read_text())
        path.write_text(URDF.format(
            name=name, mesh=f"file://{mesh}", scale=SCALE.format(*target.scale), more="",
            physics=STATIC + grey,
        ))  # fmt: skip
    return path


def _make_box(box: SupportBoxSpec) -> str:
    """Return the URDF elements of a box under a target; the box ends slightly below the target."""
    (x, y, z), twelfth = box.size, box.mass / 12.0
    return BOX.format(
        size=f"{x!r} {y!r} {z!r}", z=-0.5 * z - OCCLUDER_HEIGHT, mass=box.mass,
        ixx=twelfth * (y * y + z * z),
        iyy=twelfth * (x * x + z * z), izz=twelfth * (x * x + y * y),
    )  # fmt: skip


@lru_cache(maxsize=64)
def write_description(spec: TargetSpec, perturbation_seed: int | None = None) -> Path:
    """Write the URDF of an experiment's target into a temporary folder, and return its path.

    Each target is written only once per process.

    Args:
        spec: settings of the target.
        perturbation_seed: seed of the random changes of the texture; None: no changes.

    Raises:
        ExperimentError: the target cannot be read, or has no texture that could be changed.
    """
    target = spec.placed_target.shape
    if perturbation_seed is not None:
        require(
            target.is_textured,
            f"target '{spec.shape}' has no texture that could be perturbed: use poster or a PNG",
        )
        target = target.perturb(perturbation_seed)
    permanent = spec.occluder if spec.occluded is None else None
    return write_target(target, make_scratch_folder(), occluder=permanent, box=spec.box)


@lru_cache(maxsize=64)
def write_occluder(rectangle: tuple[Vector2, Vector2]) -> Path:
    """Write the URDF of a white rectangle, and return its path.

    rectangle: lower and upper corner (x, y), m.
    """
    folder, name = make_scratch_folder(), "occluder"
    _write_white_rectangle(folder, name, rectangle)
    path = folder / f"{name}.urdf"
    path.write_text(URDF.format(
        name=name, mesh=f"file://{folder.resolve()}/{name}.obj", scale="", more="",
        physics=STATIC,
    ))  # fmt: skip
    return path


def triangulate(corners: np.ndarray) -> list[tuple[int, int, int]]:
    """Triangulate a polygon by ear clipping.

    corners: corners (n, 2) of a polygon whose edges do not cross.

    Returns:
        Indices of the three corners of each triangle, counter-clockwise.

    Raises:
        ExperimentError: the edges cross, or the polygon has no area.
    """
    order = list(range(len(corners)))
    if signed_area(corners) < 0.0:
        order.reverse()
    triangles = []
    while len(order) > 3:
        ear = next((k for k in range(len(order)) if _is_ear(corners, order, k)), None)
        if ear is None:
            raise ExperimentError(
                "target.shape: the polygon has no area, or its edges cross; correct its corners"
            )
        triangles.append((order[ear - 1], order[ear], order[(ear + 1) % len(order)]))
        del order[ear]
    return [*triangles, tuple(order)]


def _is_ear(corners: np.ndarray, order: list[int], k: int) -> bool:
    """Return whether the triangle at corner order[k] of a polygon contains no other corner."""
    a, b, c = order[k - 1], order[k], order[(k + 1) % len(order)]
    return _signed_area(corners, a, b, c) > 0.0 and not any(
        _signed_area(corners, a, b, i) >= 0.0
        and _signed_area(corners, b, c, i) >= 0.0
        and _signed_area(corners, c, a, i) >= 0.0
        for i in order if i not in (a, b, c)
    )  # fmt: skip


def _signed_area(corners: np.ndarray, a: int, b: int, c: int) -> float:
    """Return twice the area of the triangle a, b, c; it is negative if they are clockwise."""
    (ax, ay), (bx, by), (cx, cy) = corners[a], corners[b], corners[c]
    return float((bx - ax) * (cy - ay) - (by - ay) * (cx - ax))


def _write_white_rectangle(folder: Path, name: str, rectangle: tuple[Vector2, Vector2]) -> None:
    """Write the mesh of a white rectangle in the plane z = 0."""
    (x0, y0), (x1, y1) = rectangle
    corners = np.array([(x0, y0, 0), (x1, y0, 0), (x1, y1, 0), (x0, y1, 0)], float)
    _write_mesh(folder, name, corners, [(0, 1, 2), (0, 2, 3)], "Kd 1 1 1\n")


def _write_mesh(
    folder: Path, name: str, vertices: np.ndarray, faces: list[tuple[int, int, int]], material: str
) -> None:
    """Write an OBJ file with vertices (n, 3), m, and one material.

    If the material has a texture, it covers the bounding rectangle of the vertices.
    """
    low, span = vertices[:, :2].min(axis=0), np.ptp(vertices[:, :2], axis=0)
    lines = [f"mtllib {name}.mtl", "usemtl face"]
    lines += ["v {:.9g} {:.9g} {:.9g}".format(*vertex) for vertex in vertices]
    lines += ["vt {:.9g} {:.9g}".format(*((vertex[:2] - low) / span)) for vertex in vertices]
    lines += ["f " + " ".join(f"{i + 1}/{i + 1}" for i in face) for face in faces]
    (folder / f"{name}.obj").write_text("\n".join(lines) + "\n")
    (folder / f"{name}.mtl").write_text(f"newmtl face\n{material}")


def main(argv: list[str] | None = None) -> int:
    """Write the files of a target; return the exit status."""
    parser = argparse.ArgumentParser(
        prog="target_files", description=__doc__.splitlines()[0],
        epilog="example: rosrun aras_visual_servo_bench target_files l_shape --size 0.1 0.08",
    )  # fmt: skip
    parser.add_argument("shape", help="name of a target, or path of an image, an SVG or a mesh")
    parser.add_argument("--size", type=float, nargs="+",
                        help="lengths along x and y (for a solid: x, y and z), m (default: "
                        "the size in an SVG or a mesh, otherwise 0.1 each)")  # fmt: skip
    parser.add_argument("--scale", type=float,
                        help="factor on the lengths of a mesh, such as 0.001 for mm")
    parser.add_argument("--marker", default="",
                        help="marker of the shape 'marker', such as DICT_5X5_100:5")
    parser.add_argument("--occluder", type=float, nargs=4, metavar=("X0", "Y0", "X1", "Y1"),
                        help="opposite corners of a white rectangle that covers part of the "
                             "target, m")
    parser.add_argument("--name", help="name of the files and of the model")
    parser.add_argument("--meshes", default="",
                        help="URL of the folder in the URDF (default: its path)")
    parser.add_argument("--out", type=Path, required=True, help="folder to write to")
    options = parser.parse_args(argv)
    try:
        size = tuple(options.size) if options.size else find_default_size(options.shape)
        spec = TargetSpec(options.shape, size, scale=options.scale, marker=options.marker)
        covered = options.occluder and (tuple(options.occluder[:2]), tuple(options.occluder[2:]))
        path = write_target(
            spec.placed_target.shape, options.out,
            options.name or Path(options.shape).stem, options.meshes, covered or None,
        )  # fmt: skip
    except ExperimentError as error:
        print(f"target_files: {error}", file=sys.stderr)
        return 1
    print(f"wrote {path}: roslaunch ... target:={path.resolve()}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
