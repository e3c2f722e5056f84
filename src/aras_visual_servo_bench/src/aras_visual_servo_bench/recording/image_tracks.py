"""Tracks of the target's points in the image, and stamps of the images that a report shows."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_camera.moments import Moments

from ..targets.geometry import PlacedTarget
from .run import Run, normalize_errors

POINT_NAME = re.compile(r"([xy])_?(\d+)$")
# Largest number of corners of a target whose corner trajectories are drawn. Discs are approximated
# by polygons with more corners, so their corners are not drawn.
MAX_CORNERS = 16
# For each of these fractions, a report shows the first image in which the norm of the errors is at
# most this fraction of its initial value.
MILESTONES = (1.0, 0.7, 0.4, 0.2, 0.08)


@dataclass(frozen=True, eq=False)
class ImageTracks:
    """Tracks of points of the target in the image.

    Attributes:
        names: names of the c points.
        stamp: stamps (n,) of the images, s.
        pixels: position (n, c, 2) of each point in each image (column, row), px; NaN if unknown.
        desired: desired position (c, 2) of each point, px; NaN if unknown.
        is_measured: True if the scheme measured the points, False if they are computed from true
            poses.
    """

    names: tuple[str, ...]
    stamp: np.ndarray
    pixels: np.ndarray
    desired: np.ndarray
    is_measured: bool


def compute_tracks(run: Run) -> ImageTracks | None:
    """Compute the tracks of the points that the scheme measures.

    For a scheme without points, compute the tracks of the target's corners and centre. Return None
    if the camera or the images of the run are unknown.
    """
    if run.camera is None or not len(run.stamp):
        return None
    return _read_point_tracks(run) or _compute_corner_tracks(run)


def _read_point_tracks(run: Run) -> ImageTracks | None:
    """Return the tracks of the features x0, y0, x1, ..., which are image points.

    Return None if the run has other features."""
    points = number_points(run.names)
    if not points or 2 * len(points) != len(run.names):
        return None
    pairs = [list(pair) for pair in points.values()]
    pixels = np.stack([_to_pixels(run.camera, run.features[:, pair]) for pair in pairs], 1)
    known = np.flatnonzero(np.isfinite(run.desired_features).all(axis=1))
    desired = np.full((len(pairs), 2), np.nan)
    if known.size:
        last = run.desired_features[known[-1]]
        desired = np.concatenate([_to_pixels(run.camera, last[None, pair]) for pair in pairs])
    names = tuple(f"point {n}" for n in points)
    return ImageTracks(names, run.stamp, pixels, desired, is_measured=True)


def number_points(names: Sequence[str]) -> dict[int, tuple[int, int]]:
    """Find the features x0, y0, x1, ..., which are image points.

    Returns:
        For each point number, the indices of its x and y in `names`.
    """
    found: dict[int, dict[str, int]] = {}
    for i, name in enumerate(names):
        if match := POINT_NAME.match(name):
            found.setdefault(int(match[2]), {})[match[1]] = i
    return {n: (pair["x"], pair["y"]) for n, pair in sorted(found.items()) if len(pair) == 2}


def _compute_corner_tracks(run: Run) -> ImageTracks | None:
    """Compute the tracks of the target's true corners and centre of gravity; None if unknown."""
    stamps, poses = run.stamp, run.pose
    names: list[str] = []
    pixels: list[np.ndarray] = []
    desired: list[np.ndarray] = []
    shape = None if run.target is None else run.target.shape
    corners = (
        None if shape is None else run.target.project(shape.points, run.goal_pose, run.end_stamp)
    )
    if corners is not None and len(corners) <= MAX_CORNERS:
        tracked = [
            run.target.project(shape.points, pose, float(stamp))
            for pose, stamp in zip(poses, stamps, strict=True)
        ]
        tracked = [np.full(corners.shape, np.nan) if one is None else one for one in tracked]
        for i in range(len(corners)):
            names.append(f"corner {i}")
            pixels.append(_to_pixels(run.camera, np.array([one[i] for one in tracked])))
            desired.append(_to_pixels(run.camera, corners[i : i + 1])[0])
    centres = run.centres
    if shape is not None and not np.isfinite(centres).any():
        centres = np.array([_compute_centre(run.target, pose, float(stamp))
                            for pose, stamp in zip(poses, stamps, strict=True)])  # fmt: skip
    if len(centres) == len(stamps) and np.isfinite(centres).any():
        names.append("centre of gravity")
        pixels.append(_to_pixels(run.camera, centres))
        moments = None if run.goal is None else run.goal.moments
        goal = [np.nan, np.nan] if moments is None else [moments.xg, moments.yg]
        desired.append(_to_pixels(run.camera, np.array([goal]))[0])
    if not names:
        return None
    return ImageTracks(
        tuple(names), stamps, np.stack(pixels, 1), np.array(desired), is_measured=False
    )


def _compute_centre(target: PlacedTarget, pose: np.ndarray, stamp: float) -> np.ndarray:
    """Compute the centre of gravity (2,) of the target's silhouette in normalised coordinates.

    Return NaN if the target is behind the camera."""
    rim = target.project(target.shape.outline, pose, stamp)
    if rim is None:
        return np.full(2, np.nan)
    moments = Moments.from_polygon(rim, 2)
    return np.array([moments.xg, moments.yg])


def _to_pixels(camera: CameraModel, points: np.ndarray) -> np.ndarray:
    """Convert points (n, 2) from normalised coordinates to pixels (column, row).

    The pixels of a point that is NaN are NaN."""
    pixels = np.full(points.shape, np.nan)
    known = np.isfinite(points).all(axis=1)
    if known.any():
        pixels[known] = camera.project_points(points[known])
    return pixels


def find_milestones(run: Run) -> list[float]:
    """Return the stamps (s) of the images that a report shows.

    They are the first image, the last image, and one image for each fraction in MILESTONES: the
    first image in which the norm of the errors is at most this fraction of its initial value.
    Images are not selected by their time, because little changes during most of a run.
    """
    known = np.isfinite(run.error).all(axis=1)
    if not run.names or not known.any():
        return [float(stamp) for stamp in run.stamp[[0, -1]]] if len(run.stamp) > 1 else []
    stamp, size = run.stamp[known], np.linalg.norm(normalize_errors(run.error[known]), axis=1)
    size = size / max(size[0], 1e-300)
    found = [float(stamp[int(np.argmax(size <= part))]) for part in MILESTONES
             if (size <= part).any()]  # fmt: skip
    return sorted({*found, float(stamp[0]), float(stamp[-1])})


def find_nearest(sorted_stamps: np.ndarray, stamps: np.ndarray) -> np.ndarray:
    """For each of `stamps`, return the index of the nearest entry of `sorted_stamps`."""
    after = np.searchsorted(sorted_stamps, stamps).clip(1, max(len(sorted_stamps) - 1, 1))
    after = after.clip(max=len(sorted_stamps) - 1)
    before = (after - 1).clip(0)
    return np.where(stamps - sorted_stamps[before] < sorted_stamps[after] - stamps, before, after)
