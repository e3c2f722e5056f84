"""What a camera without a simulated world sees whose rows are exposed one after the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from aras_sim_bridge.camera.shutter import RowBand
from aras_visual_servo_camera.undistortion import CameraModel

from ..errors import ViewError
from ..targets.geometry import Target, project
from .base import CameraReading
from .sight import Sight


def rolling(
    sight: Sight, poses: Sequence[np.ndarray], stamp_ns: int, random: np.random.Generator
) -> CameraReading:
    """What it sees; `poses`: world_T_camera (4, 4) of the control camera at each of its parts."""
    at = [stamp_ns + part.offset_ns for part in sight.parts]
    middle = min(range(len(at)), key=lambda n: abs(sight.parts[n].offset_ns))
    if sight.pictures:
        still = replace(sight, grey_noise=0.0, sensor=None, parts=(), depth=False)
        bands = [
            replace(still, camera=_rows(sight.camera, part)).look(pose, ns, random)
            for part, pose, ns in zip(sight.parts, poses, at, strict=True)
        ]
        depth = None
        if sight.depth:
            depth = replace(still, depth=True).look(poses[middle], stamp_ns, random).depth
        image = sight.noisy(np.vstack([band.image for band in bands]), stamp_ns, random)
        labelled = None
        if sight.labelled:
            labelled = np.vstack([band.labelled for band in bands])
        return CameraReading(
            stamp_ns, image, "mono8", depth, camera=sight.name, labelled=labelled
        )
    looks = [sight.seen_from(pose, ns) for pose, ns in zip(poses, at, strict=True)]
    try:
        outlines = _outlines(sight.target.shape, looks, middle)
        points = [sight.target.shape.points(look) for look in looks]
    except ViewError:
        return CameraReading(stamp_ns, camera=sight.name)
    outline = _in_own_rows(np.array([sight.pixels(one) for one in outlines]), sight.parts)
    last = np.array([sight.camera.width, sight.camera.height]) - 1
    if not sight.unbounded and not ((outline >= 0.0) & (outline <= last)).all():
        return CameraReading(stamp_ns, camera=sight.name)
    seen = None
    if points[0] is not None:
        seen = _in_own_rows(np.array([sight.pixels(one) for one in points]), sight.parts)
    return CameraReading(
        stamp_ns, outline=sight.jittered(outline, random, closed=True),
        points=sight.jittered(seen, random), camera=sight.name, jitter=sight.jitter,
    )  # fmt: skip


def _outlines(
    shape: Target, looks: Sequence[np.ndarray], middle: int
) -> list[np.ndarray]:
    """Where the corners (n, 2) of the outline seen at one of target_T_camera (4, 4) are at each,
    normalised: as if they lay in the target's plane, for an outline may have others meanwhile.

    Raises:
        ViewError: it is behind the camera.
    """
    x, y = shape.outline(looks[middle]).T
    A, B, C = shape.plane(looks[middle])
    places = np.column_stack([x, y, np.ones_like(x)]) / (A * x + B * y + C)[:, None]
    in_target = places @ looks[middle][:3, :3].T + looks[middle][:3, 3]
    return [project(in_target, look) for look in looks]


def _rows(camera: CameraModel, part: RowBand) -> CameraModel:
    """The camera of these rows alone."""
    K = np.reshape(camera.K, (3, 3)) - [[0, 0, 0], [0, 0, part.first], [0, 0, 0]]
    return replace(camera, height=part.last - part.first, K=tuple(K.ravel().tolist()))


def _in_own_rows(pixels: np.ndarray, parts: Sequence[RowBand]) -> np.ndarray:
    """Pixels (n, 2) where points were when their own rows were exposed.

    pixels: (parts, n, 2), px, of a camera that stands still at each part. Between two parts a point
    moves evenly; what lies above or below the picture is of its first or last rows.
    """
    rows = np.array([0.5 * (part.first + part.last - 1) for part in parts])
    ahead = pixels[..., 1] - rows[:, None]  # rows that the shutter still has to go
    after = np.maximum(np.argmax(ahead <= 0.0, axis=0), 1)
    after = np.where((ahead > 0.0).all(axis=0), len(parts) - 1, after)
    n = np.arange(pixels.shape[1])
    first, last = ahead[after - 1, n], ahead[after, n]
    share = np.clip(first / (first - last), 0.0, 1.0)[:, None]
    return (1.0 - share) * pixels[after - 1, n] + share * pixels[after, n]
