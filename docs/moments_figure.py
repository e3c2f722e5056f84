#!/usr/bin/env python3
"""Draw images/moments.png, the figure of moments.md."""

# ruff: noqa: E402 - the backend and the paths must be set before the imports that need them
from __future__ import annotations

import sys
from math import pi
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(folder) for folder in sorted(HERE.parent.glob("src/aras_*/src"))]
sys.path.insert(0, str(HERE.parent / "tests" / "unit" / "features"))

from feature_cases import L_SHAPE, TARGET, View, grey_image, rotation

from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_camera.detection_pipeline import DetectionPipeline, DetectionSettings
from aras_visual_servo_camera.images import Image
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.moment_feature_values import compute_moment_features
from aras_visual_servo_camera.moments import Moments
from aras_visual_servo_camera.target_orientation import (
    TargetOrientation,
    compute_third_product,
    rotate_third,
)

CAMERA = CameraModel(320, 240, (188.04, 0, 159.5, 0, 188.04, 119.5, 0, 0, 1))


def measure_moments(grey: np.ndarray, weighting: str) -> Moments:
    """Measure the moments of the target in a grey image, with 'binary' or 'coverage' weights."""
    pipeline = DetectionPipeline(DetectionSettings(weighting=weighting))
    pipeline.set_camera(CAMERA)
    return pipeline.measure(Image(grey, "mono8")).moments


def draw_moments(axes: plt.Axes) -> None:
    """Draw the grey pixels of a target with its centre of gravity and its main axes."""
    view = View(TARGET, rotation([0, 0, 0.5]), np.array([0.004, -0.003, 0.3]))
    grey = grey_image(view.image, CAMERA.pinhole)
    moments = measure_moments(grey, "coverage")
    u, v = CAMERA.project(np.array([moments.xg]), np.array([moments.yg]))
    alpha = compute_moment_features(moments, ("alpha",), Plane(0, 0, 1))["alpha"]
    spread = [moments.mu(2, 0), moments.mu(1, 1), moments.mu(0, 2)]
    axes.imshow(grey, cmap="gray", interpolation="nearest")
    main, cross = (alpha, "tab:orange", "main axis α"), (alpha + pi / 2, "0.5", None)
    for angle, colour, name in (main, cross):
        c, s = np.cos(angle), np.sin(angle)
        variance = (spread[0] * c * c + 2 * spread[1] * c * s + spread[2] * s * s) / moments.m00
        r = 2 * 188.04 * np.sqrt(variance)
        axes.plot([u - r * c, u + r * c], [v - r * s, v + r * s], color=colour, lw=2, label=name)
    axes.plot(u, v, "o", color="tab:red", label="centre of gravity")
    outline = CAMERA.project(*np.vstack([view.image, view.image[:1]]).T)
    axes.plot(*outline, color="tab:green", lw=1, label="true outline")
    axes.set(xlim=(u[0] - 32, u[0] + 32), ylim=(v[0] + 32, v[0] - 32))
    axes.set(xlabel="column", ylabel="row")
    axes.legend(loc="lower left", fontsize=8)
    axes.set_title("Grey edge pixels show which part of them is covered")


def draw_error(axes: plt.Axes) -> None:
    """Draw the error of the centroid while the target moves by two pixels."""
    shifts = np.linspace(0, 2, 81)
    for weighting, colour in (("binary", "0.5"), ("coverage", "tab:blue")):
        errors = []
        for shift in shifts:
            t = np.array([0.01 + shift * 0.25 / 188.04, 0.005, 0.25])
            view = View(TARGET, rotation([0, 0, 0.02]), t)
            moments = measure_moments(grey_image(view.image, CAMERA.pinhole), weighting)
            errors.append(188.04 * (moments.xg - Moments.from_polygon(view.image).xg))
        axes.plot(shifts, errors, color=colour, label=f"{weighting} weights")
    axes.set(xlabel="true shift, pixels", ylabel="error of the centre, pixels")
    axes.legend(fontsize=8)
    axes.grid(alpha=0.3)
    axes.set_title("Subpixel error of the centre of gravity")


def draw_branch(axes: plt.Axes) -> None:
    """Draw the agreement of third-order moments with the reference, in the image and rectified."""
    shape = (L_SHAPE - L_SHAPE.mean(axis=0)) * [1.0, 0.8]
    desired = Moments.from_polygon(shape / 0.5)
    reference = TargetOrientation.from_moments(desired, Plane(0, 0, 2))
    tilts = np.arange(-60, 61, 2.0)
    scores = {"moments of the image": [], "rectified moments": []}
    for tilt in tilts:
        view = View(shape, rotation([0, np.deg2rad(tilt), 0]), np.array([0, 0, 0.5]))
        moments = Moments.from_polygon(view.image)
        for plane, found in zip((Plane(0, 0, 2), view.plane), scores.values(), strict=True):
            now = TargetOrientation.from_moments(moments, plane)
            rotated = rotate_third(reference.third, now.upright_alpha - reference.upright_alpha)
            size = compute_third_product(rotated, rotated)
            size *= compute_third_product(now.third, now.third)
            found.append(compute_third_product(rotated, now.third) / np.sqrt(size))
    for (name, found), colour in zip(scores.items(), ("0.5", "tab:blue"), strict=True):
        axes.plot(tilts, found, color=colour, label=name)
    axes.axhline(0, color="tab:red", lw=1)
    axes.text(-20, -0.06, "below: the wrong half turn", color="tab:red", fontsize=8, va="top")
    axes.set(xlabel="tilt of the target, degrees", ylabel="agreement with the reference")
    axes.set_ylim(-0.4, 1.1)
    axes.legend(loc="lower right", fontsize=8)
    axes.grid(alpha=0.3)
    axes.set_title("Direction of the main axis for a tilted target")


def main() -> None:
    """Draw the three panels and write the image."""
    figure, axes = plt.subplots(1, 3, figsize=(15, 4.6), layout="constrained")
    for draw, part in zip((draw_moments, draw_error, draw_branch), axes, strict=True):
        draw(part)
    figure.savefig(HERE / "images" / "moments.png", dpi=90)


if __name__ == "__main__":
    main()
