"""Draws docs/images/run.gif, the README's moving picture: a run of the demo, seen from outside.

    .venv/bin/python docs/make_movie.py [--start 2016] [--out docs/images/run.gif]

Beside the robot is what its camera sees, with contour, main axis and the wanted outline (blue), and
below that the features' errors. All of it comes from one run without ROS; the view from outside is
PyBullet's software renderer, which needs no screen.
"""

from __future__ import annotations

import argparse
import re
from pathlib import Path

import cv2
import numpy as np
import pybullet
from PIL import Image, ImageDraw, ImageFont
from pybullet_utils.bullet_client import BulletClient

from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.experiment.robots import Robot, RobotSpec
from aras_visual_servo_bench.recording.run import Run
from aras_visual_servo_bench.runner.loop import Loop
from aras_visual_servo_bench.setup.assembly import assemble
from aras_visual_servo_camera import overlay
from aras_visual_servo_camera.images import Image as Picture
from aras_visual_servo_camera.pipeline import Pipeline, Settings

ROOT = Path(__file__).resolve().parents[1]
HERE = Path(__file__).resolve().parent
SCENE, VIEW = (480, 440), (320, 240)  # px, of the robot and of its camera's picture
GAP, GROUND, INK = 6, (250, 250, 250), (40, 40, 40)
COLOURS = ((0, 114, 178), (213, 94, 0), (0, 158, 115), (204, 121, 167))  # for every eye
EVERY = 2  # images of the camera to a picture of the movie
AFTER, LAST = 0.6, 1.6  # s that go on after it has settled; that the last picture stays
LARGEST = 2_000_000  # bytes


def main(argv: list[str] | None = None) -> int:
    """Draw it; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0],
                                     epilog="example: docs/make_movie.py --out out/run.gif")
    parser.add_argument("--start", default="2016", help="initial pose (2016)")
    parser.add_argument("--out", type=Path, default=HERE / "images" / "run.gif")
    options = parser.parse_args(argv)
    # Slowly, so that there is something to be seen.
    experiment = Experiment(start=options.start, gain=2.0, time_after_convergence=0.2)
    run, pictures, outline = servoed(experiment)
    scene = Scene(Robot(RobotSpec()))
    end = np.searchsorted(run.stamp, run.stamp[0] + run.compute_settling_time() + AFTER)
    wanted = range(0, min(int(end), len(pictures)), EVERY)
    frames = [frame(run, i, pictures[i], outline, scene) for i in wanted]
    period = 1000.0 * EVERY * float(np.median(np.diff(run.stamp)))
    palette = frames[len(frames) // 2].quantize(96, Image.Quantize.MEDIANCUT)
    drawn = [f.quantize(palette=palette, dither=Image.Dither.NONE) for f in frames]
    options.out.parent.mkdir(parents=True, exist_ok=True)
    drawn[0].save(
        options.out, save_all=True, append_images=drawn[1:], loop=0, optimize=True,
        duration=[round(period)] * (len(drawn) - 1) + [round(1000 * LAST)],
    )  # fmt: skip
    size = options.out.stat().st_size
    print(f"{options.out}: {len(drawn)} pictures, {size / 1e6:.2f} MB, {run.outcome}")
    return 0 if size < LARGEST else 1


def servoed(experiment: Experiment) -> tuple[Run, list[np.ndarray], np.ndarray]:
    """The run, its camera's pictures with the overlay, and the wanted outline, normalised."""
    parts = assemble(experiment)
    loop, pipeline, pictures = Loop(experiment, parts), Pipeline(Settings()), []
    outline = parts.target.shape.outline(parts.target.target_T_camera(parts.goal_pose))
    pipeline.set_camera(parts.calibrated_camera)
    try:
        while not loop.is_over:
            if loop.run_to_image() is not None:
                rgb = np.ascontiguousarray(loop.reading.image)
                measured = pipeline.measure(Picture(rgb, "rgb8"))
                pictures.append(overlay.draw(rgb, measured, outline))
        return loop.make_run(), pictures, outline
    finally:
        loop.close()


class Scene:
    """The robot as its description colours it, with shadows, from a place in the room."""

    def __init__(self, robot: Robot) -> None:
        self._client = BulletClient(pybullet.DIRECT)
        package = r"package://(\w+)"
        urdf = re.sub(package, lambda found: str(ROOT / "src" / found[1]), robot.urdf)
        path = ROOT / "out" / "movie.urdf"
        path.parent.mkdir(exist_ok=True)
        path.write_text(urdf)
        self._body = self._client.loadURDF(str(path), useFixedBase=True)
        path.unlink()
        joints = range(self._client.getNumJoints(self._body))
        self._joints = {
            self._client.getJointInfo(self._body, j)[1].decode(): j for j in joints
        }  # fmt: skip
        self._view = self._client.computeViewMatrixFromYawPitchRoll(
            [0.0, 0.0, 0.86], 2.0, 128.0, -22.0, 0.0, 2
        )
        self._lens = self._client.computeProjectionMatrixFOV(42.0, SCENE[0] / SCENE[1], 0.1, 10.0)

    def picture(self, names: tuple[str, ...], joints: np.ndarray) -> np.ndarray:
        """rgb (rows, columns, 3) with the joints (rad, m) there."""
        for name, value in zip(names, joints, strict=True):
            self._client.resetJointState(self._body, self._joints[name], float(value))
        twice = 2 * np.array(SCENE)
        image = self._client.getCameraImage(
            *twice.tolist(), self._view, self._lens, lightDirection=[1.0, 1.6, 3.0], shadow=1,
            lightAmbientCoeff=0.55, lightDiffuseCoeff=0.5, lightSpecularCoeff=0.1,
            renderer=pybullet.ER_TINY_RENDERER,
        )  # fmt: skip
        rgb = np.reshape(image[2], (twice[1], twice[0], 4))[..., :3].astype(np.uint8)
        rgb[np.reshape(image[4], rgb.shape[:2]) < 0] = GROUND
        return cv2.resize(rgb, SCENE, interpolation=cv2.INTER_AREA)


def frame(run: Run, i: int, picture: np.ndarray, outline: np.ndarray, scene: Scene) -> Image.Image:
    """One picture of the movie: the scene, the camera's picture, the errors up to now."""
    width, height = SCENE[0] + GAP + VIEW[0], SCENE[1]
    made = Image.new("RGB", (width, height), GROUND)
    made.paste(Image.fromarray(scene.picture(run.joint_names, run.joints[i])), (0, 0))
    left, below = SCENE[0] + GAP, VIEW[1] + GAP
    made.paste(Image.fromarray(picture), (left, 0))
    draw = ImageDraw.Draw(made)
    draw.rectangle((left, 0, width - 1, VIEW[1] - 1), outline=(170, 170, 170))
    curves(draw, run, i, (left, below, width - 1, height - 1))
    return made


def curves(draw: ImageDraw.ImageDraw, run: Run, i: int, box: tuple[int, int, int, int]) -> None:
    """Each feature's error over its largest, against time, up to the image `i`."""
    left, top, right, bottom = box[0] + 26, box[1] + 22, box[2] - 8, box[3] - 20
    font = ImageFont.load_default(12)
    t = run.stamp - run.stamp[0]
    until = run.compute_settling_time() + AFTER
    middle = 0.5 * (top + bottom)
    draw.line((left, middle, right, middle), fill=(200, 200, 200))
    draw.line((left, top, left, bottom), fill=INK)
    draw.text((left + 4, box[1] + 2), "error", font=font, fill=INK)
    draw.text((right, bottom + 4), f"{t[i]:.1f} s", font=font, fill=INK, anchor="ra")
    at = left + 48
    for name, error, colour in zip(run.names, run.error.T, COLOURS, strict=False):
        draw.text((at, box[1] + 2), name, font=font, fill=colour)
        at += int(draw.textlength(name, font)) + 14
        largest = np.nanmax(np.abs(run.error[:, list(run.names).index(name)]))
        x = left + (right - left) * t[: i + 1] / until
        y = middle - 0.48 * (bottom - top) * error[: i + 1] / largest
        points = list(zip(x.tolist(), y.tolist(), strict=True))
        if len(points) > 1:
            draw.line(points, fill=colour, width=2)


if __name__ == "__main__":
    raise SystemExit(main())
