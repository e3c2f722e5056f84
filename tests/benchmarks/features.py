"""Measure the processor time of the method `measure` of every registered feature, at 320 x 240.

    python3 tests/benchmarks/features.py [--count 50] [--visp COMMAND]

COMMAND runs the program of visp_features.cpp, wherever ViSP is (a container, say), in a folder that
holds what --pictures DIR wrote; its column stands beside ours. ViSP works out s, L and e of each
feature; ours besides finds which corner is which and is checked for numbers that are not finite.
The last line is JSON: microseconds by name, the middle of `count` measures, and ViSP's.
"""

from __future__ import annotations

import argparse
import json
import shlex
import subprocess
import sys
import time
from pathlib import Path

import checkout  # noqa: F401
import cv2
import numpy as np
from feature_scenes import CORNERS, GOAL, PARALLELOGRAM, VIEWS, look

from aras_visual_servo_bench.targets.rendering import render_target as picture
from aras_visual_servo_bench.targets.target_factory import make_target
from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_controller.features import FEATURES
from aras_visual_servo_controller.features.base import Feature
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.observation.feature_observer import FeatureObserver
from aras_visual_servo_controller.observation.observation import Need, Observation
from aras_visual_servo_controller.schemes import FeatureScheme

CAMERA = CameraModel(320, 240, (300.0, 0, 159.5, 0, 300.0, 119.5, 0, 0, 1))
FACING = np.diag([1.0, -1.0, -1.0, 1.0])  # a poster's z is towards the camera
NEAR_GOAL = GOAL + np.pad(np.array([[0.02], [-0.01], [0.05]]), ((0, 1), (3, 0)))  # photometric
AWAY = {"kernel"}  # pixel counts of one camera: tests/benchmarks/moments.py


def seen(feature: Feature, place: np.ndarray, name: str) -> Observation:
    if Need.IMAGE not in feature.needs:
        corners = PARALLELOGRAM if name == "vanishing_points" else CORNERS
        return look(FeatureObserver(None, feature.needs), place, corners=corners)
    image = picture(POSTER, CAMERA, FACING @ np.linalg.inv(place))
    plane = Plane.from_pose(place[:3, :3], place[:3, 3])
    return FeatureObserver(None, feature.needs).observe_image(0.0, image, CAMERA, plane=plane)


def microseconds(name: str, count: int) -> float:
    feature = FEATURES.create(name)
    goal = Goal.teach(FeatureScheme(feature), seen(feature, GOAL, name))
    feature.check(goal)
    observation = seen(feature, NEAR_GOAL if Need.IMAGE in feature.needs else VIEWS[0], name)
    feature.measure(observation, goal)
    taken = []
    for _ in range(count):
        begin = time.process_time_ns()
        feature.measure(observation, goal)
        taken.append(time.process_time_ns() - begin)
    return float(np.median(taken)) / 1e3


def write_pictures(folder: Path) -> None:
    """Write the images for photometric features as PGM files for the ViSP program."""
    for name, place in (("goal", GOAL), ("near", NEAR_GOAL)):
        image = picture(POSTER, CAMERA, FACING @ np.linalg.inv(place))
        cv2.imwrite(str(folder / f"{name}.pgm"), image)


def visp(command: str, count: int) -> dict[str, float]:
    """Return the times measured with ViSP, microseconds, by name."""
    words = [*shlex.split(command), "goal.pgm", "near.pgm", str(GOAL[2, 3]), str(count)]
    done = subprocess.run(words, capture_output=True, text=True, check=True, timeout=300.0)
    told = (line.rsplit(" ", 1) for line in done.stdout.splitlines())
    return {name: round(float(value), 1) for name, value in told}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=50)
    parser.add_argument("--visp", help="command of ViSP's program, to stand beside ours")
    parser.add_argument("--pictures", type=Path, help="write its pictures there, and end")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    POSTER = make_target("poster", (0.8, 0.6))
    if options.pictures:
        options.pictures.mkdir(parents=True, exist_ok=True)
        write_pictures(options.pictures)
        sys.exit()
    theirs = visp(options.visp, options.count) if options.visp else {}
    found = {}
    for name in sorted(n for n, f in FEATURES.items() if n not in AWAY and f.camera_count == 1):
        found[name] = round(microseconds(name, options.count), 1)
        beside = f"   ViSP {theirs[name]:10.1f} us" if name in theirs else ""
        print(f"{name:28s} {found[name]:10.1f} us{beside}", flush=True)
    for name in sorted(set(theirs) - set(found)):
        print(f"{name:28s} {'':13s}   ViSP {theirs[name]:10.1f} us")
    print(json.dumps({"ours": found, "visp": theirs}))
