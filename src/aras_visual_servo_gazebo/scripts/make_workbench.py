"""Write world/workbench.world and its meshes, textures and materials in world/workbench/.

    python3 scripts/make_workbench.py [--out DIR]

The world is a workshop around the robot: a wooden floor, brick walls with posters, a wooden board
on the robot's table, and printed boxes, tins, bowls and tools on the board. All shapes are defined
in this file, and all textures in workbench_textures.py. With the same versions of OpenCV and NumPy
the output is bit-identical.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from workbench_textures import write_images

OUT = Path(__file__).resolve().parents[1] / "world"
# Boxes: mesh, material, image, size along x, y, z (m), and size of one copy of the image (m); 0 for
# one copy on each side.
BOXES = (
    ("floor", "boards", "boards.jpg", (6.0, 6.0, 0.02), 1.5),
    ("wall", "bricks", "bricks.jpg", (6.0, 0.12, 2.6), 1.3),
    ("board", "bench", "bench.jpg", (2.0, 1.0, 0.0005), 0.5),
    *((f"poster{n}", "print", f"poster{n}.png", (0.62, 0.004, 0.62), 0.0) for n in range(6)),
    ("carton0", "print", "label0.png", (0.07, 0.05, 0.045), 0.0),
    ("carton1", "print", "label1.png", (0.05, 0.05, 0.06), 0.0),
)
WHITE = (1, 1, 1)
# Surfaces of revolution of each mesh: material, its colour (RGB) and image, profile (radius, z), m,
# from bottom to top, number of sectors, and whether the edges between its sections are sharp.
SURFACES = {
    **{f"tin{n}": (
        ("print", WHITE, f"label{n + 2}.png", [(radius, 0.0), (radius, high)], 36, True),
        ("metal", (0.72, 0.74, 0.76), "", [(radius, high), (radius * 0.94, high),
            (radius * 0.92, high - 0.002), (1e-4, high - 0.002)], 36, True),
    ) for n, (radius, high) in enumerate(((0.026, 0.06), (0.032, 0.045)))},
    "bowl": (
        ("glaze", (0.20, 0.42, 0.62), "", [(0.012, 0.0), (0.020, 0.002), (0.034, 0.012),
            (0.042, 0.026), (0.045, 0.036)], 36, False),
        ("inside", (0.90, 0.88, 0.80), "", [(0.045, 0.036), (0.040, 0.027), (0.031, 0.014),
            (0.018, 0.005), (1e-4, 0.004)], 36, False),
    ),
    "screwdriver": (
        ("handle", (0.80, 0.16, 0.10), "", [(1e-4, 0.0), (0.008, 0.002), (0.011, 0.010),
            (0.009, 0.030), (0.011, 0.055), (0.006, 0.070)], 24, False),
        ("steel", (0.62, 0.64, 0.66), "", [(0.006, 0.070), (0.003, 0.071), (0.003, 0.140),
            (0.0005, 0.150)], 24, True),
    ),
    "lamp": (
        ("shade", (0.16, 0.36, 0.30), "", [(0.16, 0.0), (0.12, 0.06), (0.05, 0.11),
            (0.02, 0.13), (1e-4, 0.135)], 36, False),
    ),
}


class MeshWriter:
    """Writer of an OBJ file of quadrilaterals with texture coordinates and normals."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._lines, self._library = [f"mtllib {name}.mtl"], []
        self._count = 0

    def start_material(self, name: str, colour: tuple[float, float, float], image: str) -> None:
        """Set the material of the following quadrilaterals.

        colour: RGB, 0 to 1.
        image: file name of the texture; '' for none.
        """
        self._library += [f"newmtl {name}", "Kd {:g} {:g} {:g}".format(*colour)]
        self._library += [f"map_Kd {image}"] if image else []
        self._lines.append(f"usemtl {name}")

    def add_quad(self, corners: np.ndarray, normals: np.ndarray, uv: np.ndarray) -> None:
        """Add a quadrilateral with corners (4, 3), counter-clockwise from outside.

        normals: normal vectors (4, 3) at the corners.
        uv: texture coordinates (4, 2) of the corners.
        """
        for kind, rows in (("v", corners), ("vt", uv), ("vn", normals)):
            rounded = np.round(rows, 6) + 0.0  # no -0
            self._lines += [kind + "".join(f" {x:.6g}" for x in row) for row in rounded]
        n = self._count
        for a, b, c in ((1, 2, 3), (1, 3, 4)):
            self._lines.append("f" + "".join(f" {n + k}/{n + k}/{n + k}" for k in (a, b, c)))
        self._count += 4

    def add_box(self, size: tuple[float, float, float], tile_size: float) -> None:
        """Add a box of `size` (x, y, z), m, whose lower side is at z = 0.

        If `tile_size` is 0, the texture covers each side once. Otherwise, it is repeated every
        `tile_size` m.
        """
        x, y, z = size[0] / 2, size[1] / 2, size[2]
        for axis, sign in ((0, 1), (0, -1), (1, 1), (1, -1), (2, 1), (2, -1)):
            normal = np.zeros(3)
            normal[axis] = sign
            across = np.array([0.0, 0, 1]) if axis < 2 else np.array([0.0, 1, 0])
            right = np.cross(across, normal)
            half = np.array([x, y, z / 2])
            wide, high = half @ np.abs(right), half @ np.abs(across)
            middle = normal * (half @ np.abs(normal)) + [0, 0, z / 2]
            steps = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
            corners = middle + steps[:, :1] * wide * right + steps[:, 1:] * high * across
            uv = (steps + 1) / 2
            if tile_size:
                uv = uv * [2 * wide / tile_size, 2 * high / tile_size]
            self.add_quad(corners, np.tile(normal, (4, 1)), uv)

    def add_revolution(self, profile: list[tuple[float, float]], sectors: int, sharp: bool) -> None:
        """Add a surface of revolution about z.

        profile: (radius, z) of its points from bottom to top, m.
        sectors: number of quadrilaterals around the axis.
        sharp: whether the edges between the sections of the profile are shaded as sharp edges.
        """
        angle = np.linspace(0, 2 * np.pi, sectors + 1)
        length = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(profile, axis=0).T))])
        along = np.diff(profile, axis=0)
        slope = [np.array([z, -r]) / max(np.hypot(r, z), 1e-9) for r, z in along]
        at = [slope[0]] + [(a + b) / np.linalg.norm(a + b)
                           for a, b in zip(slope, slope[1:], strict=False)] + [slope[-1]]
        for k, ((r0, z0), (r1, z1)) in enumerate(zip(profile, profile[1:], strict=False)):
            n0, n1 = (slope[k], slope[k]) if sharp else (at[k], at[k + 1])
            for one, two in zip(range(sectors), range(1, sectors + 1), strict=True):
                corners, normals, uv = [], [], []
                for j, r, z, n, up in ((one, r0, z0, n0, k), (two, r0, z0, n0, k),
                                       (two, r1, z1, n1, k + 1), (one, r1, z1, n1, k + 1)):
                    c, s = np.cos(angle[j]), np.sin(angle[j])
                    corners.append((r * c, r * s, z))
                    normals.append((n[0] * c, n[0] * s, n[1]))
                    uv.append((2 * j / sectors, length[up] / length[-1]))
                self.add_quad(np.array(corners), np.array(normals), np.array(uv))

    def write(self, folder: Path) -> None:
        (folder / f"{self.name}.obj").write_text("\n".join(self._lines) + "\n", encoding="ascii")
        (folder / f"{self.name}.mtl").write_text("\n".join(self._library) + "\n", encoding="ascii")


def write_meshes(folder: Path) -> None:
    """Write all meshes."""
    for name, material, image, size, tile_size in BOXES:
        mesh = MeshWriter(name)
        mesh.start_material(material, WHITE, image)
        mesh.add_box(size, tile_size)
        mesh.write(folder)
    for name, surfaces in SURFACES.items():
        mesh = MeshWriter(name)
        for material, colour, image, profile, sectors, sharp in surfaces:
            mesh.start_material(material, colour, image)
            mesh.add_revolution(profile, sectors, sharp)
        mesh.write(folder)


# Name of a mesh, and its pose: x, y, z (m), roll, pitch, yaw (rad).
PlacedMesh = tuple[str, tuple[float, float, float, float, float, float]]
TOP = 0.5905  # height of the upper side of the board on the table, m
OBJECTS_ON_BENCH = (
    ("carton0", 0.22, 0.12, 0.4), ("carton1", 0.30, -0.10, -0.3), ("carton0", -0.24, -0.13, 1.2),
    ("carton1", -0.21, 0.14, 0.8), ("carton0", 0.05, 0.27, 0.1), ("carton1", 0.42, 0.24, 1.0),
    ("carton0", -0.48, 0.06, -0.7), ("tin0", 0.16, 0.21, 0.5), ("tin1", 0.34, 0.06, 2.1),
    ("tin0", -0.31, 0.02, 4.0), ("tin1", -0.10, 0.25, 1.0), ("tin0", 0.10, -0.25, 3.0),
    ("tin1", -0.38, -0.24, 5.0), ("bowl", -0.13, -0.24, 0.0), ("bowl", 0.50, -0.05, 0.0),
    ("tin0", 0.72, 0.18, 1.3), ("carton1", -0.70, 0.20, 0.2), ("carton0", 0.66, -0.28, 2.2),
    ("tin1", -0.62, -0.22, 0.0), ("bowl", -0.40, 0.30, 0.0))
LYING_OBJECTS = (("screwdriver", 0.22, -0.24, 0.6), ("screwdriver", -0.05, 0.36, 2.7),
         ("screwdriver", -0.52, -0.08, 1.1))


def list_objects() -> list[PlacedMesh]:
    """Return the meshes and poses of all objects of the world."""
    found = [("floor", (0, 0, -0.02, 0, 0, 0)), ("wall", (0, 1.66, 0, 0, 0, 0)),
             ("wall", (-3.06, -1.28, 0, 0, 0, 1.5708)), ("board", (0, 0, 0.59, 0, 0, 0))]
    for n in range(14):  # posters on the back wall; the next loop adds the posters on the left wall
        x, z = -2.1 + 0.7 * (n // 2), 0.75 + 0.72 * (n % 2)
        found.append((f"poster{(5 * n + n // 6) % 6}", (x, 1.598, z, 0, 0, 0)))
    for n in range(8):
        y, z = -1.3 + 0.7 * (n // 2), 0.75 + 0.72 * (n % 2)
        found.append((f"poster{(n * 5 + 2) % 6}", (-2.998, y, z, 0, 0, 1.5708)))
    found += [(name, (x, y, TOP, 0, 0, yaw)) for name, x, y, yaw in OBJECTS_ON_BENCH]
    found += [(name, (x, y, TOP + 0.011, 0, 1.5708, yaw)) for name, x, y, yaw in LYING_OBJECTS]
    return [*found, ("lamp", (-0.75, -0.35, 1.42, 0, 0, 0))]


WORLD = """<?xml version="1.0"?>
<!-- A workshop with textures everywhere, shadows and three lights, for photometric,
     feature-matching and learned schemes. Generated by scripts/make_workbench.py. -->
<sdf version="1.6">
  <world name="workbench">
    <gravity>0 0 -9.8</gravity>
    <physics type="ode">
      <max_step_size>0.001</max_step_size>
      <real_time_factor>1</real_time_factor>
      <real_time_update_rate>1000</real_time_update_rate>
    </physics>
    <scene>
      <ambient>0.34 0.36 0.40 1</ambient>
      <background>0.7 0.7 0.7 1</background>
      <sky/>
      <aras:shadows>hard</aras:shadows>
    </scene>
    <light name="sun" type="directional">
      <cast_shadows>1</cast_shadows>
      <diffuse>0.58 0.55 0.48 1</diffuse>
      <direction>-0.55 0.6 -0.9</direction>
    </light>
    <light name="lamp" type="spot">
      <cast_shadows>1</cast_shadows>
      <pose>-0.75 -0.35 1.42 0 0 0</pose>
      <diffuse>0.50 0.42 0.28 1</diffuse>
      <direction>0.75 0.35 -0.85</direction>
      <attenuation><range>6</range><constant>0.7</constant><linear>0.3</linear>
        <quadratic>0.1</quadratic></attenuation>
      <spot><inner_angle>0.9</inner_angle><outer_angle>1.7</outer_angle><falloff>1</falloff></spot>
    </light>
    <light name="window" type="point">
      <cast_shadows>0</cast_shadows>
      <pose>2.4 -2.0 2.2 0 0 0</pose>
      <diffuse>0.16 0.20 0.28 1</diffuse>
      <attenuation><range>12</range><constant>1</constant><linear>0</linear>
        <quadratic>0.02</quadratic></attenuation>
    </light>
    <model name="ground_plane">
      <static>1</static>
      <link name="link">
        <collision name="collision">
          <geometry><plane><normal>0 0 1</normal><size>100 100</size></plane></geometry>
        </collision>
      </link>
    </model>
    <!-- Only the ground plane has collisions; the objects of the workshop have none. -->
    <model name="workshop">
      <static>1</static>
LINKS
    </model>
  </world>
</sdf>
"""
LINK = """      <link name="NAME">
        <pose>POSE</pose>
        <visual name="visual">
          <geometry><mesh><uri>package://aras_visual_servo_gazebo/world/workbench/MESH.obj</uri></mesh>
          </geometry>
        </visual>
      </link>"""


def format_world() -> str:
    """Return the text of workbench.world."""
    links = []
    for n, (name, pose) in enumerate(list_objects()):
        one = LINK.replace("NAME", f"{name}_{n}").replace("MESH", name)
        links.append(one.replace("POSE", " ".join(f"{x:g}" for x in pose)))
    return WORLD.replace("LINKS", "\n".join(links))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__.splitlines()[0],
        epilog="example: python3 src/aras_visual_servo_gazebo/scripts/make_workbench.py",
    )
    parser.add_argument("--out", type=Path, default=OUT)
    out = parser.parse_args().out
    folder = out / "workbench"
    folder.mkdir(parents=True, exist_ok=True)
    write_images(folder)
    write_meshes(folder)
    (out / "workbench.world").write_text(format_world(), encoding="ascii")


if __name__ == "__main__":
    main()
