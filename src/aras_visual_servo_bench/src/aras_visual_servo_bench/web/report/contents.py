"""What a report's page is made of, as plain values for its script: curves, film, scene, events."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from itertools import groupby
from typing import Any

import numpy as np

from ...drawing.shapes import FACES, LINES, STRIP, Shape, frustum, on_picture, picture_border
from ...numbers.printing import headed
from ...pictures.palette import LIVE_CURVES, SCENE, rgb
from ...pictures.panels import Panel, last
from ...pictures.views import servoed_poses, straight
from ...recording.film import chosen, film
from ...recording.run import Run
from ...recording.tracks import milestones, tracks

MOST_POSES = 2000  # of a path in space
FRUSTUM = 0.2  # of a drawn camera, part of the scene
NEAREST = 0.02  # m, least size of a scene
START, GOAL, IDEAL, FACE, RIM = (
    rgb(SCENE[name]) for name in ("start", "goal", "ideal", "face", "rim")
)


class Arrays:
    """Arrays that go into the page once each, as base64 of float32."""

    def __init__(self) -> None:
        self.texts: list[str] = []
        self._known: dict[bytes, int] = {}

    def put(self, values: np.ndarray) -> int:
        """The number under which the script finds it."""
        content = np.ascontiguousarray(values, "<f4").tobytes()
        if content not in self._known:
            self._known[content] = len(self.texts)
            self.texts.append(base64.b64encode(content).decode())
        return self._known[content]


def contents(
    runs: Sequence[Run], groups: Sequence[tuple[str, str, str, Sequence[Panel]]]
) -> dict[str, Any]:
    """All of it.

    Args:
        groups: key, title, words below, panels.
    """
    arrays = Arrays()
    told = {
        "end": last(runs),
        "runs": [
            {"name": run.name, "events": _events(run), "film": _film(run, arrays),
             "others": _other_films(run, arrays),
             "poses": _poses(run, arrays)} for run in runs
        ],
        "groups": [{"key": key, "title": title, "text": text,
                    "panels": [_panel(one, arrays) for one in found]}
                   for key, title, text, found in groups if found],
        "scene": _scene(runs),
    }  # fmt: skip
    return {**told, "arrays": arrays.texts}


def _panel(panel: Panel, arrays: Arrays) -> dict[str, Any]:
    curves = []
    for curve in panel.curves:
        time, values = curve.open()
        curves.append({"name": curve.name, "run": curve.run, "shade": curve.shade,
                       "dashed": curve.dashed, "pale": curve.pale,
                       "x": arrays.put(time), "y": arrays.put(values)})  # fmt: skip
    return {
        "title": headed(panel.title, panel.unit), "log": panel.log, "band": panel.band,
        "levels": panel.levels, "limits": panel.limits, "marks": panel.marks, "span": panel.span,
        "left_out": panel.left_out, "curves": curves,
    }  # fmt: skip


def _events(run: Run) -> list[tuple[float, str, str, str]]:
    """Since when (s) phase, outcome and reason are these, where they change."""
    rows = zip(run.time.tolist(), run.phases, run.outcomes, run.reasons, strict=True)
    return [next(same) for _, same in groupby(rows, key=lambda row: row[1:])]


def _film(run: Run, arrays: Arrays) -> dict[str, Any] | None:
    """Frames, and what is drawn over them, in the camera's pixels; None: no picture was kept."""
    images = run.images
    frames = images.film
    if not frames and images.pictures:
        stamps = set(chosen(np.array([stamp for stamp, _ in images.pictures]), run.began).tolist())
        frames = film((one for one in images.pictures if one[0] in stamps), len(stamps))
    if not frames:
        return None
    stamps = np.array([stamp for stamp, _ in frames])
    camera, wanted = run.camera, run.wanted_outline()
    height, width = (camera.height, camera.width) if camera else images.pictures[0][1].shape[:2]
    return {
        "time": arrays.put(stamps - run.began), "width": width, "height": height,
        "frames": [base64.b64encode(frame).decode() for _, frame in frames],
        "wanted": None if wanted is None else arrays.put(wanted), "tracks": _tracks(run, arrays),
        "milestones": [stamp - run.began for stamp in milestones(run)],
    }  # fmt: skip


def _other_films(run: Run, arrays: Arrays) -> list[dict[str, Any]]:
    """Frames of the other cameras than the control camera, each with that one's name."""
    films = []
    for name, seen in list(run.cameras.items())[1:]:
        stamps = np.array([stamp for stamp, _ in seen.film])
        kept = chosen(stamps, run.began)
        if not len(kept):
            continue
        frames = dict(seen.film)
        films.append({
            "camera": name, "time": arrays.put(kept - run.began),
            "width": seen.model.width, "height": seen.model.height,
            "frames": [base64.b64encode(frames[stamp]).decode() for stamp in kept.tolist()],
            "wanted": None, "tracks": None, "milestones": [],
        })  # fmt: skip
    return films


def _tracks(run: Run, arrays: Arrays) -> dict[str, Any] | None:
    found = tracks(run)
    if found is None:
        return None
    return {
        "time": arrays.put(found.stamp - run.began), "names": found.names,
        "measured": found.measured, "desired": arrays.put(found.desired),
        "pixels": [arrays.put(found.pixels[:, i]) for i in range(len(found.names))],
    }  # fmt: skip


def _thinned(run: Run) -> np.ndarray:
    """Some of the joint states (p,) while servoing, where the camera's pose is known."""
    known = run.servoing & np.isfinite(run.true_pose).all(axis=(1, 2))
    at = np.flatnonzero(known)
    return at[np.unique(np.linspace(0, len(at) - 1, min(MOST_POSES, len(at))).astype(int))]


def _poses(run: Run, arrays: Arrays) -> dict[str, int] | None:
    """World_T_camera, twelve numbers each, for the camera that moves; and places of the arm."""
    at = _thinned(run)
    time, poses = run.joint_time[at], run.true_pose[at]
    if not len(time):
        return None
    found = {"time": arrays.put(time), "rows": arrays.put(poses[:, :3].reshape(-1, 12))}
    if run.arm_places.size:
        places = run.arm_places[at]
        found |= {"arm": arrays.put(places), "joints": places.shape[1]}
    return found


def _scene(runs: Sequence[Run]) -> dict[str, Any] | None:
    """What stands still in space, where to look from, and the rim of a drawn camera."""
    paths = [servoed_poses(run) for run in runs]
    if not any(map(len, paths)):
        return None
    goals = [run.goal_pose for run in runs if np.isfinite(run.goal_pose).all()]
    corners = _corners(runs[0])
    points = np.vstack([*(path[:, :3, 3] for path in paths), *(g[None, :3, 3] for g in goals),
                        corners])  # fmt: skip
    low, high = points.min(axis=0), points.max(axis=0)
    size = max(float(np.linalg.norm(high - low)), NEAREST)
    borders = [None if run.camera is None else picture_border(run.camera) for run in runs]
    shapes: dict[str, list[Shape]] = {"target": _target(corners)}
    several = len(runs) > 1  # beside whose colours nothing else has one
    for number, (run, path, border) in enumerate(zip(runs, paths, borders, strict=True)):
        colour = _shade(number)
        if not len(path):
            continue
        own = [Shape("path", STRIP, path[:, :3, 3], (*colour, 1.0), 0.01 * size)]
        if np.isfinite(run.goal_pose).all():
            ideal = straight(path[0], run.goal_pose)[:, :3, 3]
            own.append(Shape("straight", LINES, ideal, (*IDEAL, 0.8), 0.003 * size))
            if border is not None:
                own += frustum("goal", run.goal_pose, border, FRUSTUM * size,
                               (*(IDEAL if several else GOAL), 0.9))  # fmt: skip
        if border is not None:
            own += frustum("start", path[0], border, FRUSTUM * size,
                           (*(IDEAL if several else START), 0.6))  # fmt: skip
        shapes[str(number)] = own
    return {
        "middle": (0.5 * (low + high)).tolist(), "size": size,
        "shapes": {key: [[shape.name, shape.plain()] for shape in some]
                   for key, some in shapes.items()},
        "arm": FACE, "colours": [[*(_shade(k) if several else RIM), 1.0] for k in range(len(runs))],
        "rims": [[] if border is None else on_picture(border, border, FRUSTUM * size).tolist()
                 for border in borders],
    }  # fmt: skip


def _shade(number: int) -> tuple[float, float, float]:
    """The colour of a run in space."""
    return rgb(LIVE_CURVES[number % len(LIVE_CURVES)])


def _corners(run: Run) -> np.ndarray:
    """Of the target's face (c, 3), in the world; none: it is not known."""
    if run.target is None:
        return np.zeros((0, 3))
    placed = run.target.world_T_target(run.began)
    return run.target.shape.vertices() @ placed[:3, :3].T + placed[:3, 3]


def _target(corners: np.ndarray) -> list[Shape]:
    """Its face, of triangles about its middle, and its rim."""
    if len(corners) < 3:
        return []
    after, middle = np.roll(corners, -1, axis=0), corners.mean(axis=0)
    faces = np.stack([corners, after, np.broadcast_to(middle, corners.shape)], 1).reshape(-1, 3)
    return [Shape("face", FACES, faces, (*FACE, 1.0)),
            Shape("rim", STRIP, np.vstack([corners, corners[:1]]), (*RIM, 1.0), 0.002)]
