"""The pose of a known solid from picture to picture, by its visible edges."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aras_visual_servo_base.poses import exponential, inverse, logarithm

from ..errors import ModelError
from ..undistortion import CameraModel
from .edge_search import (
    UNKNOWN_LEVEL,
    estimate_noise,
    find_candidates,
    measure_edges,
    predict_levels,
    update_levels,
)
from .pose_fitting import INLIER_DISTANCE, assess_pose, fit_pose
from .solid import Solid
from .visible_edges import EdgePoints, sample_visible_edges

# px between points: where edges are looked for, and where they are measured.
SEARCH_SPACING, MEASUREMENT_SPACING = 6.0, 4.0
MIN_POINTS = 60  # points; of a solid that is small in the picture they are nearer together
SEARCH_RANGE = 10.0  # px to either side of where edges are expected
START_SEARCH_RANGES = (20.0, 10.0, 40.0)  # px likewise, one after the other, where it is rough
MAX_SEARCHES, MAX_MEASUREMENTS = 4, 3  # at most
MEASUREMENT_RANGE = 0.7  # px from which on edges are measured, not looked for
REPEAT_CHANGE = 0.1  # px: after a change of the pose by more, edges are measured again
MIN_CHANGE, MIN_NOISE_RATIO = 10.0, 3.5  # grey levels of a change; times the noise
# px, scale of residuals at least: where edges are looked for, and measured. A fit begins with the
# first of its two and ends with the second: begun with that, edges that agree with a wrong pose
# would give those that do not no weight.
SEARCH_SCALES, MEASUREMENT_SCALES = (0.5, 0.5), (0.3, 0.02)
EDGE_ACCURACY = 0.03  # px to which an edge is measured without noise
LEVEL_TOLERANCE = 25.0  # grey levels of a remembered level
MIN_INLIERS, MIN_INLIER_SHARE = 15, 0.45  # points, and their part of the visible ones: less is lost
DEPTH_SPACING = 8  # px between pixels of a depth image
MIN_SHARE_RATIO = 0.9  # of the last picture's share: with more there was no need to look for edges
MIN_ROOM = 4.0  # px to other edges, with which a point can be measured
NO_POINTS = np.empty((0, 3))


@dataclass(frozen=True, eq=False)
class TrackedPose:
    """A pose and how well it is known.

    Attributes:
        camera_T_solid: (4, 4).
        covariance: (6, 6) of a change (m, rad) about the middle of the solid, in the camera's axes;
            beyond all measure along what the edges do not tell.
        unshared: part of the deviations by which another picture from the same pose may differ:
            what the points' distances exceed those by noise and measurement by, and all of it where
            the edges leave a motion open.
        share: part of the visible edge points that were found where the pose has them.
        count: of those points. residual: their distances, px, rms.
        lost: why the pose is not to be trusted, in words; empty where it is.
    """

    camera_T_solid: np.ndarray
    covariance: np.ndarray
    unrepeatable_part: float
    inlier_share: float
    inlier_count: int
    residual: float
    loss_reason: str


class ModelTracking:
    """Follows a solid; `start` tells where it is in the first picture.

    Attributes:
        solid: what is followed. found: in the last picture; None before the first.
    """

    def __init__(self, solid: Solid) -> None:
        self.solid = solid
        self._middle, self._radius = solid.middle, solid.radius
        self._free_motions = np.ascontiguousarray(solid.compute_free_motions().T)
        self.start(None)

    def start(self, camera_T_solid: np.ndarray | None) -> None:
        """Begin anew from a pose (4, 4), roughly; None: it is not known yet."""
        self.tracked_pose: TrackedPose | None = None
        self._pose = None if camera_T_solid is None else np.array(camera_T_solid, float)
        self._motion, self._is_new, self._inlier_share = np.zeros(6), True, 0.0
        self._levels = np.full((len(self.solid.edges), 2), UNKNOWN_LEVEL)

    @property
    def is_started(self) -> bool:
        """Whether it is known where to look."""
        return self._pose is not None

    def track(
        self, grey: NDArray[np.uint8], camera: CameraModel, expected_pose: np.ndarray | None = None,
        depth: NDArray[np.float32] | None = None,
    ) -> TrackedPose:  # fmt: skip
        """Find the solid in the next picture.

        Args:
            grey: (rows, columns).
            expected: (4, 4) camera_T_solid by what else is known of the motion; None: the motion
                between the last two pictures goes on.
            depth: (rows, columns) m along the optical axis, where there is a depth image.

        Raises:
            ModelError: it was not started.
        """
        if self._pose is None:
            raise ModelError(f"{self.solid.name}: the tracker was not told where to start")
        before = self._pose
        if expected_pose is None:
            expected_pose = exponential(self._motion) @ before
        noise = estimate_noise(grey)
        self._surface_points = (
            NO_POINTS if depth is None else self._sample_depth(depth, camera, expected_pose)
        )
        if self._is_new:
            tries = [(expected_pose, reach) for reach in START_SEARCH_RANGES]
        else:  # where it is expected nothing need be looked for
            tries = [(expected_pose, 0.0), (expected_pose, SEARCH_RANGE)]
        if np.abs(self._motion).max() > 0.0:  # it may have stopped
            tries.append((before, SEARCH_RANGE))
        found = None
        for pose, reach in tries:
            one = self._find_pose(grey, camera, pose, noise, reach)
            if found is None or one.inlier_share > found.inlier_share:
                found, self._best_samples = one, self._last_samples
            if not found.loss_reason and (
                reach > 0.0 or found.inlier_share > MIN_SHARE_RATIO * self._inlier_share
            ):
                break
        self.tracked_pose = found
        if found.loss_reason:
            self._motion = np.zeros(6)
            return found
        self._motion = np.zeros(6) if self._is_new else logarithm(
            found.camera_T_solid @ inverse(before)
        )
        self._pose, self._is_new, self._inlier_share = (
            found.camera_T_solid,
            False,
            found.inlier_share,
        )
        self._update_levels()
        return found

    def _find_pose(
        self, grey: np.ndarray, camera: CameraModel, pose: np.ndarray, noise: float,
        search_range: float,
    ) -> TrackedPose:  # fmt: skip
        least = max(MIN_CHANGE, MIN_NOISE_RATIO * noise)
        tolerance = LEVEL_TOLERANCE + MIN_NOISE_RATIO * noise
        for look in range(MAX_SEARCHES if search_range > 0.0 else 0):
            samples = self._sample_edges(camera, pose, SEARCH_SPACING)
            away = find_candidates(grey, samples.pixels, samples.normals,
                self._predict_levels(samples),
                              search_range / (1.0 + look), least, tolerance)  # fmt: skip
            pose, moved, _, _ = self._fit_pose(
                samples, away, np.ones(len(away)), pose, SEARCH_SCALES
            )
            if moved < MEASUREMENT_RANGE and look:
                break
        for _ in range(MAX_MEASUREMENTS):
            samples = self._sample_edges(camera, pose, MEASUREMENT_SPACING)
            values = measure_edges(grey, samples.pixels, samples.normals, samples.room,
                              self._predict_levels(samples), least, tolerance, noise)  # fmt: skip
            weight = 1.0 / (EDGE_ACCURACY**2 + values[:, 3])  # NaN as they are
            pose, moved, residuals, A = self._fit_pose(
                samples, np.ascontiguousarray(values[:, :1]), weight, pose, MEASUREMENT_SCALES)
            if moved < REPEAT_CHANGE:
                break
        self._last_samples = samples, values, residuals
        return self._assess_pose(samples, weight, pose, residuals, A)

    def _sample_edges(self, camera: CameraModel, pose: np.ndarray, spacing: float) -> EdgePoints:
        """Those that are seen from a pose, every `spacing` px, or nearer where they are few."""
        points = sample_visible_edges(self.solid, camera, pose, spacing)
        if 0 < len(points.solid_points) < MIN_POINTS:
            nearer = max(1.0, spacing * len(points.solid_points) / MIN_POINTS)
            points = sample_visible_edges(self.solid, camera, pose, nearer)
        return points

    def _predict_levels(self, samples: EdgePoints) -> np.ndarray:
        """Grey levels (n, 2) on both sides of the points, where they are known."""
        return predict_levels(samples.edges, samples.are_faces_visible, self._levels)

    def _fit_pose(
        self, samples: EdgePoints, edge_offsets: np.ndarray, weight: np.ndarray, pose: np.ndarray,
        scales: tuple[float, float],
    ) -> tuple[np.ndarray, float, np.ndarray, np.ndarray]:  # fmt: skip
        """See fitting.fitted."""
        solid = self.solid
        return fit_pose(
            samples.solid_points, samples.image_points, samples.gains, edge_offsets, weight,
            np.ascontiguousarray(pose),
            *scales, self._middle, self._radius, self._free_motions, solid.vertices, solid.faces,
            solid.normals, self._surface_points)  # fmt: skip

    def _sample_depth(
        self, depth: np.ndarray, camera: CameraModel, pose: np.ndarray
    ) -> np.ndarray:
        """(n, 3) normalised x, y and depth, m, of pixels about the solid."""
        points = self.solid.vertices @ pose[:3, :3].T + pose[:3, 3]
        if not (points[:, 2] > 0.0).all():
            return NO_POINTS
        u, v = camera.project(*(points[:, :2] / points[:, 2:]).T)
        columns = np.arange(max(int(u.min()), 0), min(int(u.max()), camera.width), DEPTH_SPACING)
        rows = np.arange(max(int(v.min()), 0), min(int(v.max()), camera.height), DEPTH_SPACING)
        u, v = (a.ravel() for a in np.meshgrid(columns, rows))
        x, y, valid = camera.normalise(u, v)
        there = depth[v, u].astype(float)
        good = valid & np.isfinite(there) & (there > 0.0)
        return np.column_stack([x, y, there])[good]

    def _assess_pose(
        self, samples: EdgePoints, weight: np.ndarray, pose: np.ndarray, residuals: np.ndarray,
        A: np.ndarray,
    ) -> TrackedPose:  # fmt: skip
        asked = int((samples.room.min(axis=1) > MIN_ROOM).sum())
        count, rms, excess, covariance, is_open = assess_pose(
            residuals, weight, A, len(self._free_motions), self._radius)
        share = min(count / max(asked, 1), 1.0)
        unshared = 1.0 if is_open else math.sqrt(1.0 - 1.0 / excess)
        lost = ""
        if count < MIN_INLIERS or share < MIN_INLIER_SHARE:
            lost = (f"{self.solid.name} is lost: {count} of {asked} points of its edges are seen "
                    "where it should be")  # fmt: skip
        return TrackedPose(pose, covariance, unshared, share, count, rms, lost)

    def _update_levels(self) -> None:
        """Remember the grey levels beside the edges that were found."""
        samples, values, residuals = self._best_samples
        update_levels(
            self._levels,
            samples.edges,
            samples.are_faces_visible,
            values,
            residuals,
            INLIER_DISTANCE,
        )
