#!/usr/bin/env python3
"""Measure time and accuracy of rendered images.

    python3 tests/benchmarks/render.py [--poses 12] [--sizes 320x240,640x480]

Images from 320 x 240 to 1920 x 1200, of a table with a target and with 40 000 triangles around
that, through lenses from a pinhole to 220 degrees: processor time of all threads (the median of the
poses), and how far centroid, area and angle of the target (50 px and more wide, second moments
1.44 : 1) are from exact projection, RMS over the poses. A cell of the table stops after
`--patience` seconds with the poses that it has. The last line is JSON.
"""

from __future__ import annotations

import argparse
import json
import time

import checkout  # noqa: F401
import numpy as np
from scenes import Bench, link_pose, looking

from aras_sim_bridge.camera import CameraConfig, CameraSensor
from aras_sim_bridge.description import Geometry
from aras_sim_bridge.rendering import create_renderer
from aras_sim_bridge.rendering.renderer import Renderer

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


def target_scene(is_crowded: bool) -> Bench:
    """Make a black target on a white table; if crowded, among 40 balls of 1024 triangles."""
    bench = Bench()
    bench.box([3.0, 3.0, 0.295], [0, 0, 0.295])
    bench.box([*HALF, 1e-5], [0, 0, 0.59], "Gazebo/Black")
    for n in range(40 if is_crowded else 0):
        turn = 2 * np.pi * n / 40
        bench.body(Geometry("sphere", radius=0.012),
                   (0.085 * np.cos(turn), 0.085 * np.sin(turn), 0.602))
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--poses", type=int, default=12,
                        help="of each cell of the table, fewer in large images")
    parser.add_argument("--patience", type=float, default=30.0,
                        help="longest wall time of a cell, s (default 30)")
    parser.add_argument("--sizes", default=",".join(f"{w}x{h}" for w, h in SIZES),
                        help="of the images, px (default: %(default)s)")
    arguments = parser.parse_args()
    sizes = [tuple(map(int, size.split("x"))) for size in arguments.sizes.split(",")]
    cells = {}
    print(f"{'image':>11} {'lens, deg':>13} {'triangles':>9} {'ms':>7} {'centroid px':>11} "
          f"{'area %':>7} {'angle mrad':>10}")
    for triangles in (0, 40_000):
        bench = target_scene(triangles > 0)
        renderer = create_renderer("exact", bench.world)
        for lens, settings in ANGLES.items():
            for size in sizes:
                poses = max(arguments.poses * SIZES[0][0] // size[0], 3)
                one = cell(renderer, size, settings, poses, arguments.patience)
                cells[f"{size[0]}x{size[1]} {lens} {triangles}"] = one
                print(f"{size[0]:>6}x{size[1]:<4} {lens:>13} {triangles:>9} {one['ms']:>7} "
                      f"{one['centroid_rms_px']:>11} {one['area_rms_percent']:>7} "
                      f"{one['angle_mrad']:>10}", flush=True)
        renderer.close()
        bench.close()
    worst = {f"worst_{what}": max(one[what] for one in cells.values())
             for what in ("centroid_rms_px", "angle_mrad", "area_rms_percent")}
    print(json.dumps({**worst, "ms": {name: one["ms"] for name, one in cells.items()}}))


if __name__ == "__main__":
    main()
