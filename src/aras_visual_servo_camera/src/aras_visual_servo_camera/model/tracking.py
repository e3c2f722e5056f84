"""The pose of a known solid from picture to picture, by its visible edges."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aras_visual_servo_base.poses import exponential, inverse, logarithm

from ..errors import ModelError
from ..undistortion import CameraModel
from .fitting import EXPLAINED, fitted, judged
from .search import UNKNOWN, candidates, expected_levels, learn, measured, noise_of
from .solid import Solid
from .visible import EdgePoints, visible_samples

# px between points: where edges are looked for, and where they are measured.
SPARSE, DENSE = 6.0, 4.0
ENOUGH = 60  # points; of a solid that is small in the picture they are nearer together
REACH = 10.0  # px to either side of where edges are expected
STARTING = (20.0, 10.0, 40.0)  # px likewise, one after the other, where it is rough
LOOKS, MEASUREMENTS = 4, 3  # at most
NEAR = 0.7  # px from which on edges are measured, not looked for
AGAIN = 0.1  # px: after a change of the pose by more, edges are measured again
LEAST, NOISY = 10.0, 3.5  # grey levels of a change; times the noise
# px, scale of residuals at least: where edges are looked for, and measured. A fit begins with the
# first of its two and ends with the second: begun with that, edges that agree with a wrong pose
# would give those that do not no weight.
LOOSE, EXACT = (0.5, 0.5), (0.3, 0.02)
FLOOR = 0.03  # px to which an edge is measured without noise
TOLERANCE = 25.0  # grey levels of a remembered level
FEWEST, LEAST_SHARE = 15, 0.45  # points, and their part of the visible ones: less is lost
DEPTHS = 8  # px between pixels of a depth image
SAME = 0.9  # of the last picture's share: with more there was no need to look for edges
ROOM = 4.0  # px to other edges, with which a point can be measured
NOWHERE = np.empty((0, 3))


@dataclass(frozen=True, eq=False)
class Found:
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
    unshared: float
    share: float
    count: int
    residual: float
    lost: str


class ModelTracking:
    """Follows a solid; `start` tells where it is in the first picture.

    Attributes:
        solid: what is followed. found: in the last picture; None before the first.
    """

    def __init__(self, solid: Solid) -> None:
        self.solid = solid
        self._middle, self._radius = solid.middle, solid.radius
        self._slips = np.ascontiguousarray(solid.slips().T)
        self.start(None)

    def start(self, camera_T_solid: np.ndarray | None) -> None:
        """Begin anew from a pose (4, 4), roughly; None: it is not known yet."""
        self.found: Found | None = None
        self._pose = None if camera_T_solid is None else np.array(camera_T_solid, float)
        self._motion, self._fresh, self._share = np.zeros(6), True, 0.0
        self._levels = np.full((len(self.solid.edges), 2), UNKNOWN)

    @property
    def started(self) -> bool:
        """Whether it is known where to look."""
        return self._pose is not None

    def track(
        self, grey: NDArray[np.uint8], camera: CameraModel, expected: np.ndarray | None = None,
        depth: NDArray[np.float32] | None = None,
    ) -> Found:  # fmt: skip
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
        if expected is None:
            expected = exponential(self._motion) @ before
        noise = noise_of(grey)
        self._surface = NOWHERE if depth is None else self._depths(depth, camera, expected)
        if self._fresh:
            tries = [(expected, reach) for reach in STARTING]
        else:  # where it is expected nothing need be looked for
            tries = [(expected, 0.0), (expected, REACH)]
        if np.abs(self._motion).max() > 0.0:  # it may have stopped
            tries.append((before, REACH))
        found = None
        for pose, reach in tries:
            one = self._found(grey, camera, pose, noise, reach)
            if found is None or one.share > found.share:
                found, self._measured = one, self._last
            if not found.lost and (reach > 0.0 or found.share > SAME * self._share):
                break
        self.found = found
        if found.lost:
            self._motion = np.zeros(6)
            return found
        self._motion = np.zeros(6) if self._fresh else logarithm(
            found.camera_T_solid @ inverse(before)
        )
        self._pose, self._fresh, self._share = found.camera_T_solid, False, found.share
        self._learn()
        return found

    def _found(
        self, grey: np.ndarray, camera: CameraModel, pose: np.ndarray, noise: float,
        reach: float,
    ) -> Found:  # fmt: skip
        least = max(LEAST, NOISY * noise)
        tolerance = TOLERANCE + NOISY * noise
        for look in range(LOOKS if reach > 0.0 else 0):
            samples = self._points(camera, pose, SPARSE)
            away = candidates(grey, samples.pixel, samples.normal, self._expected(samples),
                              reach / (1.0 + look), least, tolerance)  # fmt: skip
            pose, moved, _, _ = self._fitted(samples, away, np.ones(len(away)), pose, LOOSE)
            if moved < NEAR and look:
                break
        for _ in range(MEASUREMENTS):
            samples = self._points(camera, pose, DENSE)
            values = measured(grey, samples.pixel, samples.normal, samples.room,
                              self._expected(samples), least, tolerance, noise)  # fmt: skip
            weight = 1.0 / (FLOOR**2 + values[:, 3])  # NaN as they are
            pose, moved, residuals, A = self._fitted(
                samples, np.ascontiguousarray(values[:, :1]), weight, pose, EXACT)
            if moved < AGAIN:
                break
        self._last = samples, values, residuals
        return self._judged(samples, weight, pose, residuals, A)

    def _points(self, camera: CameraModel, pose: np.ndarray, spacing: float) -> EdgePoints:
        """Those that are seen from a pose, every `spacing` px, or nearer where they are few."""
        points = visible_samples(self.solid, camera, pose, spacing)
        if 0 < len(points.at) < ENOUGH:
            nearer = max(1.0, spacing * len(points.at) / ENOUGH)
            points = visible_samples(self.solid, camera, pose, nearer)
        return points

    def _expected(self, samples: EdgePoints) -> np.ndarray:
        """Grey levels (n, 2) on both sides of the points, where they are known."""
        return expected_levels(samples.edge, samples.facing, self._levels)

    def _fitted(
        self, samples: EdgePoints, away: np.ndarray, weight: np.ndarray, pose: np.ndarray,
        scales: tuple[float, float],
    ) -> tuple[np.ndarray, float, np.ndarray, np.ndarray]:  # fmt: skip
        """See fitting.fitted."""
        solid = self.solid
        return fitted(
            samples.at, samples.seen, samples.gain, away, weight, np.ascontiguousarray(pose),
            *scales, self._middle, self._radius, self._slips, solid.vertices, solid.faces,
            solid.normals, self._surface)  # fmt: skip

    def _depths(
        self, depth: np.ndarray, camera: CameraModel, pose: np.ndarray
    ) -> np.ndarray:
        """(n, 3) normalised x, y and depth, m, of pixels about the solid."""
        points = self.solid.vertices @ pose[:3, :3].T + pose[:3, 3]
        if not (points[:, 2] > 0.0).all():
            return NOWHERE
        u, v = camera.project(*(points[:, :2] / points[:, 2:]).T)
        columns = np.arange(max(int(u.min()), 0), min(int(u.max()), camera.width), DEPTHS)
        rows = np.arange(max(int(v.min()), 0), min(int(v.max()), camera.height), DEPTHS)
        u, v = (a.ravel() for a in np.meshgrid(columns, rows))
        x, y, valid = camera.normalise(u, v)
        there = depth[v, u].astype(float)
        good = valid & np.isfinite(there) & (there > 0.0)
        return np.column_stack([x, y, there])[good]

    def _judged(
        self, samples: EdgePoints, weight: np.ndarray, pose: np.ndarray, residuals: np.ndarray,
        A: np.ndarray,
    ) -> Found:  # fmt: skip
        asked = int((samples.room.min(axis=1) > ROOM).sum())
        count, rms, excess, covariance, is_open = judged(
            residuals, weight, A, len(self._slips), self._radius)
        share = min(count / max(asked, 1), 1.0)
        unshared = 1.0 if is_open else math.sqrt(1.0 - 1.0 / excess)
        lost = ""
        if count < FEWEST or share < LEAST_SHARE:
            lost = (f"{self.solid.name} is lost: {count} of {asked} points of its edges are seen "
                    "where it should be")  # fmt: skip
        return Found(pose, covariance, unshared, share, count, rms, lost)

    def _learn(self) -> None:
        """Remember the grey levels beside the edges that were found."""
        samples, values, residuals = self._measured
        learn(self._levels, samples.edge, samples.facing, values, residuals, EXPLAINED)
