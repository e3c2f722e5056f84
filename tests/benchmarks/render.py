#!/usr/bin/env python3
"""How long the renderers take for a picture of the robot, and of a scene of 40 000 triangles.

    python3 tests/benchmarks/render.py [--repeat 60] [--rounds 5]

Everything is measured in one run, renderer after renderer in rounds, and the best round's median
counts, so that other load on the machine falls on all alike. Views: `servo`, the demo's camera
that looks down on the target, and `room`, the whole robot. Compared with PyBullet's TinyRenderer
and EGL plugin (which draw Bullet's own copy of the robot) and, if `pip install mujoco` was done,
with MuJoCo's offscreen renderer on the same meshes. The accuracy of the target's centroid comes
along.
Prints a table and, as its last line, JSON with milliseconds and ratios.
"""

from __future__ import annotations

import argparse
import importlib.util
import itertools
import json
import multiprocessing
import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pybullet

REPOSITORY = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(REPOSITORY / "src/aras_sim_bridge/src"))
sys.path.insert(0, str(REPOSITORY / "tests/unit/camera"))

from scenes import Bench, link_pose, looking, table_and_target  # noqa: E402

from aras_sim_bridge.camera import CameraConfig, CameraSensor  # noqa: E402
from aras_sim_bridge.camera.effects import EffectChain, Effects  # noqa: E402
from aras_sim_bridge.description import Geometry, parse_urdf  # noqa: E402
from aras_sim_bridge.rendering import (  # noqa: E402
    SENSOR_R_OPTICAL,
    View,
    create_renderer,
)

ROBOT = REPOSITORY / "src/aras_visual_servo_gazebo"
NEAR, FAR = 0.02, 100.0
ANTIALIASING = {"opengl": "edges", "opengl_multisample_4x": "multisample",
                "opengl_no_antialiasing": "none"}
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
    """The shipped robot in the demo's first pose, on the ground; and its camera's optical frame."""
    bench = Bench()
    robot = parse_urdf((ROBOT / "robots/aras_visual_servo.urdf").read_text(), lambda _: str(ROBOT))
    bench.world.spawn_ground_plane()
    model = bench.world.spawn(robot, "robot", joint_positions={
        "gantry": 0.1, "J2": 0.1745, "J3": -0.0873, "J5": -0.0873})
    T = np.array(model.link_pose("camera_link").matrix())
    T[:3, :3] = T[:3, :3] @ SENSOR_R_OPTICAL
    return bench, T


def large_scene(folder: Path) -> tuple[Bench, np.ndarray]:
    """40 000 triangles: twenty balls of 2 000 each over the target; and an eye above them."""
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
    """A Bullet client with the triangles that ours draws, for Bullet's own renderers."""
    tiny = create_renderer("tiny", bench.world, antialiasing="none")
    tiny._prepare(1.0)
    return tiny._client


def bullet_picture(client: int, view: View, renderer: int) -> Callable[[], object]:
    """A call of Bullet's own renderer for the same view."""
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
    """MuJoCo's offscreen renderer on the triangles that ours draws, as it comes or unshadowed."""
    os.environ.setdefault("MUJOCO_GL", "egl")
    import mujoco

    scene = create_renderer("tiny", bench.world, antialiasing="none").scene
    scene.refresh()
    poses = scene.poses()
    assets, bodies = [], []
    for n, part in enumerate(scene.parts):
        mesh = part.mesh.transformed(poses[part.row])
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
    """The world and the view of a case."""
    if case == "triangles_40000":
        bench, above = large_scene(folder)
        return bench, flat_view(above, 320, 240, 1.0)
    bench, camera = robot_scene()
    if case == "room":
        return bench, flat_view(ROOM, 320, 240, ROOM_FOV)
    size = (640, 480) if case.endswith("640x480") else (320, 240)
    return bench, flat_view(camera, *size, 2.0)


def picture_of(case: str, what: str, folder: Path) -> Callable[[], object]:
    """A call that draws one picture of a case."""
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
    renderer = create_renderer("opengl", bench.world,
                               antialiasing=ANTIALIASING.get(what, "edges"))
    if what in LENSES:
        sensor = CameraSensor(CameraConfig.from_mapping({"near": NEAR, **LENSES[what]}), renderer)
        T = view.world_T_optical
        view = sensor._view(link_pose(T))
    if what == "noise_alone":
        image = renderer.render(view)
        noise = EffectChain(Effects(noise_stddev=5.0), image.shape, seed=0)
        stamps = itertools.count()
        return lambda: noise.apply(image, next(stamps))
    return lambda: renderer.render(view)


def worker(case: str, what: str, folder: Path, repeat: int, pipe) -> None:
    """Measure a round each time the parent asks; every renderer has a process to itself, because
    several of them in one disturb each other's OpenGL."""
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 1)  # PyBullet prints a great deal
    draw = picture_of(case, what, folder)
    for _ in range(5):
        draw()
    pipe.send(None)
    while pipe.recv():
        times, until = [], time.perf_counter() + 1.0
        while len(times) < 5 or (len(times) < repeat and time.perf_counter() < until):
            start = time.perf_counter()
            draw()
            times.append(time.perf_counter() - start)
        pipe.send(1e3 * float(np.median(times)))


def measure(case: str, names: list[str], folder: Path, repeat: int, rounds: int
            ) -> dict[str, float]:
    """Milliseconds of each: the lowest over the rounds of a round's median."""
    context = multiprocessing.get_context("spawn")
    pipes = {}
    for name in names:
        pipes[name], theirs = context.Pipe()
        context.Process(target=worker, args=(case, name, folder, repeat, theirs),
                        daemon=True).start()
        theirs.close()
        pipes[name].recv()
    best = dict.fromkeys(names, np.inf)
    for _ in range(rounds):
        for name, pipe in pipes.items():
            pipe.send(True)
            best[name] = min(best[name], pipe.recv())
    for pipe in pipes.values():
        pipe.send(False)
    return {name: round(value, 3) for name, value in best.items()}


def accuracy() -> dict[str, float]:
    """Centroid and area of the target over 150 poses, against exact geometry."""
    from test_accuracy import rms, target_errors

    bench = Bench()
    table_and_target(bench)
    centroid, area = target_errors(create_renderer("opengl", bench.world), 150)
    bench.close()
    return {"centroid_rms_px": round(float(rms(centroid)), 5),
            "area_rms_percent": round(100 * float(np.sqrt((area**2).mean())), 4)}


def report(title: str, times: dict[str, float]) -> None:
    print(f"\n{title}")
    for name, value in times.items():
        print(f"  {name:26s} {value:9.3f} ms")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeat", type=int, default=60, help="pictures a round, at most")
    parser.add_argument("--rounds", type=int, default=5)
    arguments = parser.parse_args()
    result: dict[str, object] = {}
    names = [*ANTIALIASING, "pybullet_tiny"]
    for module, name in (("eglRenderer", "pybullet_egl"), ("mujoco", "mujoco"),
                         ("mujoco", "mujoco_without_shadows")):
        if importlib.util.find_spec(module):
            names.append(name)
    with tempfile.TemporaryDirectory() as folder:
        for case in ("servo", "servo_640x480", "room", "triangles_40000"):
            times = measure(case, names, Path(folder), arguments.repeat, arguments.rounds)
            report(case, times)
            result[case] = {"ms": times, "opengl_to": {
                other: round(times["opengl"] / times[other], 4)
                for other in names if not other.startswith("opengl")
            }}
        lenses = measure("servo", [*LENSES, "noise_alone"], Path(folder), arguments.repeat,
                         arguments.rounds)
    report("lenses and noise, opengl, the robot's camera", lenses)
    result["lenses_ms"] = lenses
    result["large_to_small"] = round(lenses["pinhole_640x480"] / lenses["pinhole"], 3)
    result["fisheye_to_pinhole"] = round(lenses["fisheye"] / lenses["pinhole"], 3)
    result["noise_ms"] = lenses["noise_alone"]
    result["accuracy"] = accuracy()
    print(f"\ntarget over 150 poses: {result['accuracy']}")
    print(json.dumps(result))


if __name__ == "__main__":
    main()
