"""One run as a report takes it, whether it was recorded in a bag or carried out by the runner."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from aras_visual_servo_camera.moments import Moments
from aras_visual_servo_camera.undistortion import CameraModel
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.loop.state import CONVERGED

from ..errors import ViewError
from ..targets.geometry import PlacedTarget, Target
from .run import Details, Run

POINT = re.compile(r"([xy])_?(\d+)$")
# Corners of a target that are drawn one by one; a disc has more, and none of them is a point.
MOST_CORNERS = 16


@dataclass(frozen=True, eq=False)
class Images:
    """The camera's images.

    Attributes:
        stamp: (p,) exposures, s. arrival: (p,) when the recorder had them, s of the same clock.
        pictures: some of them, (stamp, (rows, columns, 3) rgb), in order.
    """

    stamp: np.ndarray
    arrival: np.ndarray
    pictures: tuple[tuple[float, np.ndarray], ...] = ()

    def nearest(self, stamp: float) -> np.ndarray | None:
        """The picture that is next to a stamp (s); None where there is none."""
        if not self.pictures:
            return None
        return min(self.pictures, key=lambda one: abs(one[0] - stamp))[1]


@dataclass(frozen=True, eq=False)
class Tracks:
    """Where points of the target went in the image.

    Attributes:
        names: of c points. stamp: (n,) s. pixels: (n, c, 2) column, row; NaN where unknown.
        desired: (c, 2) pixels, NaN where unknown.
        measured: whether the scheme saw them, or they are projected from true poses.
    """

    names: tuple[str, ...]
    stamp: np.ndarray
    pixels: np.ndarray
    desired: np.ndarray
    measured: bool


@dataclass(eq=False)
class Record:
    """Everything a report needs of one run; what is not known is None, NaN or empty.

    Attributes:
        name: of the run, in legends. source: where it is from, in words.
        run: the arrays; of a bag, joints and poses are the measured ones and tf's.
        details: what the loop worked out besides.
        units, tolerances: (k,) of the features.
        limits: least and greatest joints (j,), rad or m. speed: (j,) greatest speeds.
        joint_units: (j,) 'rad' or 'm'.
        camera: the true one. target: in the world. goal: as the loop had it.
        images: of the camera.
        centres: (n, 2) measured centre of gravity of the target, normalised, at run.stamp.
        pace: (p, 2) stamp, s, and real-time factor then.
        settings: what was asked for, in words, by name. versions: of what the numbers depend on.
        notes: what a reader must know before believing the rest.
        experiment: YAML text that repeats the run; empty where it is not known.
    """

    name: str
    source: str
    run: Run
    details: Details
    units: tuple[str, ...] = ()
    tolerances: tuple[float, ...] = ()
    limits: tuple[np.ndarray, np.ndarray] = (np.zeros(0), np.zeros(0))
    speed: np.ndarray = field(default_factory=lambda: np.zeros(0))
    joint_units: tuple[str, ...] = ()
    camera: CameraModel | None = None
    target: PlacedTarget | None = None
    goal: Goal | None = None
    images: Images = field(default_factory=lambda: Images(np.zeros(0), np.zeros(0)))
    centres: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    pace: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    settings: Mapping[str, str] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    experiment: str = ""

    def __post_init__(self) -> None:
        count = len(self.run.names)
        self.units = tuple(self.units) if len(self.units) == count else ("",) * count
        if len(self.tolerances) != count:
            self.tolerances = ()

    @property
    def converged(self) -> bool:
        """Whether the camera was held at the goal in the end, whatever else the loop had to say."""
        phases = self.run.phases
        return self.run.converged or bool(phases) and phases[-1] == CONVERGED

    @property
    def servoing(self) -> np.ndarray:
        """(m,) bool, joint states since the first image."""
        return self.run.servoing

    @property
    def began(self) -> float:
        """Stamp of the first image that was answered, s."""
        return float(self.run.stamp[0]) if len(self.run.stamp) else 0.0

    @property
    def time(self) -> np.ndarray:
        """(n,) s since then, of the images."""
        return self.run.stamp - self.began

    @property
    def joint_time(self) -> np.ndarray:
        """(m,) s since then, of the joint states."""
        return self.run.joint_stamp - self.began

    @property
    def real_time_factor(self) -> float:
        """Mean while servoing; NaN where it was not recorded."""
        if not len(self.pace):
            return float("nan")
        stamp, factor = self.pace.T
        during = (stamp >= self.began) & np.isfinite(factor)
        return float(factor[during].mean()) if during.any() else float("nan")

    def outline(self, pose: np.ndarray, stamp: float) -> np.ndarray | None:
        """Pixels (c, 2) of the target's silhouette for world_T_camera (4, 4); None: unknown."""
        if self.target is None or self.camera is None or not np.isfinite(pose).all():
            return None
        try:
            rim = self.target.shape.outline(self.target.seen_from(pose, stamp))
        except ViewError:
            return None
        return np.column_stack(self.camera.project(*np.asarray(rim, float).T))

    def pose_at(self, stamp: float) -> np.ndarray:
        """world_T_camera (4, 4) next to a stamp; NaN where none is known."""
        if not len(self.run.joint_stamp):
            return np.full((4, 4), np.nan)
        return self.run.true_pose[int(np.argmin(np.abs(self.run.joint_stamp - stamp)))]

    def tracks(self) -> Tracks | None:
        """What the scheme's points did in the image, or the target's corners and its centre."""
        if self.camera is None or not len(self.run.stamp):
            return None
        return _point_tracks(self) or _corner_tracks(self)


def _point_tracks(record: Record) -> Tracks | None:
    """Of features that are image points themselves: x0, y0, x1, ..."""
    found = [POINT.match(name) for name in record.run.names]
    if not found or not all(found):
        return None
    numbers = sorted({int(match[2]) for match in found})
    at = {(match[1], int(match[2])): i for i, match in enumerate(found)}
    if not all(("x", n) in at and ("y", n) in at for n in numbers):
        return None
    pairs = [(at["x", n], at["y", n]) for n in numbers]
    seen = np.stack([_pixels(record.camera, record.run.features[:, pair]) for pair in pairs], 1)
    known = np.flatnonzero(np.isfinite(record.run.desired).all(axis=1))
    wanted = np.full((len(pairs), 2), np.nan)
    if known.size:
        last = record.run.desired[known[-1]]
        wanted = np.concatenate([_pixels(record.camera, last[None, pair]) for pair in pairs])
    names = tuple(f"point {n}" for n in numbers)
    return Tracks(names, record.run.stamp, seen, wanted, measured=True)


def _corner_tracks(record: Record) -> Tracks | None:
    """Of the target's true corners, and of its measured centre of gravity, where they are known."""
    stamps, poses = record.run.stamp, record.run.pose
    names: list[str] = []
    seen: list[np.ndarray] = []
    wanted: list[np.ndarray] = []
    shape = None if record.target is None else record.target.shape
    corners = None if shape is None else _corners(shape, record.target, record.run.goal_pose, 0.0)
    if corners is not None and len(corners) <= MOST_CORNERS:
        tracked = [
            _corners(shape, record.target, pose, float(stamp))
            for pose, stamp in zip(poses, stamps, strict=True)
        ]
        tracked = [np.full(corners.shape, np.nan) if one is None else one for one in tracked]
        for i in range(len(corners)):
            names.append(f"corner {i}")
            seen.append(_pixels(record.camera, np.array([one[i] for one in tracked])))
            wanted.append(_pixels(record.camera, corners[i : i + 1])[0])
    centres = record.centres
    if shape is not None and not np.isfinite(centres).any():
        centres = np.array([_centre(record.target, pose, float(stamp))
                            for pose, stamp in zip(poses, stamps, strict=True)])  # fmt: skip
    if len(centres) == len(stamps) and np.isfinite(centres).any():
        names.append("centre of gravity")
        seen.append(_pixels(record.camera, centres))
        moments = None if record.goal is None else record.goal.moments
        goal = [np.nan, np.nan] if moments is None else [moments.xg, moments.yg]
        wanted.append(_pixels(record.camera, np.array([goal]))[0])
    if not names:
        return None
    return Tracks(tuple(names), stamps, np.stack(seen, 1), np.array(wanted), measured=False)


def _corners(
    shape: Target, target: PlacedTarget, pose: np.ndarray, stamp: float
) -> np.ndarray | None:
    """Normalised corners (c, 2) from world_T_camera; None where one is not before the camera."""
    if not np.isfinite(pose).all():
        return None
    try:
        return shape.points(target.seen_from(pose, stamp))
    except ViewError:
        return None


def _centre(target: PlacedTarget, pose: np.ndarray, stamp: float) -> np.ndarray:
    """Of gravity of the silhouette (2,), normalised; NaN where it is not before the camera."""
    if not np.isfinite(pose).all():
        return np.full(2, np.nan)
    try:
        rim = target.shape.outline(target.seen_from(pose, stamp))
    except ViewError:
        return np.full(2, np.nan)
    moments = Moments.from_polygon(np.asarray(rim, float), 2)
    return np.array([moments.xg, moments.yg])


def _pixels(camera: CameraModel, points: np.ndarray) -> np.ndarray:
    """Columns and rows (n, 2) of normalised points (n, 2); NaN stays."""
    found = np.full(points.shape, np.nan)
    known = np.isfinite(points).all(axis=1)
    if known.any():
        found[known] = np.column_stack(camera.project(*points[known].T))
    return found


def milestones(run: Run, parts: Sequence[float] = (1.0, 0.7, 0.4, 0.2, 0.08, 0.0)) -> list[float]:
    """Stamps (s) of the images at which these parts of the first error were left; 0: the last.

    What happens is told by the way that is left, not by the clock: most of a run is waiting for
    its end.
    """
    known = np.isfinite(run.error).all(axis=1) if run.error.size else np.zeros(0, bool)
    if not known.any():
        return [float(stamp) for stamp in run.stamp[[0, -1]]] if len(run.stamp) > 1 else []
    stamp, size = run.stamp[known], np.linalg.norm(scaled(run.error[known]), axis=1)
    size = size / max(size[0], 1e-300)
    found = [float(stamp[int(np.argmax(size <= part))]) for part in parts[:-1]
             if (size <= part).any()]  # fmt: skip
    return sorted({*found, float(stamp[0]), float(stamp[-1])})


def scaled(error: np.ndarray) -> np.ndarray:
    """Errors (n, k) in parts of the largest that each has had: comparable whatever their units."""
    largest = np.nanmax(np.abs(error), axis=0, initial=0.0)
    return error / np.where(largest > 0.0, largest, 1.0)


def nearest(sorted_stamps: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Index of the entry next to each wanted one."""
    at = np.searchsorted(sorted_stamps, wanted).clip(1, max(len(sorted_stamps) - 1, 1))
    at = at.clip(max=len(sorted_stamps) - 1)
    before = (at - 1).clip(0)
    return np.where(wanted - sorted_stamps[before] < sorted_stamps[at] - wanted, before, at)
