"""Write world/workbench.world and its meshes, textures and materials in world/workbench/.

    python3 scripts/make_workbench.py [--out DIR]

The world is a workshop around the robot: a wooden floor, brick walls with posters, a wooden board
on the robot's table, and printed boxes, tins, bowls and tools on the board. All shapes are defined
in this file, and all textures are generated with a fixed seed. With the same versions of OpenCV and
NumPy the output is bit-identical.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np

SEED = 2016
OUT = Path(__file__).resolve().parents[1] / "world"
INK = (40, 36, 34)
PAPERS = ((214, 228, 240), (196, 214, 226), (225, 225, 214), (205, 220, 205))
PAINTS = ((60, 90, 200), (170, 110, 40), (60, 150, 80), (40, 160, 220), (140, 70, 140),
          (190, 170, 60), (50, 50, 170), (120, 160, 30))


def make_noise(rng: np.random.Generator, shape: tuple[int, int], scales: tuple[int, ...]
           ) -> np.ndarray:
    """Return smooth noise (H, W) between 0 and 1.

    scales: distances, px. For each of them, random values on a grid with this distance are
        interpolated, and added with a weight that increases with the distance.
    """
    total = np.zeros(shape)
    for scale in scales:
        knots = rng.uniform(-1, 1, (shape[0] // scale + 4, shape[1] // scale + 4))
        fine = cv2.resize(knots, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
        total += scale**0.7 * fine[scale:scale + shape[0], scale:scale + shape[1]]
    total -= total.min()
    return total / total.max()


def mix_colours(share: np.ndarray, dark: tuple[int, ...], bright: tuple[int, ...]) -> np.ndarray:
    """Return colours (H, W, 3) between `dark` and `bright`, in the order blue, green, red.

    share: (H, W) fraction of `bright`, 0 to 1.
    """
    return np.array(dark) + share[..., None] * (np.array(bright, float) - dark)


def draw_wood(rng: np.random.Generator, boards: int, size: int = 1024) -> np.ndarray:
    """Return a texture of parallel wooden boards whose grain is along the rows of pixels."""
    image = np.zeros((size, size, 3))
    high = size // boards
    for n in range(boards):
        noise = make_noise(rng, (high, size // 8), (64, 16))
        noise = cv2.resize(noise, (size, high), interpolation=cv2.INTER_CUBIC)
        rings = 0.5 + 0.5 * np.sin(2 * np.pi * (9 * noise + np.arange(high)[:, None] / high * 2))
        streaks = cv2.blur(rng.uniform(0, 1, (high, size)), (61, 1))
        share = np.clip(0.45 * rings + 1.8 * (streaks - 0.5) + 0.3, 0, 1)
        tone = rng.uniform(0.8, 1.05)
        board = tone * mix_colours(share, (62, 104, 148), (112, 163, 205))
        board[:3] *= 0.45
        image[n * high:(n + 1) * high] = board
    return image


def draw_bricks(rng: np.random.Generator, size: int = 1024) -> np.ndarray:
    """Return a texture of 16 rows of 8 bricks; every second row is shifted by half a brick."""
    image = mix_colours(make_noise(rng, (size, size), (32, 8, 4)), (150, 158, 162), (186, 194, 198))
    rough = make_noise(rng, (size, size), (32, 8, 4))
    high, wide = size // 16, size // 8
    for row in range(16):
        for column in range(-1, 8):
            left = column * wide + (wide // 2 if row % 2 else 0)
            top = row * high
            red = rng.uniform(0.75, 1.1) * np.array([72, 88, 152]) + rng.normal(0, 5, 3)
            rows = slice(top + 4, top + high - 3)
            columns = slice(max(left + 4, 0), max(min(left + wide - 4, size), 0))
            image[rows, columns] = red * (0.72 + 0.5 * rough[rows, columns, None])
    return image


def draw_text(image: np.ndarray, words: str, at: tuple[int, int], scale: float,
         colour: tuple[int, ...] = INK, thick: int = 2) -> None:
    cv2.putText(image, words, at, cv2.FONT_HERSHEY_DUPLEX, scale, colour, thick, cv2.LINE_AA)


def draw_poster(rng: np.random.Generator, kind: int, size: int = 512) -> np.ndarray:
    """Return a poster with a heading, a drawing of one of six kinds, and lines of small text."""
    paper = PAPERS[kind % len(PAPERS)]
    image = np.full((size, size, 3), paper, np.uint8)
    paints = [PAINTS[k] for k in rng.permutation(len(PAINTS))]
    cv2.rectangle(image, (12, 12), (size - 13, size - 13), paints[0], 5)
    heading = ("ROBOTICS", "MOMENTS", "FEATURES", "GEOMETRY", "CONTROL", "HORIZON")[kind % 6]
    draw_text(image, heading, (34, 78), 1.9, paints[0], 4)
    low, high = 105, 395
    if kind % 6 == 0:  # draw nested circles
        for _ in range(26):
            centre = tuple(int(x) for x in rng.integers((40, low + 20), (size - 40, high - 20)))
            radius = int(rng.integers(10, 52))
            cv2.circle(image, centre, radius, paints[int(rng.integers(0, 8))], -1, cv2.LINE_AA)
            cv2.circle(image, centre, radius // 2, paper, 3, cv2.LINE_AA)
    elif kind % 6 == 1:  # draw the regions in which smooth noise is above a level
        field = make_noise(rng, (high - low, size - 60), (48, 24))
        for level, paint in zip((0.35, 0.5, 0.65, 0.78), paints, strict=False):
            image[low:high, 30:size - 30][field > level] = paint
    elif kind % 6 == 2:  # draw squares of all sizes
        for _ in range(120):
            x, y = int(rng.integers(32, size - 70)), int(rng.integers(low, high - 36))
            side = int(rng.integers(6, 36))
            cv2.rectangle(image, (x, y), (x + side, y + side), paints[int(rng.integers(0, 8))],
                          -1 if rng.random() < 0.7 else 2)
    elif kind % 6 == 3:  # draw triangles
        points = rng.integers((32, low), (size - 32, high), (48, 2))
        for n in range(0, 48, 3):
            cv2.fillPoly(image, [points[n:n + 3]], paints[n // 3 % 8], cv2.LINE_AA)
    elif kind % 6 == 4:  # draw curves
        x = np.arange(40, size - 40)
        for n in range(9):
            swing = 30 + 10 * n
            y = (low + high) / 2 + swing * np.sin(x / (14 + 5 * n) + n) * np.exp(-x / 400)
            cv2.polylines(image, [np.stack([x, y], 1).astype(np.int32)], False, paints[n % 8], 3,
                          cv2.LINE_AA)
    else:  # draw hills in front of a sky
        for n, level in enumerate((0.25, 0.45, 0.62, 0.8)):
            ridge = high - (1 - level) * 260 + 60 * (make_noise(rng, (8, size), (64, 24))[4] - 0.5)
            for x in range(30, size - 30):
                image[int(ridge[x]):high, x] = paints[n]
        cv2.circle(image, (380, 160), 34, (90, 200, 245), -1, cv2.LINE_AA)
    for row in range(6):
        y, x = 420 + 12 * row, 34
        while x < size - 60:
            wide = int(rng.integers(8, 46))
            cv2.rectangle(image, (x, y), (min(x + wide, size - 36), y + 4), INK, -1)
            x += wide + 8
    return image


def draw_label(rng: np.random.Generator, words: str, kind: int, size: int = 512) -> np.ndarray:
    """Return the texture of the printed side of a tin or a box, with `words` as its name.

    kind: number that selects the colours; it also defines the printed product number and weight.
    """
    back, front = PAINTS[kind % 8], PAPERS[kind % 4]
    share = make_noise(rng, (size, size), (64, 16))
    image = np.ascontiguousarray(
        mix_colours(share, tuple(int(0.8 * x) for x in back), tuple(min(x + 35, 255) for x in back))
    ).astype(np.uint8)
    cv2.rectangle(image, (0, 140), (size, 380), front, -1)
    for n in range(9):
        cv2.circle(image, (28 + 57 * n, 70), 20, PAINTS[(kind + n) % 8], -1, cv2.LINE_AA)
        cv2.circle(image, (28 + 57 * n, 448), 14 + n, front, 4, cv2.LINE_AA)
    draw_text(image, words, (24, 250), 2.3, back, 5)
    draw_text(image, f"No. {kind + 11}   {100 * kind + 250} g", (30, 330), 1.2)
    return image


class MeshWriter:
    """Writer of an OBJ file of quadrilaterals with texture coordinates and normals."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._lines, self._library = [f"mtllib {name}.mtl"], []
        self._count = 0

    def start_material(self, name: str, colour: tuple[float, float, float] = (1, 1, 1),
                       image: str = "") -> None:
        """Set the material of the following quadrilaterals; `colour` is RGB in 0..1."""
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

    def add_box(self, size: tuple[float, float, float], tile_size: float = 0.0) -> None:
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

    def add_revolution(self, profile: list[tuple[float, float]], sectors: int = 36,
                       sharp: bool = False) -> None:
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


def write_images(folder: Path) -> None:
    """Write all textures."""
    def write(name: str, image: np.ndarray) -> None:
        image = np.clip(np.rint(image), 0, 255).astype(np.uint8)
        if name.endswith(".jpg"):
            cv2.imwrite(str(folder / name), image, [cv2.IMWRITE_JPEG_QUALITY, 88])
        else:
            cv2.imwrite(str(folder / name), image, [cv2.IMWRITE_PNG_COMPRESSION, 9])

    write("boards.jpg", draw_wood(np.random.default_rng(SEED), 8))
    write("bench.jpg", draw_wood(np.random.default_rng(SEED + 1), 3))
    write("bricks.jpg", draw_bricks(np.random.default_rng(SEED + 2)))
    for n in range(6):
        write(f"poster{n}.png", draw_poster(np.random.default_rng(SEED + 10 + n), n))
    for n, words in enumerate(("SCREWS", "NUTS M4", "GREASE", "WASHERS")):
        write(f"label{n}.png", draw_label(np.random.default_rng(SEED + 20 + n), words, n))


def write_meshes(folder: Path) -> None:
    """Write all meshes."""
    floor = MeshWriter("floor")
    floor.start_material("boards", image="boards.jpg")
    floor.add_box((6.0, 6.0, 0.02), tile_size=1.5)
    floor.write(folder)
    wall = MeshWriter("wall")
    wall.start_material("bricks", image="bricks.jpg")
    wall.add_box((6.0, 0.12, 2.6), tile_size=1.3)
    wall.write(folder)
    board = MeshWriter("board")
    board.start_material("bench", image="bench.jpg")
    board.add_box((2.0, 1.0, 0.0005), tile_size=0.5)
    board.write(folder)
    for n in range(6):
        sheet = MeshWriter(f"poster{n}")
        sheet.start_material("print", image=f"poster{n}.png")
        sheet.add_box((0.62, 0.004, 0.62))
        sheet.write(folder)
    for n, size in enumerate(((0.07, 0.05, 0.045), (0.05, 0.05, 0.06))):
        carton = MeshWriter(f"carton{n}")
        carton.start_material("print", image=f"label{n}.png")
        carton.add_box(size)
        carton.write(folder)
    for n, (radius, high) in enumerate(((0.026, 0.06), (0.032, 0.045))):
        tin = MeshWriter(f"tin{n}")
        tin.start_material("print", image=f"label{n + 2}.png")
        tin.add_revolution([(radius, 0.0), (radius, high)], sharp=True)
        tin.start_material("metal", (0.72, 0.74, 0.76))
        tin.add_revolution([(radius, high), (radius * 0.94, high), (radius * 0.92, high - 0.002),
                            (1e-4, high - 0.002)], sharp=True)
        tin.write(folder)
    bowl = MeshWriter("bowl")
    bowl.start_material("glaze", (0.20, 0.42, 0.62))
    outside = [(0.012, 0.0), (0.020, 0.002), (0.034, 0.012), (0.042, 0.026), (0.045, 0.036)]
    bowl.add_revolution(outside)
    bowl.start_material("inside", (0.90, 0.88, 0.80))
    bowl.add_revolution([(0.045, 0.036), (0.040, 0.027), (0.031, 0.014), (0.018, 0.005),
                         (1e-4, 0.004)])
    bowl.write(folder)
    driver = MeshWriter("screwdriver")
    driver.start_material("handle", (0.80, 0.16, 0.10))
    driver.add_revolution([(1e-4, 0.0), (0.008, 0.002), (0.011, 0.010), (0.009, 0.030),
                           (0.011, 0.055), (0.006, 0.070)], 24)
    driver.start_material("steel", (0.62, 0.64, 0.66))
    driver.add_revolution([(0.006, 0.070), (0.003, 0.071), (0.003, 0.140), (0.0005, 0.150)], 24,
                          sharp=True)
    driver.write(folder)
    lamp = MeshWriter("lamp")
    lamp.start_material("shade", (0.16, 0.36, 0.30))
    lamp.add_revolution([(0.16, 0.0), (0.12, 0.06), (0.05, 0.11), (0.02, 0.13), (1e-4, 0.135)])
    lamp.write(folder)


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
