"""Draw docs/images/run.gif, the animation of the README: a run of the demo with a view of the arm.

    .venv/bin/python docs/make_movie.py [--start 2016] [--out docs/images/run.gif]

The right side shows the image of the camera with contour, main axis and desired outline (blue), and
below it the errors of the features. All data come from one run without ROS. The view of the arm is
drawn by PyBullet's software renderer, which needs no display.
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
from aras_visual_servo_bench.experiment.robot_spec import RobotSpec
from aras_visual_servo_bench.experiment.robots import Robot
from aras_visual_servo_bench.recording.run import Run
from aras_visual_servo_bench.runner.loop import Loop
from aras_visual_servo_bench.setup.assembly import assemble
from aras_visual_servo_camera import overlay
from aras_visual_servo_camera.detection_pipeline import DetectionPipeline, DetectionSettings
from aras_visual_servo_camera.images import Image as Picture

ROOT = Path(__file__).resolve().parents[1]
HERE = Path(__file__).resolve().parent
SCENE, VIEW = (480, 440), (320, 240)  # size of the view of the arm and of the camera image, px
GAP, GROUND, INK = 6, (250, 250, 250), (40, 40, 40)
# Colours that colour-blind readers can distinguish.
COLOURS = ((0, 114, 178), (213, 94, 0), (0, 158, 115), (204, 121, 167))
EVERY = 2  # camera images per frame of the animation
AFTER, LAST = 0.6, 1.6  # time after settling, and duration of the last frame, s
LARGEST = 2_000_000  # largest size of the file, bytes


def main(argv: list[str] | None = None) -> int:
    """Draw the animation; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0],
                                     epilog="example: docs/make_movie.py --out out/run.gif")
    parser.add_argument("--start", default="2016", help="initial pose (2016)")
    parser.add_argument("--out", type=Path, default=HERE / "images" / "run.gif")
    options = parser.parse_args(argv)
    # A low gain makes the motion visible.
    experiment = Experiment(start=options.start, gain=2.0, time_after_convergence=0.2)
    run, images, outline = record_run(experiment)
    scene = Scene(Robot(RobotSpec()))
    end = np.searchsorted(run.stamp, run.stamp[0] + run.compute_settling_time() + AFTER)
    indices = range(0, min(int(end), len(images)), EVERY)
    frames = [draw_frame(run, i, images[i], outline, scene) for i in indices]
    period = 1000.0 * EVERY * float(np.median(np.diff(run.stamp)))
    palette = frames[len(frames) // 2].quantize(96, Image.Quantize.MEDIANCUT)
    drawn = [f.quantize(palette=palette, dither=Image.Dither.NONE) for f in frames]
    options.out.parent.mkdir(parents=True, exist_ok=True)
    drawn[0].save(
        options.out, save_all=True, append_images=drawn[1:], loop=0, optimize=True,
        duration=[round(period)] * (len(drawn) - 1) + [round(1000 * LAST)],
    )  # fmt: skip
    size = options.out.stat().st_size
    print(f"{options.out}: {len(drawn)} frames, {size / 1e6:.2f} MB, {run.outcome}")
    return 0 if size < LARGEST else 1


def record_run(experiment: Experiment) -> tuple[Run, list[np.ndarray], np.ndarray]:
    """Return a run, its camera images with the overlay, and the desired outline, normalised."""
    parts = assemble(experiment)
    loop, pipeline, images = Loop(experiment, parts), DetectionPipeline(DetectionSettings()), []
    outline = parts.target.shape.outline(parts.target.target_T_camera(parts.goal_pose))
    pipeline.set_camera(parts.calibrated_camera)
    try:
        while not loop.is_over:
            if loop.run_to_image() is not None:
                rgb = np.ascontiguousarray(loop.reading.image)
                measured = pipeline.measure(Picture(rgb, "rgb8"))
                images.append(overlay.draw(rgb, measured, outline))
        return loop.make_run(), images, outline
    finally:
        loop.close()


class Scene:
    """View of the robot with its colours and with shadows, from a fixed viewpoint."""

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
        """Return the rgb image (rows, columns, 3) for given joint positions, rad and m."""
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


def draw_frame(
    run: Run, i: int, image: np.ndarray, outline: np.ndarray, scene: Scene
) -> Image.Image:
    """Draw one frame of the animation: view of the arm, camera image, errors up to this image."""
    width, height = SCENE[0] + GAP + VIEW[0], SCENE[1]
    made = Image.new("RGB", (width, height), GROUND)
    made.paste(Image.fromarray(scene.picture(run.joint_names, run.joints[i])), (0, 0))
    left, below = SCENE[0] + GAP, VIEW[1] + GAP
    made.paste(Image.fromarray(image), (left, 0))
    draw = ImageDraw.Draw(made)
    draw.rectangle((left, 0, width - 1, VIEW[1] - 1), outline=(170, 170, 170))
    draw_curves(draw, run, i, (left, below, width - 1, height - 1))
    return made


def draw_curves(
    draw: ImageDraw.ImageDraw, run: Run, i: int, box: tuple[int, int, int, int]
) -> None:
    """Draw each feature's error relative to its largest, over time, up to image `i`."""
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
