"""Compare model-based tracking with ViSP's generic tracker on the same image sequences.

    python3 tests/benchmarks/model_tracking.py [--count 500] [--visp PROGRAM] [--only box,cylinder]

PROGRAM is what visp_tracking.cpp makes; without it there are our columns alone. Three solids at
640 x 480, 0.4 m away, each clean, before clutter, with 20 % of it behind a card, and with a noise
of 5 grey levels; 500 pictures of one flight around it each (tests/unit/camera/tracking_scenes.py).
All begin with the true pose, and again after each picture in which they are lost (> 5 mm or 3°).
Errors are of the solid's middle and of its attitude, rms of the pictures in which it is not lost.
The last line is JSON.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import checkout  # noqa: F401
import cv2
import numpy as np
from tracking_scenes import (
    BOX,
    CAMERA,
    CONDITIONS,
    DEEP,
    HEIGHT,
    PROFILE,
    RADIUS,
    SOLIDS,
    Sequence,
    corners_of,
    error_of,
)

from aras_visual_servo_camera.model_tracker import Solid, SolidTracking

LOST = 5e-3, np.radians(3.0)  # m, rad
SHIFT = 0.03  # m, of the bracket's profile along x


def ours(solid: str, pictures: np.ndarray, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Track with this project; return the poses (n, 4, 4) and the processor time of each, s."""
    tracking = SolidTracking(Solid.from_triangles(corners_of(solid), solid))
    tracking.start(poses[0])
    tracking.track(pictures[0], CAMERA)  # what is compiled is loaded at its first call
    found, took, fresh = [], [], True
    for picture, true in zip(pictures, poses, strict=True):
        begin = time.process_time()
        if fresh:
            tracking.start(true)
        found.append(tracking.track(picture, CAMERA).camera_T_solid)
        took.append(time.process_time() - begin)
        fresh = is_lost(error_of(solid, found[-1], true))
    return np.array(found), np.array(took)


def is_lost(error: tuple[float, float]) -> bool:
    """Return whether an error (m, rad) is so large that the solid is lost."""
    return not (error[0] <= LOST[0] and error[1] <= LOST[1])


def visp(
    program: str, kind: str, solid: str, folder: Path, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Track with ViSP, with 'edges' or 'klt'; the result is that of `ours`."""
    points = corners_of(solid).reshape(-1, 3)
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    K = CAMERA.K
    numbers = [K[0], K[4], K[2], K[5], *middle, int(solid == "bracket"), int(solid == "cylinder")]
    told = subprocess.run(
        [program, str(folder), str(count), kind, *map(repr, map(float, numbers[:7])),
         *map(str, numbers[7:])], check=True, stdout=subprocess.PIPE, text=True,
    ).stdout  # fmt: skip
    lines = [line.split() for line in told.splitlines()]
    values = np.array([line for line in lines if len(line) == 17], float)
    return values[:, 1:].reshape(-1, 4, 4), 1e-3 * values[:, 0]


def cao(solid: str) -> str:
    """Return the solid in ViSP's file format: faces as polygons, a cylinder as one element."""
    if solid == "cylinder":
        points = [(0, 0, 0), (0, 0, HEIGHT), (RADIUS, 0, 0), (0, RADIUS, 0), (RADIUS, 0, HEIGHT),
                  (0, RADIUS, HEIGHT)]  # fmt: skip
        faces: list[tuple[int, ...]] = []
        rest = f"1\n0 1 {RADIUS}\n2\n{RADIUS} 0 3 2\n{RADIUS} 1 4 5\n"
    else:
        if solid == "box":
            x, y, high = BOX
            outline = [(-x / 2, -y / 2), (x / 2, -y / 2), (x / 2, y / 2), (-x / 2, y / 2)]
            ground, top = ([(a, b, z) for a, b in outline] for z in (0.0, high))
        else:  # the profile stands: (x, z) at y = DEEP / 2 and -DEEP / 2
            ground, top = ([(a - SHIFT, y, b) for a, b in PROFILE]
                           for y in (DEEP / 2, -DEEP / 2))  # fmt: skip
        n = len(ground)
        points = [*ground, *top]
        faces = [tuple(range(n, 2 * n)), tuple(reversed(range(n)))]
        faces += [(i, (i + 1) % n, n + (i + 1) % n, n + i) for i in range(n)]
        rest = "0\n0\n"
    lines = ["V1", str(len(points)), *(f"{x} {y} {z}" for x, y, z in points), "0", "0",
             str(len(faces)), *(f"{len(f)} " + " ".join(map(str, f)) for f in faces)]  # fmt: skip
    return "\n".join(lines) + "\n" + rest


def summary(
    solid: str, answer: tuple[np.ndarray, np.ndarray], poses: np.ndarray
) -> dict[str, float]:
    """Return errors (mm, degrees), number of lost images and processor time (ms) of an answer."""
    found, took = answer
    errors = np.array([error_of(solid, f, t) for f, t in zip(found, poses, strict=True)])
    lost = np.array([is_lost(e) for e in errors])
    rms = np.sqrt((errors[~lost] ** 2).mean(axis=0)) if not lost.all() else np.full(2, np.nan)
    return {"mm": 1e3 * rms[0], "degrees": float(np.degrees(rms[1])), "lost": int(lost.sum()),
            "ms": 1e3 * float(took.mean())}  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--visp", help="the program of visp_tracking.cpp")
    parser.add_argument("--only", default=",".join(SOLIDS))
    options = parser.parse_args()
    cv2.setNumThreads(1)
    results: dict[str, dict[str, dict[str, float]]] = {}
    print("| | ours | ViSP, edges | ViSP, edges and KLT |\n|---|---|---|---|")
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        for solid in options.only.split(","):
            (folder / "model.cao").write_text(cao(solid))
            for condition in CONDITIONS:
                sequence = Sequence(solid, condition, folder, options.count)
                drawn = list(sequence.pictures())
                pictures, poses = np.array([d[0] for d in drawn]), np.array([d[1] for d in drawn])
                rows = {"ours": summary(solid, ours(solid, pictures, poses), poses)}
                if options.visp:
                    pictures.tofile(folder / "pictures.raw")
                    np.savetxt(folder / "poses.txt", poses.reshape(-1, 16), "%.17g")
                    for kind in ("edges", "klt"):
                        answer = visp(options.visp, kind, solid, folder, options.count)
                        rows[kind] = summary(solid, answer, poses)
                results[f"{solid}, {condition}"] = rows
                cells = [f"{r['mm']:.3f} mm, {r['degrees']:.3f}°, {r['lost']} lost, "
                         f"{r['ms']:.1f} ms" for r in rows.values()]  # fmt: skip
                print(f"| {solid}, {condition} | {' | '.join(cells)} |", flush=True)
    print(json.dumps(results))
    return 0


if __name__ == "__main__":
    sys.exit(main())
