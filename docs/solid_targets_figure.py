#!/usr/bin/env python3
"""Draw images/solid_targets.png for solid_targets.md."""

# ruff: noqa: E402 - the paths must be set before the imports that need them
from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np

HERE = Path(__file__).parent
for package in ("base", "camera"):
    sys.path.insert(0, str(HERE.parent / "src" / f"aras_visual_servo_{package}" / "src"))
sys.path.insert(0, str(HERE.parent / "src" / "aras_sim_bridge" / "src"))
sys.path.insert(0, str(HERE.parent / "tests" / "unit" / "camera"))

from tracking_scenes import CAMERA, SOLIDS, Sequence, corners_of

from aras_visual_servo_base.poses import exponential
from aras_visual_servo_camera.model_tracker import Solid, SolidTracking
from aras_visual_servo_camera.model_tracker.visible_edges import sample_visible_edges

OFF = (0.002, -0.0015, 0.004, 0.012, -0.015, 0.02)  # error of the predicted pose, m and rad
BEFORE, FOUND = (60, 60, 230), (60, 220, 60)  # red and green, as (blue, green, red)
PICTURE, SCALE = 200, 2  # index in the sequence, and magnification


def draw(name: str, folder: Path) -> np.ndarray:
    """Draw a solid in front of clutter, with predicted (red) and measured (green) edges."""
    sequence, solid = (
        Sequence(name, "cluttered", folder),
        Solid.from_triangles(corners_of(name), name),
    )
    grey, true = sequence.picture(PICTURE), sequence.pose(PICTURE)
    tracking = SolidTracking(solid)
    tracking.start(exponential(OFF) @ true)
    found = tracking.track(grey, CAMERA).camera_T_solid
    large = cv2.resize(grey, None, fx=SCALE, fy=SCALE, interpolation=cv2.INTER_AREA)
    picture = cv2.cvtColor(large, cv2.COLOR_GRAY2BGR)
    for pose, colour in ((exponential(OFF) @ true, BEFORE), (found, FOUND)):
        for u, v in sample_visible_edges(solid, CAMERA, pose, 2.0).pixels:
            at = (int(round(SCALE * (u + 0.5) - 0.5)), int(round(SCALE * (v + 0.5) - 0.5)))
            cv2.circle(picture, at, 2, colour, -1, cv2.LINE_AA)
    u, v = CAMERA.project(*(true[:2, 3] / true[2, 3]))
    left, top = int(SCALE * u) - 220, int(SCALE * v) - 260
    return picture[max(top, 0) : max(top, 0) + 400, max(left, 0) : max(left, 0) + 440]


def main() -> None:
    """Write the figure."""
    with tempfile.TemporaryDirectory() as folder:
        parts = [draw(name, Path(folder)) for name in SOLIDS]
    cv2.imwrite(str(HERE / "images" / "solid_targets.png"), np.hstack(parts))


if __name__ == "__main__":
    main()
