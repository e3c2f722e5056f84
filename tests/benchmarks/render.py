#!/usr/bin/env python3
"""Measure rendering times and accuracy, also of another commit and of other renderers.

    python3 tests/benchmarks/render.py [--before COMMIT] [--others] [--poses 12]

First a table: pictures from 320 x 240 to 1920 x 1200, of a table with a target and with 40 000
triangles around that, through lenses from a pinhole to 220 degrees; processor time of all threads
(the median of the poses), and how far centroid, area and angle of the target (50 px and more wide,
second moments 1.44 : 1) are from exact projection, RMS over the poses. Then the demo's views,
beside the commit `--before` (in a worktree made for that, with its own tests/benchmarks/render.py),
in turns, each in a process of its own. A cell of the table stops after `--patience` seconds with
the poses that it has, and a renderer that answers no more in so long is left out, and named.
`--others` adds PyBullet's own renderers and, where it is
installed, MuJoCo, on the same triangles. The last line is JSON.
"""

from __future__ import annotations

import argparse
import importlib.util
import itertools
import json
import os
import select
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pybullet
from checkout import ROOT as REPOSITORY
from scenes import Bench, link_pose, looking, table_and_target
from tiny import TinyRenderer

from aras_sim_bridge.camera import CameraConfig, CameraSensor
from aras_sim_bridge.camera.effects import EffectChain, Effects
from aras_sim_bridge.description import Geometry, parse_urdf
from aras_sim_bridge.rendering import Lighting, View, create_renderer
from aras_sim_bridge.rendering.renderer import Renderer
from aras_sim_bridge.rendering.scene import Scene
from aras_visual_servo_base.poses import Pose, optical_pose

ROBOT = REPOSITORY / "src/aras_visual_servo_gazebo"
NEAR, FAR = 0.02, 100.0
LENSES = {
    "pinhole": dict(horizontal_fov=2.0),
    "pinhole_640x480": dict(horizontal_fov=2.0, width=640, height=480),
    "plumb_bob": dict(camera_matrix=(195.05, 195.1, 162.41, 127.2),
                      distortion_coefficients=(-0.3306, 0.117, 0, 0, 0)),
    "fisheye": dict(lens="equidistant", horizontal_fov=3.0),
    "fisheye_180": dict(lens="equidistant", horizontal_fov=np.pi),
}
ROOM = looking([2.8, -2.0, 1.9], [0.0, 0.0, 0.9])
ROOM_FOV = 1.14


def robot_scene() -> tuple[Bench, np.ndarray]:
    """Return the shipped robot in the demo's first pose, and its camera's optical frame."""
    bench = Bench()
    robot = parse_urdf((ROBOT / "robots/aras_visual_servo.urdf").read_text(), lambda _: str(ROBOT))
    bench.world.spawn_ground_plane()
    model = bench.world.spawn(robot, "robot", joint_positions={
        "gantry": 0.1, "J2": 0.1745, "J3": -0.0873, "J5": -0.0873})
    target = parse_urdf((ROBOT / "targets/aras.urdf").read_text())
    bench.world.spawn(target, "target", Pose((0.0, 0.0, 0.591)))
    T = optical_pose(model.link_pose("camera_link").matrix())
    return bench, T


def ball_file(folder: Path) -> Path:
    """Write a ball of 1 m radius with 2 000 triangles."""
    rings, sectors = 26, 40
    theta, phi = np.linspace(0, np.pi, rings), np.linspace(0, 2 * np.pi, sectors + 1)
    grid = np.stack([np.outer(np.sin(theta), np.cos(phi)), np.outer(np.sin(theta), np.sin(phi)),
                     np.outer(np.cos(theta), np.ones_like(phi))], axis=-1)
    a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
    corners = np.concatenate([np.stack([a, b, c], 2), np.stack([a, c, d], 2)]).reshape(-1, 3, 3)
    record = np.zeros(len(corners), [("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    record["v"] = corners
    path = folder / "ball.stl"
    path.write_bytes(bytes(80) + len(record).to_bytes(4, "little") + record.tobytes())
    return path


def large_scene(folder: Path) -> tuple[Bench, np.ndarray]:
    """Make a scene of 40 000 triangles: twenty balls above the target, and a camera above them."""
    path = ball_file(folder)
    bench = Bench()
    table_and_target(bench)
    for n in range(20):
        ball = Geometry("mesh", filename=str(path), scale=(0.05,) * 3)
        bench.body(ball, (0.13 * (n % 5) - 0.26, 0.13 * (n // 5) - 0.2, 0.66))
    return bench, looking([0.1, -0.2, 1.2], [0.0, 0.0, 0.6])


def flat_view(pose: np.ndarray, width: int, height: int, fov: float) -> View:
    return View(width, height, pose, CameraConfig(width=width, height=height,
                                                  horizontal_fov=fov).K, NEAR, FAR)


def visible_copy(bench: Bench) -> int:
    """Make a Bullet client with the same triangles, for Bullet's own renderers."""
    tiny = TinyRenderer(bench.world, Lighting())
    tiny._prepare(1.0)
    return tiny._client


def bullet_picture(client: int, view: View, renderer: int) -> Callable[[], object]:
    """Return a function that renders the view with one of Bullet's renderers."""
    K, w, h = view.K, view.width, view.height
    eye = np.diag([1.0, -1.0, -1.0, 1.0]) @ np.linalg.inv(view.world_T_optical)
    side = 2 * K[0, 0] / w, 2 * K[1, 1] / h
    projection = np.diag([*side, -(FAR + NEAR) / (FAR - NEAR), 0.0])
    projection[2, 3], projection[3, 2] = -2 * FAR * NEAR / (FAR - NEAR), -1.0
    arguments = (w, h, eye.T.reshape(-1).tolist(), projection.T.reshape(-1).tolist())
    return lambda: pybullet.getCameraImage(
        *arguments, shadow=0, renderer=renderer, physicsClientId=client
    )


def mujoco_picture(bench: Bench, view: View, shadows: bool = True) -> Callable[[], object]:
    """Return a function that renders the triangles with MuJoCo, with or without shadows."""
    os.environ.setdefault("MUJOCO_GL", "egl")
    import mujoco

    scene = Scene(bench.world)
    scene.refresh()
    poses = scene.read_poses()
    assets, bodies = [], []
    for n, part in enumerate(scene.visuals):
        mesh = part.mesh.transform(poses[part.row])
        if np.ptp(mesh.positions, axis=0).min() < 1e-9:
            continue  # MuJoCo takes no flat meshes; the ground is its own plane below
        vertices = " ".join(f"{x:.7g}" for x in mesh.positions.reshape(-1))
        faces = " ".join(map(str, mesh.triangles.reshape(-1)))
        assets.append(f'<mesh name="m{n}" inertia="shell" vertex="{vertices}" face="{faces}"/>')
        rgba = " ".join(map(str, part.rgba))
        bodies.append(f'<geom type="mesh" mesh="m{n}" rgba="{rgba}"/>')
    w, h = view.width, view.height
    T = view.world_T_optical
    axes = " ".join(f"{x:.9g}" for x in [*T[:3, 0], *(-T[:3, 1])])
    fovy = np.degrees(2 * np.arctan(h / 2 / view.K[1, 1]))
    model = mujoco.MjModel.from_xml_string(f"""<mujoco><visual>
        <global offwidth="{w}" offheight="{h}"/></visual>
        <asset>{"".join(assets)}</asset><worldbody><light directional="true"
        castshadow="{str(shadows).lower()}" dir="-.5 .1 -.9"/>
        <geom type="plane" size="50 50 1"/>{"".join(bodies)}
        <camera name="c" pos="{T[0, 3]} {T[1, 3]} {T[2, 3]}" xyaxes="{axes}" fovy="{fovy}"/>
        </worldbody></mujoco>""")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    renderer = mujoco.Renderer(model, h, w)

    def draw():
        renderer.update_scene(data, camera="c")
        return renderer.render()

    return draw


def scene_and_view(case: str, folder: Path) -> tuple[Bench, View]:
    """Return the world and the view of a case."""
    if case == "triangles_40000":
        bench, above = large_scene(folder)
        return bench, flat_view(above, 320, 240, 1.0)
    bench, camera = robot_scene()
    if case == "room":
        return bench, flat_view(ROOM, 320, 240, ROOM_FOV)
    size = (640, 480) if case.endswith("640x480") else (320, 240)
    return bench, flat_view(camera, *size, 2.0)


def picture_of(case: str, what: str, folder: Path) -> Callable[[], object]:
    """Return a function that renders one image of a case."""
    bench, view = scene_and_view(case, folder)
    if what == "pybullet_tiny":
        return bullet_picture(visible_copy(bench), view, pybullet.ER_TINY_RENDERER)
    if what == "pybullet_egl":
        plugin = importlib.util.find_spec("eglRenderer").origin
        client = visible_copy(bench)
        pybullet.loadPlugin(plugin, "_eglRendererPlugin", physicsClientId=client)
        return bullet_picture(client, view, pybullet.ER_BULLET_HARDWARE_OPENGL)
    if what.startswith("mujoco"):
        return mujoco_picture(bench, view, shadows=what == "mujoco")
    renderer = create_renderer("exact", bench.world)
    if what in LENSES:
        sensor = CameraSensor(CameraConfig.from_mapping({"near": NEAR, **LENSES[what]}), renderer)
        T = view.world_T_optical
        view = sensor.make_view(link_pose(T))
    if what == "noise_alone":
        image = renderer.render(view)
        noise = EffectChain(Effects(noise_stddev=5.0), image.shape, seed=0)
        stamps = itertools.count()
        return lambda: noise.apply(image, next(stamps))
    return lambda: renderer.render(view)


DRIVER = """
import os, sys, time
from pathlib import Path
out = os.fdopen(os.dup(1), "w")
os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # PyBullet prints a great deal
sys.path.insert(0, "tests/benchmarks")
import render
draw = render.picture_of(sys.argv[1], sys.argv[2], Path(sys.argv[3]))
for _ in range(8):
    draw()
print("ready", file=out, flush=True)
for line in sys.stdin:
    times = []
    for _ in range(int(line)):
        start = time.process_time()
        draw()
        times.append(time.process_time() - start)
    print(1e3 * sorted(times)[len(times) // 4], file=out, flush=True)
"""


def answer(process: subprocess.Popen, patience: float) -> str:
    """Return the next line of a renderer's process; '' if it ends or none comes in `patience` s."""
    ready, _, _ = select.select([process.stdout], [], [], patience)
    return process.stdout.readline().strip() if ready else ""


def failure(process: subprocess.Popen, log: Path) -> str:
    """Return why a renderer's process gave no answer: it is too slow, or its last error line."""
    try:
        process.wait(1.0)
    except subprocess.TimeoutExpired:
        return "it takes too long"
    lines = log.with_suffix(".stderr").read_text().strip().splitlines()
    return f"it failed: {lines[-1] if lines else f'status {process.returncode}'}"


def side_by_side(case: str, checkouts: dict[str, tuple[Path, str]], folder: Path, rounds: int,
                 pictures: int, patience: float) -> dict[str, float]:
    """Processor milliseconds a picture, of all threads: the median over the rounds, in turns, of
    what a quarter of a round's pictures took less than. Without those that take too long.

    checkouts: the folder of a commit and what it is to draw with, by name.
    """
    running = {}
    for name, (checkout, what) in checkouts.items():
        running[name] = subprocess.Popen(
            [sys.executable, "-c", DRIVER, case, what, str(folder)], cwd=checkout, text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=(folder / f"{name}.stderr").open("w"))
    times: dict[str, list[float]] = {name: [] for name in running}
    try:
        for turn in range(rounds + 1):
            for name in list(times):
                process = running[name]
                if turn:
                    process.stdin.write(f"{pictures}\n")
                    process.stdin.flush()
                # A new checkout compiles first.
                said = answer(process, patience if turn else 10 * patience)
                if not said:
                    print(f"{name} is left out of {case}: {failure(process, folder / name)}",
                          flush=True)
                    del times[name]
                elif turn:
                    times[name].append(float(said))
    finally:
        for process in running.values():
            process.kill()
            process.communicate()
    return {name: round(float(np.median(values)), 3) for name, values in times.items()}


# The last commit that drew with OpenGL.
BEFORE = "dd000ac"
CASES = ("servo", "servo_640x480", "room", "triangles_40000")
SIZES = [(320, 240), (640, 480), (1280, 960), (1920, 1200)]
ANGLES = {
    "pinhole 57": dict(horizontal_fov=1.0),
    "pinhole 115": dict(horizontal_fov=2.0),
    "plumb_bob 85": dict(horizontal_fov=1.5,
                         distortion_coefficients=(-0.2, 0.04, 0.001, -0.001, 0.0)),
    "fisheye 180": dict(lens="equidistant", horizontal_fov=np.pi),
    "fisheye 220": dict(lens="equidistant", horizontal_fov=np.radians(220)),
}
HALF = np.array([0.03, 0.025])  # m, of the target


def target_scene(triangles: int, folder: Path) -> Bench:
    """Make a black target on a white table, surrounded by balls with this number of triangles."""
    bench = Bench()
    bench.box([3.0, 3.0, 0.295], [0, 0, 0.295])
    bench.box([*HALF, 1e-5], [0, 0, 0.59], "Gazebo/Black")
    if triangles:
        path = ball_file(folder)
        for n in range(20):
            ball = Geometry("mesh", filename=str(path), scale=(0.012,) * 3)
            turn = 2 * np.pi * n / 20
            bench.body(ball, (0.085 * np.cos(turn), 0.085 * np.sin(turn), 0.602))
    return bench


def outline_moments(outline: np.ndarray) -> np.ndarray:
    """Return area, centroid x, y, and angle of the long axis (rad) of a polygon (N, 2)."""
    (x, y), (x2, y2) = outline.T, np.roll(outline, -1, axis=0).T
    cross = x * y2 - x2 * y
    area = cross.sum() / 2
    cx, cy = (((a + a2) * cross).sum() / (6 * area) for a, a2 in ((x, x2), (y, y2)))
    xx = ((x * x + x * x2 + x2 * x2) * cross).sum() / 12 - area * cx * cx
    yy = ((y * y + y * y2 + y2 * y2) * cross).sum() / 12 - area * cy * cy
    xy = ((x * y2 + 2 * x * y + 2 * x2 * y2 + x2 * y) * cross).sum() / 24 - area * cx * cy
    sign = np.sign(area)
    return np.array([abs(area), cx, cy, 0.5 * np.arctan2(2 * sign * xy, sign * (xx - yy))])


def picture_moments(image: np.ndarray, outline: np.ndarray) -> np.ndarray:
    """Return area, centroid and angle, as `outline_moments`, of the dark pixels around an outline.
    """
    low, high = outline.min(axis=0).astype(int) - 3, outline.max(axis=0).astype(int) + 4
    window = image[low[1]:high[1], low[0]:high[0], 0].astype(float)
    black, white = window.min(), window.max()
    dark = (white - window) / (white - black)
    v, u = np.mgrid[low[1]:high[1], low[0]:high[0]]
    area = dark.sum()
    cx, cy = (dark * u).sum() / area, (dark * v).sum() / area
    xx, yy = (dark * (u - cx) ** 2).sum(), (dark * (v - cy) ** 2).sum()
    xy = (dark * (u - cx) * (v - cy)).sum()
    return np.array([area, cx, cy, 0.5 * np.arctan2(2 * xy, xx - yy)])


def cell(renderer: Renderer, size: tuple[int, int], settings: dict, poses: int, patience: float
         ) -> dict[str, float]:
    """Time and errors of pictures of one size through one lens, from as many poses as it takes
    `patience` s to draw, and one."""
    config = CameraConfig.from_mapping({"near": 0.01, "far": 20.0, "width": size[0],
                                        "height": size[1], **settings})
    sensor = CameraSensor(config, renderer)
    border = np.linspace(-1, 1, 60)[:-1]
    side = np.stack([border, -np.ones_like(border)], axis=1)
    turns = [np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
             for a in np.pi / 2 * np.arange(4)]
    around = np.concatenate([side @ turn.T for turn in turns]) * HALF
    around = np.column_stack([around, np.full(len(around), 0.59001)])
    rng = np.random.default_rng(1)
    errors, times = [], []
    # As far away as makes the target some 55 px wide.
    away = 2 * HALF[0] * config.K[0, 0] / max(55.0, size[0] / 8)
    end = time.monotonic() + patience
    while len(errors) < poses and not (errors and time.monotonic() > end):
        turn = rng.uniform(0, 2 * np.pi)
        eye = [*rng.uniform(-0.15, 0.15, 2) * away, 0.59 + away * rng.uniform(0.8, 1.0)]
        T = looking(eye, [*rng.uniform(-0.1, 0.1, 2) * away, 0.59],
                    (np.cos(turn), np.sin(turn), 0))
        outline = config.projection.project((around - T[:3, 3]) @ T[:3, :3])
        if (outline < 4).any() or (outline > np.array(size) - 5).any():
            continue
        view = sensor.make_view(link_pose(T))
        if not errors:  # what the first picture prepares is for all
            renderer.render(view)
        start = time.process_time()
        image = renderer.render(view)
        times.append(time.process_time() - start)
        found, exact = picture_moments(image, outline), outline_moments(outline)
        area, x, y, angle = found - exact
        errors.append([x, y, area / exact[0], (angle + np.pi / 2) % np.pi - np.pi / 2])
    x, y, area, angle = np.array(errors).T
    return {"ms": round(1e3 * float(np.median(times)), 2),
            "centroid_rms_px": round(float(np.sqrt((x**2 + y**2).mean())), 5),
            "area_rms_percent": round(100 * float(np.sqrt((area**2).mean())), 4),
            "angle_mrad": round(1e3 * float(np.sqrt((angle**2).mean())), 4)}


@contextmanager
def checkout_of(commit: str) -> Iterator[Path | None]:
    """Yield a worktree of a commit; a folder is used as it is; None without a commit."""
    if not commit:
        yield None
        return
    if Path(commit).is_dir():
        yield Path(commit).resolve()
        return
    git = ["git", "-C", str(REPOSITORY), "worktree"]
    with tempfile.TemporaryDirectory() as name:
        subprocess.run([*git, "add", "--detach", "--quiet", name + "/it", commit], check=True)
        try:
            yield Path(name) / "it"
        finally:
            subprocess.run([*git, "remove", "--force", name + "/it"], check=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--before", default=BEFORE,
                        help="the commit, or a folder that has it, to compare with; '' for none")
    parser.add_argument("--others", action="store_true", help="PyBullet's renderers and MuJoCo too")
    parser.add_argument("--poses", type=int, default=12,
                        help="of each cell of the table, fewer in large pictures")
    parser.add_argument("--rounds", type=int, default=4)
    parser.add_argument("--pictures", type=int, default=12, help="a round, of each renderer")
    parser.add_argument("--patience", type=float, default=30.0,
                        help="s of wall time for a cell of the table, and for a renderer's answer")
    parser.add_argument("--sizes", default=",".join(f"{w}x{h}" for w, h in SIZES),
                        help="of the table's pictures, px (default: %(default)s)")
    parser.add_argument("--cases", default=",".join(CASES),
                        help="drawn side by side (default: %(default)s)")
    parser.add_argument("--no-table", action="store_true", help="only what is side by side")
    arguments = parser.parse_args()
    sizes = [tuple(map(int, size.split("x"))) for size in arguments.sizes.split(",")]
    result: dict[str, object] = {}
    with tempfile.TemporaryDirectory() as name, checkout_of(arguments.before) as before:
        folder = Path(name)
        cells = {}
        print(f"{'picture':>11} {'lens, deg':>13} {'triangles':>9} {'ms':>7} {'centroid px':>11} "
              f"{'area %':>7} {'angle mrad':>10}")
        for triangles in () if arguments.no_table else (0, 40_000):
            bench = target_scene(triangles, folder)
            renderer = create_renderer("exact", bench.world)
            for lens, settings in ANGLES.items():
                for size in sizes:
                    one = cell(renderer, size, settings,
                               max(arguments.poses * SIZES[0][0] // size[0], 3),
                               arguments.patience)
                    cells[f"{size[0]}x{size[1]} {lens} {triangles}"] = one
                    print(f"{size[0]:>6}x{size[1]:<4} {lens:>13} {triangles:>9} {one['ms']:>7} "
                          f"{one['centroid_rms_px']:>11} {one['area_rms_percent']:>7} "
                          f"{one['angle_mrad']:>10}", flush=True)
            renderer.close()
            bench.close()
        for what in ("centroid_rms_px", "angle_mrad", "area_rms_percent") if cells else ():
            result[f"worst_{what}"] = max(one[what] for one in cells.values())
        side = arguments.rounds, arguments.pictures, arguments.patience
        checkouts = {"now": (REPOSITORY, "exact")}
        if before:
            checkouts["before"] = (before, "opengl")
        if arguments.others:
            checkouts["pybullet_tiny"] = (REPOSITORY, "pybullet_tiny")
            for module, other in (("eglRenderer", "pybullet_egl"), ("mujoco", "mujoco"),
                                  ("mujoco", "mujoco_without_shadows")):
                if importlib.util.find_spec(module):
                    checkouts[other] = (REPOSITORY, other)
        for case in arguments.cases.split(","):
            times = side_by_side(case, checkouts, folder, *side)
            result[case] = {"ms": times, "now_to": {
                other: round(times["now"] / value, 3) for other, value in times.items()
                if other != "now" and "now" in times}}
            print(case, result[case])
        for lens in LENSES:
            if lens.startswith("pinhole"):
                continue
            own = {name: (path, lens) for name, (path, _) in checkouts.items()
                   if name in ("now", "before")}
            times = side_by_side("servo", own, folder, *side)
            result[f"servo_{lens}"] = times
            print("servo through", lens, times)
    print(json.dumps(result))


if __name__ == "__main__":
    main()
