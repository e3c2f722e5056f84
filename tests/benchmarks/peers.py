#!/usr/bin/env python3
"""Compare the processor time per image of a servo loop with that in other simulators.

    python3 tests/benchmarks/peers.py [--images 100] [--rounds 3] [--only NAME ...]

In all simulators a free camera is servoed to a square: 320 x 240 pixels, four corners, proportional
law. With MuJoCo and PyBullet, OpenCV finds the corners in the rendered images, and numpy computes
the camera twist; ViSP does both itself (visp_servoing.cpp). This simulator's loop also has its
checks and its diagnosis. The measurements take turns, each in a process of its own. The program
installs nothing: it prints what is missing for a simulator and leaves it out. MUJOCO_GL (egl or
osmesa) selects how MuJoCo renders without a screen; egl is the default.

Prints a table and, as its last line, JSON: ms of processor time per image, all threads included
(best round).
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import checkout  # noqa: F401
import numpy as np

SIZE = WIDTH, HEIGHT = 320, 240
FOCAL, HALF, DEPTH, PERIOD, GAIN = 250.0, 0.1, 0.5, 1.0 / 30.0, 1.5
WARM_UP = 20  # images before the measurement
LARGEST_ERROR = 0.02  # at the end, m (with corners of whole pixels), or of the features
NEAR, FAR = 0.05, 3.0  # clipping planes, m
SOURCE = Path(__file__).with_name("visp_servoing.cpp")
Render = Callable[[np.ndarray], np.ndarray]  # from the pose of the optical frame to grey levels


class MissingError(Exception):
    """A simulator cannot be measured; the message says what to install."""


def find_corners(grey: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Return the corners (4, 2) of the dark square in an image, each next to its row of `near`."""
    import cv2

    _, dark = cv2.threshold(grey, 100, 255, cv2.THRESH_BINARY_INV)
    outlines, _ = cv2.findContours(dark, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    outline = max(outlines, key=cv2.contourArea)
    corners = cv2.approxPolyDP(outline, 0.04 * cv2.arcLength(outline, True), True)[:, 0, :]
    if len(corners) != 4:
        raise RuntimeError(f"the outline has {len(corners)} corners instead of 4")
    corners = (corners - ((WIDTH - 1) / 2, (HEIGHT - 1) / 2)) / FOCAL
    return corners[[int(np.argmin(((corners - place) ** 2).sum(axis=1))) for place in near]]


def servo(render: Render, count: int) -> tuple[float, float]:
    """Return the processor time per image, ms, and the final distance from the goal, m."""
    from aras_visual_servo_base.poses import exponential, matrix_from_xyz_rpy

    square = HALF * np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
    goal = matrix_from_xyz_rpy((0.0, 0.0, -DEPTH), (0.0, 0.0, 0.0))
    pose = goal @ matrix_from_xyz_rpy((0.03, -0.02, -0.12), (0.05, -0.05, 0.2))
    desired = find_corners(render(goal), square / DEPTH)
    x, y = desired.T
    L = np.zeros((8, 6))
    L[0::2] = np.c_[-1.0 / DEPTH + 0 * x, 0 * x, x / DEPTH, x * y, -(1 + x * x), y]
    L[1::2] = np.c_[0 * x, -1.0 / DEPTH + 0 * x, y / DEPTH, 1 + y * y, -x * y, -x]
    corners = np.c_[square, np.zeros(4), np.ones(4)] @ np.linalg.inv(pose).T
    corners = corners[:, :2] / corners[:, 2:3]
    began = 0.0
    for k in range(-WARM_UP, count):
        if k == 0:
            began = time.process_time()
        corners = find_corners(render(pose), corners)
        twist = -GAIN * np.linalg.pinv(L) @ (corners - desired).ravel()
        pose = pose @ exponential(PERIOD * twist)
    spent = 1e3 * (time.process_time() - began) / count
    return spent, float(np.linalg.norm(pose[:3, 3] - goal[:3, 3]))


def mujoco(shadows: bool = True, antialiasing: bool = True) -> Render:
    os.environ.setdefault("MUJOCO_GL", "egl")
    try:
        import mujoco
    except ImportError as error:
        raise MissingError(f"{error}; pip install mujoco pyopengl, apt install libegl1") from None
    samples = "" if antialiasing else ' offsamples="0"'
    angle = np.degrees(2.0 * np.arctan(HEIGHT / 2.0 / FOCAL))
    model = mujoco.MjModel.from_xml_string(f"""<mujoco>
      <visual><global offwidth="{WIDTH}" offheight="{HEIGHT}"/><quality{samples}/>
        <map znear="0.05" zfar="10"/></visual>
      <worldbody><light pos="0 0 -3" dir="0 0 1"/>
        <body mocap="true" name="camera"><camera name="camera" fovy="{angle}"/></body>
        <geom type="box" size="1 1 0.01" pos="0 0 0.02" rgba="0.9 0.9 0.9 1"/>
        <geom type="box" size="{HALF} {HALF} 0.005" pos="0 0 0.005" rgba="0.02 0.02 0.02 1"/>
      </worldbody></mujoco>""")
    data = mujoco.MjData(model)
    try:
        renderer = mujoco.Renderer(model, HEIGHT, WIDTH)
    except Exception as error:
        raise MissingError(f"MuJoCo cannot render with MUJOCO_GL={os.environ['MUJOCO_GL']}: "
                           f"{error}; apt install libegl1 or libosmesa6") from None  # fmt: skip

    def render(pose: np.ndarray) -> np.ndarray:
        data.mocap_pos[0] = pose[:3, 3]
        # MuJoCo's camera looks along its -z axis.
        mujoco.mju_mat2Quat(data.mocap_quat[0], (pose[:3, :3] * (1.0, -1.0, -1.0)).ravel())
        mujoco.mj_forward(model, data)
        renderer.update_scene(data, "camera")
        renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = shadows
        return renderer.render()[:, :, 1]

    return render


def pybullet() -> Render:
    try:
        import pybullet as bullet
    except ImportError as error:
        raise MissingError(f"{error}; pip install pybullet") from None
    bullet.connect(bullet.DIRECT)
    for half, z, level in (((1.0, 1.0, 0.01), 0.02, 0.9), ((HALF, HALF, 0.005), 0.005, 0.02)):
        shape = bullet.createVisualShape(bullet.GEOM_BOX, halfExtents=half,
                                         rgbaColor=(level, level, level, 1.0))  # fmt: skip
        bullet.createMultiBody(0.0, baseVisualShapeIndex=shape, basePosition=(0.0, 0.0, z))
    projection = bullet.computeProjectionMatrixFOV(
        np.degrees(2.0 * np.arctan(HEIGHT / 2.0 / FOCAL)), WIDTH / HEIGHT, NEAR, FAR
    )

    def render(pose: np.ndarray) -> np.ndarray:
        view = np.linalg.inv(pose * np.array([1.0, -1.0, -1.0, 1.0]))  # it looks along its -z axis
        pixels = bullet.getCameraImage(
            WIDTH, HEIGHT, view.T.ravel().tolist(), projection, renderer=bullet.ER_TINY_RENDERER,
            lightDirection=(0.0, 0.0, -1.0), flags=bullet.ER_NO_SEGMENTATION_MASK,
        )[2]  # fmt: skip
        return np.ascontiguousarray(np.reshape(pixels, (HEIGHT, WIDTH, 4))[:, :, 1], np.uint8)

    return render


def own(features: str, count: int) -> tuple[float, float]:
    """Return the time of this simulator's loop, with 'images' or 'exact' features, and the error.
    """
    from aras_visual_servo_bench.experiment.experiment import Experiment
    from aras_visual_servo_bench.runner.loop import Loop
    from aras_visual_servo_bench.setup.assembly import assemble

    experiment = Experiment(
        plant="free", features=features, scheme="points", duration=1e6, time_after_convergence=None,
        target={"shape": "square", "size": (0.1, 0.1)}, start={"height": [0.15, 0.2], "side": 0.05},
    )  # fmt: skip
    loop = Loop(experiment, assemble(experiment))
    for _ in range(WARM_UP):
        loop.run_to_image()
    began = time.process_time()
    for _ in range(count):
        state = loop.run_to_image()
    return 1e3 * (time.process_time() - began) / count, float(np.abs(state.error).max())


def visp(features: str, count: int) -> tuple[float, float]:
    """Return the time of ViSP's loop, compiled here, and its final error of the features."""
    flags = subprocess.run(["pkg-config", "--cflags", "--libs", "visp"], capture_output=True,
                           text=True, check=False)  # fmt: skip
    if flags.returncode:
        raise MissingError("apt install libvisp-dev g++ pkg-config")
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder) / "visp_servoing"
        subprocess.run(["g++", "-O3", SOURCE, "-o", program, *flags.stdout.split()], check=True)
        printed = subprocess.run([program, features, str(count)], capture_output=True, text=True,
                                 check=True).stdout  # fmt: skip
    spent, error = map(float, printed.split())
    return spent, error


MEASUREMENTS: dict[str, Callable[[int], tuple[float, float]]] = {
    "this simulator, images": lambda count: own("images", count),
    "this simulator, exact": lambda count: own("exact", count),
    "MuJoCo": lambda count: servo(mujoco(), count),
    "MuJoCo without shadows": lambda count: servo(mujoco(shadows=False), count),
    "MuJoCo without anti-aliasing": lambda count: servo(mujoco(antialiasing=False), count),
    "PyBullet": lambda count: servo(pybullet(), count),
    "ViSP, images": lambda count: visp("images", count),
    "ViSP, exact": lambda count: visp("exact", 100 * count),
}


def measure(name: str, images: int) -> tuple[float, float] | str:
    """Measure in a process of its own; return time and final error, or what is missing."""
    done = subprocess.run(
        [sys.executable, __file__, "--images", str(images), "--measure", name],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if done.returncode:
        lines = done.stderr.strip().splitlines()
        return lines[-1] if lines else f"ended with status {done.returncode}"
    spent, error = json.loads(done.stdout.splitlines()[-1])
    return (spent, error) if error < LARGEST_ERROR else f"the final error is {error:.3g}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--images", type=int, default=100, help="images per measurement")
    parser.add_argument("--rounds", type=int, default=3, help="measurements of each simulator")
    parser.add_argument("--only", nargs="+", default=[""], help="parts of the simulators' names")
    parser.add_argument("--measure", help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.measure:
        try:
            print(json.dumps(MEASUREMENTS[asked.measure](asked.images)))
        except MissingError as error:
            sys.exit(f"missing: {error}")
        return 0
    names = [name for name in MEASUREMENTS if any(part in name for part in asked.only)]
    found: dict[str, float] = {}
    for _ in range(asked.rounds):
        for name in list(names):
            result = measure(name, asked.images)
            if isinstance(result, str):
                print(f"{name}: {result}")
                names.remove(name)
            else:
                found[name] = min(found.get(name, np.inf), result[0])
    for name, spent in found.items():
        print(f"{name:30s} {spent:9.3f} ms per image")
    print(json.dumps(found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
