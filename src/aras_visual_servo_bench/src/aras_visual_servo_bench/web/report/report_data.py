"""Data of a report page for its script: curves, films, the 3-D scene and events, as JSON values."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from itertools import groupby
from typing import Any

import numpy as np

from ...metrics.formatting import format_heading
from ...plots.camera_figures import compute_face_corners, select_servoing_poses
from ...plots.palette import LIVE_CURVES, SCENE, to_rgb
from ...plots.panel import Panel
from ...plots.panels import find_last_time
from ...recording.film import encode_film, select_frames
from ...recording.image_tracks import compute_tracks, find_milestones
from ...recording.run import Run
from ...visualization.drawing_shapes import (
    FACES,
    LINES,
    STRIP,
    DrawingShape,
    compute_image_border,
    make_frustum,
    place_on_image_plane,
)

MAX_POSES = 2000  # largest number of poses of a camera path
# Largest number of points of an image trajectory, because the film draws all points at each time.
MAX_TRACK_POINTS = 5000
# number of points of the dashed straight path; each pair of points is a dash
STRAIGHT_POINTS = 40
FRUSTUM_SIZE = 0.2  # length of a drawn camera, relative to the size of the scene
MIN_SCENE_SIZE = 0.02  # smallest size of the scene, m
START, GOAL, IDEAL, FACE, RIM = (
    to_rgb(SCENE[name]) for name in ("start", "goal", "ideal", "face", "rim")
)


class ArrayTable:
    """Arrays of a report page; equal arrays are stored once.

    Attributes:
        texts: each array as base64 text of float32 numbers.
    """

    def __init__(self) -> None:
        self.texts: list[str] = []
        self._indices: dict[bytes, int] = {}

    def add(self, values: np.ndarray) -> int:
        """Store an array, and return its index in `texts`."""
        content = np.ascontiguousarray(values, "<f4").tobytes()
        if content not in self._indices:
            self._indices[content] = len(self.texts)
            self.texts.append(base64.b64encode(content).decode())
        return self._indices[content]


def make_contents(
    runs: Sequence[Run], groups: Sequence[tuple[str, str, str, Sequence[Panel]]]
) -> dict[str, Any]:
    """Return the data of a report page.

    Args:
        runs: runs of the report.
        groups: key, title, description and panels of each group of plots.
    """
    arrays = ArrayTable()
    contents = {
        "end": find_last_time(runs),
        "runs": [
            {"name": run.name, "events": _list_events(run), "film": _convert_film(run, arrays),
             "other_films": _convert_other_films(run, arrays),
             "poses": _convert_poses(run, arrays)} for run in runs
        ],
        "groups": [{"key": key, "title": title, "text": text,
                    "panels": [_convert_panel(one, arrays) for one in found]}
                   for key, title, text, found in groups if found],
        "scene": _make_scene(runs),
    }  # fmt: skip
    return {**contents, "arrays": arrays.texts}


def _convert_panel(panel: Panel, arrays: ArrayTable) -> dict[str, Any]:
    curves = []
    for curve in panel.curves:
        time, values = curve.insert_gaps()
        curves.append({"name": curve.name, "run": curve.run, "colour_index": curve.colour_index,
                       "dashed": curve.dashed, "is_pale": curve.is_pale,
                       "x": arrays.add(time), "y": arrays.add(values)})  # fmt: skip
    return {
        "title": format_heading(panel.title, panel.unit), "is_logarithmic": panel.is_logarithmic,
        "band": panel.band,
        "levels": panel.levels, "limits": panel.limits, "marks": panel.marks, "span": panel.span,
        "omitted_curves": panel.omitted_curves, "curves": curves,
    }  # fmt: skip


def _list_events(run: Run) -> list[tuple[float, str, str, str]]:
    """Return the events of a run: images at which the phase, outcome or reason changes.

    An event is a tuple of the time, s, the phase, the outcome and the reason.
    """
    rows = zip(run.time.tolist(), run.phases, run.outcomes, run.reasons, strict=True)
    return [next(same) for _, same in groupby(rows, key=lambda row: row[1:])]


def _convert_film(run: Run, arrays: ArrayTable) -> dict[str, Any] | None:
    """Return the images of the control camera, with outlines and points to draw on them (px).

    Return None if there are no images.
    """
    images = run.control_record
    frames = images.film
    if not frames and images.images:
        stamps = set(
            select_frames(np.array([stamp for stamp, _ in images.images]), run.start_stamp).tolist()
        )
        frames = encode_film((one for one in images.images if one[0] in stamps), len(stamps))
    if not frames:
        return None
    stamps = np.array([stamp for stamp, _ in frames])
    camera, outline = run.camera, run.project_desired_outline()
    height, width = (camera.height, camera.width) if camera else images.images[0][1].shape[:2]
    return {
        "time": arrays.add(stamps - run.start_stamp), "width": width, "height": height,
        "frames": [base64.b64encode(frame).decode() for _, frame in frames],
        "desired_outline": None if outline is None else arrays.add(outline),
        "tracks": _convert_tracks(run, arrays),
        "milestones": [stamp - run.start_stamp for stamp in find_milestones(run)],
    }  # fmt: skip


def _convert_other_films(run: Run, arrays: ArrayTable) -> list[dict[str, Any]]:
    """Return the images of all cameras except the control camera."""
    films = []
    for name, record in list(run.cameras.items())[1:]:
        stamps = np.array([stamp for stamp, _ in record.film])
        selected = select_frames(stamps, run.start_stamp)
        if not len(selected):
            continue
        frames = dict(record.film)
        films.append({
            "camera": name, "time": arrays.add(selected - run.start_stamp),
            "width": record.model.width, "height": record.model.height,
            "frames": [base64.b64encode(frames[stamp]).decode() for stamp in selected.tolist()],
            "desired_outline": None, "tracks": None, "milestones": [],
        })  # fmt: skip
    return films


def _convert_tracks(run: Run, arrays: ArrayTable) -> dict[str, Any] | None:
    found = compute_tracks(run)
    if found is None:
        return None
    at = _select_evenly(len(found.stamp), MAX_TRACK_POINTS)
    return {
        "time": arrays.add(found.stamp[at] - run.start_stamp), "names": found.names,
        "is_measured": found.is_measured, "desired": arrays.add(found.desired),
        "pixels": [arrays.add(found.pixels[at, i]) for i in range(len(found.names))],
    }  # fmt: skip


def _select_evenly(count: int, limit: int) -> np.ndarray:
    """Return the indices of all of `count` rows, or of `limit` evenly spaced ones."""
    return np.unique(np.linspace(0, count - 1, min(limit, count)).astype(int))


def _convert_poses(run: Run, arrays: ArrayTable) -> dict[str, int] | None:
    """Return the path of the camera, and the joints' 3-D positions for a drawing of the arm.

    A pose is the first three rows of world_T_camera, row by row. If there are more than MAX_POSES,
    evenly spaced ones are selected. Return None if no pose is known.
    """
    at = np.flatnonzero(run.servoing & np.isfinite(run.true_pose).all(axis=(1, 2)))
    at = at[_select_evenly(len(at), MAX_POSES)]
    time, poses = run.joint_time[at], run.true_pose[at]
    if not len(time):
        return None
    found = {"time": arrays.add(time), "rows": arrays.add(poses[:, :3].reshape(-1, 12))}
    if run.joint_origins.size:
        origins = run.joint_origins[at]
        found |= {"arm": arrays.add(origins), "joints": origins.shape[1]}
    return found


def _make_scene(runs: Sequence[Run]) -> dict[str, Any] | None:
    """Return the 3-D scene: its shapes that do not move, its centre, size and colours.

    The script of the page draws the moving cameras; `rims` contains the image border of each camera
    in the camera frame, m. Return None if no run has a path of the camera.
    """
    paths = [select_servoing_poses(run) for run in runs]
    if not any(map(len, paths)):
        return None
    goals = [run.goal_pose for run in runs if np.isfinite(run.goal_pose).all()]
    corners = compute_face_corners(runs[0])
    points = np.vstack([*(path[:, :3, 3] for path in paths), *(g[None, :3, 3] for g in goals),
                        corners])  # fmt: skip
    low, high = points.min(axis=0), points.max(axis=0)
    size = max(float(np.linalg.norm(high - low)), MIN_SCENE_SIZE)
    borders = [None if run.camera is None else compute_image_border(run.camera) for run in runs]
    shapes: dict[str, list[DrawingShape]] = {"target": _triangulate_face(corners)}
    several = len(runs) > 1  # with several runs, colours distinguish the runs
    for number, (run, path, border) in enumerate(zip(runs, paths, borders, strict=True)):
        colour = _choose_colour(number)
        if not len(path):
            continue
        run_shapes = [DrawingShape("path", STRIP, path[:, :3, 3], (*colour, 1.0), 0.01 * size)]
        if np.isfinite(run.goal_pose).all():
            ideal = np.linspace(path[0, :3, 3], run.goal_pose[:3, 3], STRAIGHT_POINTS)
            run_shapes.append(DrawingShape("straight", LINES, ideal, (*IDEAL, 0.8), 0.003 * size))
            if border is not None:
                goal_colour = (*(IDEAL if several else GOAL), 0.9)
                run_shapes += make_frustum(
                    "goal", run.goal_pose, border, FRUSTUM_SIZE * size, goal_colour
                )
        if border is not None:
            start_colour = (*(IDEAL if several else START), 0.6)
            run_shapes += make_frustum("start", path[0], border, FRUSTUM_SIZE * size, start_colour)
        shapes[str(number)] = run_shapes
    return {
        "middle": (0.5 * (low + high)).tolist(), "size": size, "camera_size": FRUSTUM_SIZE,
        "shapes": {key: [[shape.name, shape.to_json()] for shape in some]
                   for key, some in shapes.items()},
        "arm": FACE,
        "colours": [[*(_choose_colour(k) if several else RIM), 1.0] for k in range(len(runs))],
        "rims": [[] if border is None
                 else place_on_image_plane(border, border, FRUSTUM_SIZE * size).tolist()
                 for border in borders],
    }  # fmt: skip


def _choose_colour(number: int) -> tuple[float, float, float]:
    """Return the colour of the run with the index `number` in the 3-D view."""
    return to_rgb(LIVE_CURVES[number % len(LIVE_CURVES)])


def _triangulate_face(corners: np.ndarray) -> list[DrawingShape]:
    """Return the target's face as shapes: triangles around its centre, and its border.

    corners: (c, 3) corners of the face in the world frame, m.
    """
    if len(corners) < 3:
        return []
    after, middle = np.roll(corners, -1, axis=0), corners.mean(axis=0)
    faces = np.stack([corners, after, np.broadcast_to(middle, corners.shape)], 1).reshape(-1, 3)
    return [DrawingShape("face", FACES, faces, (*FACE, 1.0)),
            DrawingShape("rim", STRIP, np.vstack([corners, corners[:1]]), (*RIM, 1.0), 0.002)]
