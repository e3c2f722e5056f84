"""Tracking of a known solid from image to image by its visible edges."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aras_visual_servo_base.poses import exponential, inverse, logarithm

from ..camera_model import CameraModel
from ..errors import TrackingModelError
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

# Distance between two sample points on an edge, px, when edges are searched and when they are
# measured.
SEARCH_SPACING, MEASUREMENT_SPACING = 6.0, 4.0
# smallest number of edge points; on small solids, the spacing is reduced to reach it
MIN_POINTS = 60
SEARCH_RANGE = 10.0  # px; edges are searched up to this distance from their expected place
# Search ranges for edges if only a rough start pose is known, px, in the order in which they are
# tried.
START_SEARCH_RANGES = (20.0, 10.0, 40.0)
# Largest numbers of searches for the edges, and of accurate measurements of the edges, per image.
MAX_SEARCHES, MAX_MEASUREMENTS = 4, 3
# Each image is processed in two phases: the edges are searched repeatedly, and then measured
# accurately. The first phase ends when a search moves the solid in the image by less than this
# distance, px.
MEASUREMENT_RANGE = 0.7
REPEAT_CHANGE = 0.1  # px; the edges are measured again if the pose has changed by more than this
# At an edge, the grey level changes by at least MIN_CHANGE grey levels, and by at least
# MIN_NOISE_RATIO times the standard deviation of the noise.
MIN_CHANGE, MIN_NOISE_RATIO = 10.0, 3.5
# Lower limits, px, of the estimated standard deviation of the residuals, in the (first, last) step
# of a fit to searched edges, and of a fit to measured edges. Residuals of several standard
# deviations are rejected. With a small first limit, a fit with a wrong initial pose would reject
# correct edges.
SEARCH_SCALES, MEASUREMENT_SCALES = (0.5, 0.5), (0.3, 0.02)
EDGE_ACCURACY = 0.03  # px, error of a measured edge in an image without noise
LEVEL_TOLERANCE = 25.0  # largest difference of a measured grey level from the stored grey level
# The solid is lost if fewer than MIN_INLIERS edge points are inliers, or less than the fraction
# MIN_INLIER_SHARE of the visible edge points.
MIN_INLIERS, MIN_INLIER_SHARE = 15, 0.45
DEPTH_SPACING = 8  # px; every DEPTH_SPACING-th pixel of a depth image is used
# The edges are first measured at their expected places. If the fraction of inliers is above
# MIN_SHARE_RATIO times the fraction in the previous image, no search for the edges is needed.
MIN_SHARE_RATIO = 0.9
MIN_ROOM = 4.0  # px; an edge point cannot be measured if another edge is nearer than this
NO_POINTS = np.empty((0, 3))


@dataclass(frozen=True, eq=False)
class TrackedPose:
    """Pose of a solid in one image, and the accuracy of this pose.

    Attributes:
        camera_T_solid: (4, 4) pose of the solid in the camera's frame.
        covariance: (6, 6) covariance of the pose's error. The error is a translation (m) and a
            rotation (rad) about the middle of the solid, in the camera's axes. The covariance is
            very large in directions that the edges do not determine.
        unrepeatable_part: standard deviation of the error's part that changes from image to image
            even if the camera is at rest, divided by that of the whole error, 0 to 1. It is 1 if
            the edges do not determine the pose.
        inlier_share: fraction of the visible edge points whose measured edge agrees with the pose
            (inliers).
        residual: rms distance of the inliers from the solid's edges, px.
        loss_reason: explanation if the solid is lost, otherwise empty.
    """

    camera_T_solid: np.ndarray
    covariance: np.ndarray
    unrepeatable_part: float
    inlier_share: float
    residual: float
    loss_reason: str


class SolidTracking:
    """Tracks a solid from image to image; `start` sets its pose in the first image.

    Attributes:
        solid: solid that is tracked.
        tracked_pose: result of the last image; None before the first image.
    """

    def __init__(self, solid: Solid) -> None:
        self.solid = solid
        self._middle, self._radius = solid.middle, solid.radius
        self._free_motions = np.ascontiguousarray(solid.compute_free_motions().T)
        self.start(None)

    def start(self, camera_T_solid: np.ndarray | None) -> None:
        """Restart the tracking from a rough pose (4, 4); stop it if the pose is None."""
        self.tracked_pose: TrackedPose | None = None
        self._pose = None if camera_T_solid is None else np.array(camera_T_solid, float)
        self._motion, self._is_new, self._inlier_share = np.zeros(6), True, 0.0
        self._levels = np.full((len(self.solid.edges), 2), UNKNOWN_LEVEL)

    @property
    def is_started(self) -> bool:
        """True if a start pose is set."""
        return self._pose is not None

    def track(
        self, grey: NDArray[np.uint8], camera: CameraModel, expected_pose: np.ndarray | None = None,
        depth: NDArray[np.float32] | None = None,
    ) -> TrackedPose:  # fmt: skip
        """Find the solid in the next image.

        Args:
            grey: (rows, columns) image.
            camera: intrinsics and distortion.
            expected_pose: (4, 4) expected camera_T_solid. By default, it is extrapolated from the
                motion between the last two images.
            depth: (rows, columns) depth image, m along the optical axis; None if there is none.

        Raises:
            TrackingModelError: the tracker has no start pose.
        """
        if self._pose is None:
            raise TrackingModelError(
                f"{self.solid.name}: the tracker has no start pose; call `start`"
            )
        last_pose = self._pose
        if expected_pose is None:
            expected_pose = exponential(self._motion) @ last_pose
        noise = estimate_noise(grey)
        self._surface_points = (
            NO_POINTS if depth is None else self._sample_depth(depth, camera, expected_pose)
        )
        if self._is_new:
            attempts = [(expected_pose, reach) for reach in START_SEARCH_RANGES]
        else:  # measure the edges at their expected places first, then search for them
            attempts = [(expected_pose, 0.0), (expected_pose, SEARCH_RANGE)]
        # the camera may have stopped, so also try the last pose
        if np.abs(self._motion).max() > 0.0:
            attempts.append((last_pose, SEARCH_RANGE))
        best = None
        for pose, reach in attempts:
            candidate = self._find_pose(grey, camera, pose, noise, reach)
            if best is None or candidate.inlier_share > best.inlier_share:
                best, self._best_samples = candidate, self._last_samples
            if not best.loss_reason and (
                reach > 0.0 or best.inlier_share > MIN_SHARE_RATIO * self._inlier_share
            ):
                break
        self.tracked_pose = best
        if best.loss_reason:
            self._motion = np.zeros(6)
            return best
        self._motion = np.zeros(6) if self._is_new else logarithm(
            best.camera_T_solid @ inverse(last_pose)
        )
        self._pose, self._is_new = best.camera_T_solid, False
        self._inlier_share = best.inlier_share
        samples, values, residuals = self._best_samples
        update_levels(self._levels, samples.edges, samples.are_faces_visible, values, residuals,
                      INLIER_DISTANCE)  # fmt: skip
        return best

    def _find_pose(
        self, grey: np.ndarray, camera: CameraModel, pose: np.ndarray, noise: float,
        search_range: float,
    ) -> TrackedPose:  # fmt: skip
        min_change = max(MIN_CHANGE, MIN_NOISE_RATIO * noise)
        tolerance = LEVEL_TOLERANCE + MIN_NOISE_RATIO * noise
        for iteration in range(MAX_SEARCHES if search_range > 0.0 else 0):
            samples = self._sample_edges(camera, pose, SEARCH_SPACING)
            levels = predict_levels(samples.edges, samples.are_faces_visible, self._levels)
            reach = search_range / (1.0 + iteration)
            edge_offsets = find_candidates(
                grey, samples.pixels, samples.normals, levels, reach, min_change, tolerance
            )
            pose, change, _, _ = self._fit_pose(
                samples, edge_offsets, np.ones(len(edge_offsets)), pose, SEARCH_SCALES
            )
            if change < MEASUREMENT_RANGE and iteration:
                break
        for _ in range(MAX_MEASUREMENTS):
            samples = self._sample_edges(camera, pose, MEASUREMENT_SPACING)
            levels = predict_levels(samples.edges, samples.are_faces_visible, self._levels)
            values = measure_edges(grey, samples.pixels, samples.normals, samples.room, levels,
                                   min_change, tolerance, noise)  # fmt: skip
            # the weight is NaN where no edge is measured
            weight = 1.0 / (EDGE_ACCURACY**2 + values[:, 3])
            pose, change, residuals, A = self._fit_pose(
                samples, np.ascontiguousarray(values[:, :1]), weight, pose, MEASUREMENT_SCALES)
            if change < REPEAT_CHANGE:
                break
        self._last_samples = samples, values, residuals
        return self._assess_pose(samples, weight, pose, residuals, A)

    def _sample_edges(self, camera: CameraModel, pose: np.ndarray, spacing: float) -> EdgePoints:
        """Sample the visible edges every `spacing` px, or closer if there are few points."""
        points = sample_visible_edges(self.solid, camera, pose, spacing)
        if 0 < len(points.solid_points) < MIN_POINTS:
            nearer = max(1.0, spacing * len(points.solid_points) / MIN_POINTS)
            points = sample_visible_edges(self.solid, camera, pose, nearer)
        return points

    def _fit_pose(
        self, samples: EdgePoints, edge_offsets: np.ndarray, weight: np.ndarray, pose: np.ndarray,
        scales: tuple[float, float],
    ) -> tuple[np.ndarray, float, np.ndarray, np.ndarray]:  # fmt: skip
        """Fit a pose to edge points of the solid with `fit_pose`."""
        solid = self.solid
        return fit_pose(
            samples.solid_points, samples.image_points, samples.gains, edge_offsets, weight,
            np.ascontiguousarray(pose), *scales, self._middle, self._radius, self._free_motions,
            solid.vertices, solid.faces, solid.normals, self._surface_points)  # fmt: skip

    def _sample_depth(
        self, depth: np.ndarray, camera: CameraModel, pose: np.ndarray
    ) -> np.ndarray:
        """Return the points (n, 3) of a depth image around the solid: normalised x, y and depth, m.

        pose: (4, 4) expected camera_T_solid.
        """
        points = self.solid.vertices @ pose[:3, :3].T + pose[:3, 3]
        if not (points[:, 2] > 0.0).all():
            return NO_POINTS
        u, v = camera.project(*(points[:, :2] / points[:, 2:]).T)
        columns = np.arange(max(int(u.min()), 0), min(int(u.max()), camera.width), DEPTH_SPACING)
        rows = np.arange(max(int(v.min()), 0), min(int(v.max()), camera.height), DEPTH_SPACING)
        u, v = (a.ravel() for a in np.meshgrid(columns, rows))
        x, y, valid = camera.normalise(u, v)
        depths = depth[v, u].astype(float)
        good = valid & np.isfinite(depths) & (depths > 0.0)
        return np.column_stack([x, y, depths])[good]

    def _assess_pose(
        self, samples: EdgePoints, weight: np.ndarray, pose: np.ndarray, residuals: np.ndarray,
        A: np.ndarray,
    ) -> TrackedPose:  # fmt: skip
        visible_count = int((samples.room.min(axis=1) > MIN_ROOM).sum())
        count, rms, excess, covariance, is_open = assess_pose(
            residuals, weight, A, len(self._free_motions), self._radius)
        inlier_share = min(count / max(visible_count, 1), 1.0)
        unrepeatable_part = 1.0 if is_open else math.sqrt(1.0 - 1.0 / excess)
        loss_reason = ""
        if count < MIN_INLIERS or inlier_share < MIN_INLIER_SHARE:
            loss_reason = (
                f"{self.solid.name} is lost: {count} of {visible_count} points on its visible "
                "edges are found near the expected pose; move more slowly, remove occlusions, or "
                "correct the start pose or the mesh"
            )
        return TrackedPose(pose, covariance, unrepeatable_part, inlier_share, rms, loss_reason)
