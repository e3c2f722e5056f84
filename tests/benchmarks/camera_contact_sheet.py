#!/usr/bin/env python3
"""Draw docs/images/camera_contact_sheet.png: the lenses and effects side by side.

    python3 tests/benchmarks/camera_contact_sheet.py [--out FILE] [--only mono8 noise ...]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np
from checkout import ROOT
from scenes import Bench, link_pose, looking

from aras_sim_bridge.camera import CameraConfig, CameraSensor
from aras_sim_bridge.description import Light, parse_urdf
from aras_sim_bridge.rendering import Lighting, create_renderer
from aras_sim_bridge.world import Pose

ROBOT = ROOT / "src/aras_visual_servo_gazebo"
COLUMNS, WIDTH, HEIGHT, TITLE, GAP = 5, 264, 198, 22, 8
SUN = Light("sun", direction=(-0.5, 0.3, -0.9), diffuse=(0.6, 0.6, 0.6, 1.0), cast_shadows=True)
EYE = looking([1.0, -0.9, 1.5], [0.1, 0.0, 0.8])
TABLE = 0.59  # m
BRICKS = {  # on the table: x, y, m
    "Red": (0.42, -0.30), "Green": (0.30, -0.22), "Blue": (0.20, -0.42), "Yellow": (0.45, -0.02),
    "Orange": (0.02, -0.32),
}
BRICK_ROW, BRICK_COLUMN = 150, 150  # px, of the piece of a Bayer mosaic that is shown enlarged

LAB = dict(camera_matrix=dict(fx=195.05, fy=195.1, cx=162.41, cy=127.2),
           distortion_coefficients=[-0.3306, 0.117, 0, 0, 0])
PANELS = {
    "pinhole 80 deg": {},
    "pinhole 130 deg": dict(horizontal_fov=np.radians(130)),
    "pinhole, centre at (200, 60)": dict(camera_matrix=dict(fx=190, fy=190, cx=200, cy=60)),
    "plumb_bob, the lab's of 2016": LAB,
    "rational_polynomial": dict(
        horizontal_fov=1.6, distortion_model="rational_polynomial",
        distortion_coefficients=[0.2, 0.05, 0.001, -0.002, 0.01, 0.3, 0.02, 0.0]),
    "preset wide, 128 deg": dict(
        camera_matrix=dict(fx=110, fy=110, cx=159.5, cy=119.5),
        distortion_coefficients=[-0.12, 0.012, 0, 0, 0]),
    "equidistant, k1 = -0.05": dict(lens="equidistant", horizontal_fov=np.pi,
                                    cutoff_angle=1.8, distortion_coefficients=[-0.05, 0, 0, 0]),
    "equidistant 180 deg": dict(lens="equidistant", horizontal_fov=np.pi),
    "equidistant 220 deg": dict(lens="equidistant", horizontal_fov=np.radians(220)),
    "equidistant, cutoff 60 deg": dict(lens="equidistant", horizontal_fov=np.pi,
                                       cutoff_angle=np.radians(60)),
    "stereographic 180 deg": dict(lens="stereographic", horizontal_fov=np.pi),
    "equisolid 180 deg": dict(lens="equisolid", horizontal_fov=np.pi),
    "orthographic 172 deg": dict(lens="orthographic", horizontal_fov=3.0),
    "gaussian noise, sigma 10": dict(effects=dict(noise_stddev=10.0)),
    "shot noise, full well 500": dict(effects=dict(shot_noise=0.51)),
    "motion blur, 20 ms, 2 rad/s": dict(
        effects=dict(exposure_time=0.02, exposure_samples=20)),
    "exposure 0.5": dict(effects=dict(exposure=0.5)),
    "gain 1.6": dict(effects=dict(gain=1.6)),
    "vignetting 0.7": dict(effects=dict(vignetting=0.7)),
    "all together": dict(effects=dict(
        noise_stddev=5.0, shot_noise=0.51, exposure=0.4, gain=2.0, vignetting=0.5,
        exposure_time=0.01, exposure_samples=10)),
    "mono8": dict(format="mono8"),
    "bayer_rggb8, 8 times larger": dict(format="bayer_rggb8"),
    "depth 0.8 .. 4 m": dict(depth=True),
    "segmentation": dict(segmentation=True),
    "pinhole 80 deg, soft shadows": {},
}


def robot_scene() -> Bench:
    """Return the shipped robot in the demo's first pose, and its target."""
    bench = Bench()
    robot = parse_urdf((ROBOT / "robots/aras_visual_servo.urdf").read_text(), lambda _: str(ROBOT))
    bench.world.spawn_ground_plane()
    bench.world.spawn(robot, "robot", joint_positions={
        "gantry": 0.1, "J2": 0.1745, "J3": -0.0873, "J5": -0.0873})
    target = parse_urdf((ROBOT / "targets/aras.urdf").read_text())
    bench.world.spawn(target, "target", Pose((0.0, 0.0, 0.591)))
    return bench


def turned(pose: np.ndarray, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    out = pose.copy()
    out[:3, :3] = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ pose[:3, :3]
    return out


def lay_bricks(bench: Bench) -> None:
    for colour, (x, y) in BRICKS.items():
        bench.box([0.05, 0.035, 0.03], [x, y, TABLE + 0.03], f"Gazebo/{colour}")


def panel(renderer, title: str, config: CameraConfig) -> np.ndarray:
    """Return an image with its title and a margin, (HEIGHT + TITLE + GAP, WIDTH + GAP, 3) rgb."""
    sensor = CameraSensor(config, renderer)
    frame, time_ns = None, 0
    while frame is None:
        time_ns += 1_000_000
        if sensor.is_due(time_ns):
            eye = turned(EYE, 2e-9 * time_ns) if config.effects.exposure_time else EYE
            frame = sensor.capture(link_pose(eye), time_ns)
    image = frame.image
    if frame.depth is not None:
        grey = np.clip((frame.depth - 0.8) / 3.2, 0, 1)
        image = cv2.applyColorMap((255 * (1 - grey)).astype(np.uint8), cv2.COLORMAP_VIRIDIS)
        image = cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
    if frame.segmentation is not None:
        label = frame.segmentation
        key = (label & 0xFFFFFF) * 31 + (label >> 24) * 57 + 1
        image = np.stack([key * 71 % 256, key * 113 % 256, key * 197 % 256], -1).astype(np.uint8)
        image[label < 0] = 0
    if image.ndim == 2:
        image = cv2.cvtColor(image, cv2.COLOR_GRAY2RGB)
    if "bayer" in config.encoding:
        image = image[BRICK_ROW:BRICK_ROW + 30, BRICK_COLUMN:BRICK_COLUMN + 40]
        small = cv2.resize(image, (WIDTH, HEIGHT), interpolation=cv2.INTER_NEAREST)
    else:
        small = cv2.resize(image, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    out = np.full((HEIGHT + TITLE, WIDTH, 3), 255, np.uint8)
    out[TITLE:] = small
    cv2.putText(out, title, (4, 15), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (0, 0, 0), 1, cv2.LINE_AA)
    return cv2.copyMakeBorder(out, 0, GAP, 0, GAP, cv2.BORDER_CONSTANT, value=(255, 255, 255))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path,
                        default=ROOT / "docs/images/camera_contact_sheet.png")
    parser.add_argument("--only", nargs="+", default=[""], help="parts of the panels' titles")
    options = parser.parse_args()
    out = options.out
    bench = robot_scene()
    lay_bricks(bench)
    plain, shaded = (create_renderer("exact", bench.world, light)
                     for light in (None, Lighting(lights=(SUN,), shadows="soft")))
    configs = {title: CameraConfig.from_mapping({"near": 0.02, "horizontal_fov": 1.4, **settings})
               for title, settings in PANELS.items()}  # fmt: skip
    panels = [panel(shaded if "shadows" in title else plain, title, config)
              for title, config in configs.items() if any(map(title.__contains__, options.only))]
    panels += [np.full_like(panels[0], 255)] * (-len(panels) % COLUMNS)
    rows = [np.hstack(panels[i:i + COLUMNS]) for i in range(0, len(panels), COLUMNS)]
    sheet = np.pad(np.vstack(rows)[..., ::-1], ((0, 0), (GAP, 0), (0, 0)), constant_values=255)
    out.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(out), sheet, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    print(f"{out}: {sheet.shape[1]} x {sheet.shape[0]}, {out.stat().st_size // 1000} kB")


if __name__ == "__main__":
    main()
