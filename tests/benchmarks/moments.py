#!/usr/bin/env python3
"""Measure the time per image: grey conversion, threshold, moments of order 6, features with L.

Compared, in the same run, with ViSP's fromImage (order 6) and feature update, if libvisp-dev is
installed (a small C++ program is compiled for it). One thread. A round takes the median of its
calls, ours and ViSP's in turn; of the rounds the best counts, which other load on the machine
disturbs least. The last line is JSON, times in ms.

    python tests/benchmarks/moments.py [--repeats 200] [--rounds 5]
"""

# ruff: noqa: E402 - threads are limited before numpy is loaded, paths set before the package is
from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median
from types import SimpleNamespace

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"  # before numpy loads its BLAS

import checkout  # noqa: F401
import cv2
import numpy as np

from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_camera.detection_pipeline import DetectionPipeline, DetectionSettings
from aras_visual_servo_camera.images import decode
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.moment_feature_values import PAPER_FEATURES, Reference
from aras_visual_servo_camera.moment_feature_values import compute_moment_features as compute
from aras_visual_servo_camera.moments import Moments, Pinhole
from aras_visual_servo_camera.segmentation_settings import SegmentationSettings
from aras_visual_servo_camera.segmented_target import segment

SIZES = {"320x240": (320, 240), "640x480": (640, 480)}
PARTS = {"5%": 0.05, "30%": 0.30}


def picture(width: int, height: int, part: float) -> np.ndarray:
    """Draw a tilted black pentagon that covers `part` of a white image (height, width), uint8."""
    angle = np.array([10, 80, 150, 215, 300]) * np.pi / 180
    outline = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    area = Moments.from_polygon(outline).m00
    outline *= np.sqrt(part * width * height / area)
    outline += [width / 2, height / 2]
    grey = np.full((height, width), 255, np.uint8)
    cv2.fillPoly(grey, [np.round(outline * 16).astype(np.int32)], 0, cv2.LINE_AA, 4)
    return grey


def clock(function, repeats: int) -> float:
    """Median time of one call, ms; the first calls warm caches and clock up and do not count."""
    times = []
    for _ in range(repeats):
        function()
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        times.append(time.perf_counter() - start)
    return 1e3 * median(times)


def ours(grey: np.ndarray, repeats: int) -> dict[str, float]:
    """Return the times of the parts for an rgb8 message, ms."""
    height, width = grey.shape
    message = SimpleNamespace(
        encoding="rgb8",
        height=height,
        width=width,
        step=3 * width,
        data=np.repeat(grey[..., None], 3, axis=2).tobytes(),
        is_bigendian=0,
    )
    K = (0.6 * width, 0, width / 2, 0, 0.6 * width, height / 2, 0, 0, 1)
    camera = Pinhole.from_K(K)
    settings = SegmentationSettings(component="all")
    plane = Plane(0.1, 0.2, 2.0)

    def moments_of() -> Moments:
        target = segment(decode(message).grey, settings)
        column, row, w, h = target.box
        crop = target.mask[row : row + h, column : column + w]
        return Moments.from_image(crop, camera, 6, 255.0, (column, row))

    moments = moments_of()
    reference = Reference.from_moments(moments, 0.5)

    def whole():
        return compute(moments_of(), PAPER_FEATURES, plane, reference)

    pipeline = DetectionPipeline(DetectionSettings())
    pipeline.set_camera(CameraModel(width, height, K))
    lens = DetectionPipeline(DetectionSettings())
    lens.set_camera(CameraModel(width, height, K, (-0.2, 0.05, 0, 0, 0)))
    return {
        "ours": clock(whole, repeats),
        "ours_grey_threshold_moments": clock(moments_of, repeats),
        "ours_features": clock(lambda: compute(moments, PAPER_FEATURES, plane, reference), repeats),
        "ours_default_pipeline": clock(lambda: pipeline.measure(decode(message)), repeats),
        "ours_through_a_lens": clock(lambda: lens.measure(decode(message)), repeats),
    }


def build_visp(folder: Path) -> Path | None:
    """Compile the C++ program; return None if ViSP is not installed."""
    program = folder / "visp_moments"
    source = Path(__file__).with_name("visp_moments.cpp")
    try:
        flags = subprocess.run(
            ["pkg-config", "--cflags", "visp"], capture_output=True, text=True, check=True
        ).stdout.split()
        command = ["g++", "-O2", str(source), "-o", str(program), *flags]
        command += ["-lvisp_visual_features", "-lvisp_core"]
        built = subprocess.run(command, capture_output=True, text=True)
    except (FileNotFoundError, subprocess.CalledProcessError):
        print("ViSP is not installed (apt-get install libvisp-dev): no comparison")
        return None
    if built.returncode:
        print(f"the ViSP program does not compile: no comparison\n{built.stderr[-2000:]}")
        return None
    return program


def visp(program: Path, grey: np.ndarray, folder: Path, repeats: int) -> float:
    """Return ViSP's time for one image, ms. The image is inverted, because ViSP's objects are
    white."""
    height, width = grey.shape
    path = folder / "picture.pgm"
    path.write_bytes(b"P5\n%d %d\n255\n" % (width, height) + (255 - grey).tobytes())
    arguments = [0.6 * width, 0.6 * width, width / 2, height / 2, repeats]
    command = [str(program), str(path), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return sum(float(part) for part in done.stdout.split())


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=200, help="calls per round")
    parser.add_argument("--rounds", type=int, default=7, help="rounds; the best one counts")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    results: dict[str, dict[str, float]] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        program = build_visp(folder)
        for size, (width, height) in SIZES.items():
            for part, fraction in PARTS.items():
                grey = picture(width, height, fraction)
                rounds = []
                for _ in range(options.rounds):
                    times = ours(grey, options.repeats)
                    if program is not None:
                        times["visp"] = visp(program, grey, folder, options.repeats)
                    rounds.append(times)
                case = {key: round(min(r[key] for r in rounds), 4) for key in rounds[0]}
                if program is not None:
                    case["ratio"] = round(case["ours"] / case["visp"], 3)
                    case["allowed_ratio"] = 1.0 if part == "5%" else 0.5
                results[f"{size} {part}"] = case
                print(f"{size} {part:>3}: " + ", ".join(f"{k} {v:g}" for k, v in case.items()))
    met = all(c["ratio"] <= c["allowed_ratio"] for c in results.values() if "ratio" in c)
    print(json.dumps({"unit": "ms", "compared": program is not None, "met": met, "cases": results}))
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
