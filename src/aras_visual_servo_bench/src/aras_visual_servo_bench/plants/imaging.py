"""Imaging without a renderer: exact features of the target, or drawn images."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from aras_sim_bridge.camera import pixel_formats
from aras_sim_bridge.camera.effects import Effects
from aras_sim_bridge.camera.pipeline import ExposureAccumulator, ImagePipeline
from aras_sim_bridge.camera.shutter import RowBand
from aras_sim_bridge.camera.vibration import Vibration
from aras_sim_bridge.description.types import is_present
from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_camera.polygons import find_crossing
from aras_visual_servo_controller.observation.frame import NANOSECONDS, Frame

from ..errors import OutOfViewError
from ..experiment import cameras
from ..targets.geometry import PlacedTarget, Target, project
from .base import CAMERA, CameraPlacement

OCCLUSION_LEVEL = 128  # grey level below which a pixel is regarded as covered by the dark polygon
# maximum number of noise draws until the edges of a noisy outline do not cross each other
MAX_TRIES = 100


@dataclass(frozen=True)
class ImagingSettings:
    """Settings of a camera that observes its target without a renderer.

    `ExposureSchedule` applies camera effects and drops frames.

    camera: true intrinsics.
    target: target with its pose in the world.
    rate: number of images per second.
    has_images: whether images are drawn; False: outlines and corners are exact.
    effects: camera effects; those that change grey levels do not act on exact features.
    seed: seed of the random camera effects.
    encoding: encoding of drawn images, which are grey: mono8, mono16 or a Bayer pattern.
    jitter: standard deviation of the noise of exact points, px.
    has_depth: whether the camera also delivers a depth image.
    has_labels: whether the camera also delivers a mask of the target.
    occluder: lower and upper corner (x, y), m, of a white rectangle on the target.
    occlusion_times: intervals (start, end) in which the occluder is present, s; None: always.
    is_unbounded: whether exact features outside the image are measured, too; only features behind
        the camera are then lost.
    name: name of the camera.
    placement: pose relative to the control camera; None: this is the control camera.
    row_bands: exposures of an image with a rolling shutter or motion blur, in the order of time;
        each exposes a band of rows. Empty: all rows are exposed once, at the stamp of the image.
    vibration: vibration of the camera about its pose; None: the camera does not shake.
    blind_mask: array (rows, columns), True for the black pixels outside a fisheye lens's image
        circle; None: there are none.
    depth_range: minimum and maximum depth, m, at which the target is visible; None: no limits.
    """

    camera: CameraModel
    target: PlacedTarget
    rate: float = 30.0
    has_images: bool = False
    effects: Effects = Effects()
    seed: int = 0
    encoding: str = "mono8"
    jitter: float = 0.0
    has_depth: bool = False
    has_labels: bool = False
    occluder: tuple[tuple[float, float], tuple[float, float]] | None = None
    occlusion_times: tuple[tuple[float, float], ...] | None = None
    is_unbounded: bool = False
    name: str = CAMERA
    placement: CameraPlacement | None = None
    row_bands: tuple[RowBand, ...] = ()
    vibration: Vibration | None = None
    blind_mask: np.ndarray | None = None
    depth_range: tuple[float, float] | None = None

    @cached_property
    def exposure_bands(self) -> tuple[RowBand, ...]:
        """The exposures of an image; there is at least one."""
        return self.row_bands or (RowBand(0, 0, self.camera.height),)

    @cached_property
    def band_settings(self) -> tuple[ImagingSettings, ...]:
        """One copy of these settings for each exposure, with a camera of the exposed rows only."""
        return tuple(self.crop_rows(part) for part in self.exposure_bands)

    def make_pipeline(self) -> ImagePipeline:
        """Make the pipeline that applies the camera effects to the images of a run."""
        shape = (self.camera.height, self.camera.width)
        return ImagePipeline(self.effects, shape, self.seed, self.exposure_bands)

    def crop_rows(self, band: RowBand) -> ImagingSettings:
        """Return a copy of these settings with a camera that has only the rows of `band`."""
        if (height := band.last - band.first) == self.camera.height:
            return self
        K = np.reshape(self.camera.K, (3, 3)) - [[0, 0, 0], [0, 0, band.first], [0, 0, 0]]
        camera = replace(self.camera, height=height, K=tuple(K.ravel().tolist()))
        blind = None if self.blind_mask is None else self.blind_mask[band.first : band.last]
        return replace(self, camera=camera, row_bands=(), blind_mask=blind)

    def compute_exact_features(
        self, pose: np.ndarray, stamp_ns: int
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Project the outline and the points of the target at one instant.

        Args:
            pose: world_T_camera (4, 4) of the control camera, without vibration.
            stamp_ns: simulated time, ns.

        Returns:
            Outline (n, 2) and points (m, 2), px; None if the target is not in view.
        """
        target_T_camera = self.target_T_camera(pose, stamp_ns)
        try:
            outline = self.target.shape.outline(target_T_camera)
            points = self.target.shape.points(target_T_camera)
        except OutOfViewError:
            return None
        pixels = self.camera.project_points(outline)
        if (
            not (self.is_unbounded or cameras.is_in_view(outline, self.camera, 0.0, pixels))
            or self.depth_range is not None and self.is_clipped(outline, target_T_camera)
            or self.blind_mask is not None and self.is_blind_at(pixels)
        ):
            return None
        return pixels, None if points is None else self.camera.project_points(points)

    def is_clipped(self, outline: np.ndarray, target_T_camera: np.ndarray) -> bool:
        """Return True if the depth of a point of the outline is outside `depth_range`.

        outline: points (n, 2) in normalised coordinates."""
        if self.depth_range is None:
            return False
        a, b, c = self.target.shape.plane(target_T_camera)
        depth = 1.0 / (a * outline[:, 0] + b * outline[:, 1] + c)
        return bool(depth.min() < self.depth_range[0] or depth.max() > self.depth_range[1])

    def is_blind_at(self, pixels: np.ndarray) -> bool:
        """Return True if one of the pixels (n, 2) is outside the image circle of the lens."""
        if self.blind_mask is None:
            return False
        last = np.array([self.camera.width, self.camera.height]) - 1
        u, v = np.clip(np.rint(pixels), 0, last).astype(int).T
        return bool(self.blind_mask[v, u].any())

    def draw_image(self, pose: np.ndarray, stamp_ns: int) -> np.ndarray:
        """Draw the image (rows, columns), uint8, at one instant, without camera effects.

        pose: world_T_camera (4, 4) of the control camera, without vibration.
        """
        target_T_camera = self.target_T_camera(pose, stamp_ns)
        try:
            outline = self.target.shape.outline(target_T_camera)
        except OutOfViewError:
            outline = None
        if outline is not None and self.is_clipped(outline, target_T_camera):
            return np.full((self.camera.height, self.camera.width), cameras.WHITE_LEVEL, np.uint8)
        is_occluded = is_present(self.occlusion_times, stamp_ns / NANOSECONDS)
        image = self._draw_outline(outline, target_T_camera, is_occluded)
        if self.blind_mask is None:
            return image
        return np.where(self.blind_mask, np.uint8(cameras.DARK_LEVEL), image)

    def add_jitter(
        self, pixels: np.ndarray | None, random: np.random.Generator, is_closed: bool = False
    ) -> np.ndarray | None:
        """Add noise to points (n, 2), px.

        is_closed: whether the points are a closed outline. If edges of an outline with noise cross
            each other, the noise is drawn again, because edges of real outlines never cross.
        """
        if pixels is None:
            return None
        for _ in range(MAX_TRIES):
            noisy = pixels + random.normal(0.0, self.jitter, pixels.shape)
            if not is_closed or find_crossing(noisy) is None:
                break
        return noisy

    def target_T_camera(self, pose: np.ndarray, stamp_ns: int) -> np.ndarray:
        """Compute target_T_camera (4, 4) of this camera at one instant, with vibration.

        pose: world_T_camera (4, 4) of the control camera, without vibration.
        """
        camera_pose = pose if self.placement is None else self.placement.compute_pose(pose)
        if self.vibration is not None:
            camera_pose = camera_pose @ self.vibration.compute_pose(stamp_ns)
        return self.target.target_T_camera(camera_pose, stamp_ns / NANOSECONDS)

    def _draw_outline(
        self, outline: np.ndarray | None, target_T_camera: np.ndarray, is_occluded: bool
    ) -> np.ndarray:
        """Draw the image (rows, columns), uint8, of the target, with the occluder if present."""
        shape, occluder = self.target.shape, self.occluder if is_occluded else None
        if shape.is_textured or shape.is_solid:
            from ..targets.rendering import render_target

            return render_target(shape, self.camera, target_T_camera, occluder)
        image = cameras.draw_outline(outline, self.camera)
        if outline is not None and occluder is not None:
            (x0, y0), (x1, y1) = occluder
            corners = np.array([(x, y, shape.height) for x, y in (
                (x0, y0), (x1, y0), (x1, y1), (x0, y1))])  # fmt: skip
            with contextlib.suppress(OutOfViewError):
                covered = cameras.draw_outline(project(corners, target_T_camera), self.camera)
                image = np.where(covered < OCCLUSION_LEVEL, np.uint8(cameras.WHITE_LEVEL), image)
        return image

    def draw_labels(self, pose: np.ndarray, stamp_ns: int) -> np.ndarray | None:
        """Draw the mask (rows, columns) of a solid target at one instant; it is 255 on the target.

        Return None for a flat target, because its mask consists of the dark pixels of its image.

        pose: world_T_camera (4, 4) of the control camera, without vibration.
        """
        if not self.target.shape.is_solid:
            return None
        from ..targets.rendering import render_mask

        return render_mask(self.target.shape, self.camera, self.target_T_camera(pose, stamp_ns))

    def draw_depth_image(self, pose: np.ndarray, stamp_ns: int) -> np.ndarray:
        """Draw the depth image (rows, columns), m, of the target's plane at one instant.

        The depth is inf at pixels whose ray does not meet the plane in front of the camera.

        pose: world_T_camera (4, 4) of the control camera, without vibration.
        """
        a, b, c = self.target.shape.plane(self.target_T_camera(pose, stamp_ns))
        u, v = np.meshgrid(np.arange(self.camera.width), np.arange(self.camera.height))
        x, y, valid = self.camera.normalise(u.ravel(), v.ravel())
        inverse_depth = a * x + b * y + c
        depth = np.full(inverse_depth.shape, np.inf, np.float32)
        in_front = valid & (inverse_depth > 0.0)
        depth[in_front] = 1.0 / inverse_depth[in_front]
        return depth.reshape(self.camera.height, self.camera.width)


def capture(
    imaging: ImagingSettings,
    world_T_camera: np.ndarray | Sequence[np.ndarray],
    stamp_ns: int = 0,
    random: np.random.Generator | None = None,
    pipeline: ImagePipeline | None = None,
) -> Frame:
    """Capture the image or the exact features of the target with one camera.

    Args:
        imaging: settings of the camera and its target.
        world_T_camera: pose (4, 4) of the control camera, without vibration, or a sequence with one
            pose for each exposure of the image.
        stamp_ns: stamp of the image, ns.
        random: random generator of the noise of exact features; None: a generator with seed 0.
        pipeline: camera effects with their state after earlier images; None: this is the first
            image.

    Returns:
        The frame. If features are exact and the target is not in view, the frame has no features.
    """
    bands = imaging.exposure_bands
    poses = world_T_camera
    if isinstance(poses, np.ndarray) and poses.ndim == 2:
        poses = [poses] * len(bands)
    random = np.random.default_rng(0) if random is None else random
    if imaging.has_images or len(bands) > 1:
        pipeline = imaging.make_pipeline() if pipeline is None else pipeline
        if imaging.has_images:
            return _draw_image(imaging, poses, stamp_ns, pipeline)
        features = _project_rolling_shutter(imaging, poses, stamp_ns, pipeline.middle_part)
    else:
        features = imaging.compute_exact_features(poses[0], stamp_ns)
    if features is None:
        return Frame(stamp_ns, name=imaging.name, camera=imaging.camera)
    outline, points = features
    if imaging.jitter:
        outline = imaging.add_jitter(outline, random, is_closed=True)
        points = imaging.add_jitter(points, random)
    return Frame(stamp_ns, outline=outline, points=points, name=imaging.name, jitter=imaging.jitter,
                 camera=imaging.camera)  # fmt: skip


def _draw_image(
    imaging: ImagingSettings, poses: Sequence[np.ndarray], stamp_ns: int, pipeline: ImagePipeline
) -> Frame:
    """Draw the frame of a camera: image with camera effects, target mask and depth image."""
    labels = ExposureAccumulator(imaging.exposure_bands, imaging.camera.height)
    is_solid = False
    for index, (band, pose) in enumerate(zip(imaging.band_settings, poses, strict=True)):
        ns = stamp_ns + imaging.exposure_bands[index].offset_ns
        pipeline.exposure.add(index, band.draw_image(pose, ns))
        if imaging.has_labels and (label := band.draw_labels(pose, ns)) is not None:
            labels.add(index, label)
            is_solid = True
    light = pipeline.exposure.take()
    mask = depth = None
    if imaging.has_labels:
        # A pixel belongs to the target if the target covers it for more than half of the exposure.
        on_target = labels.take() >= OCCLUSION_LEVEL if is_solid else light < OCCLUSION_LEVEL
        mask = on_target.view(np.uint8) * 255
    if imaging.has_depth:
        depth = imaging.draw_depth_image(poses[pipeline.middle_part], stamp_ns)
    image = pixel_formats.widen(pipeline.read_out(light, stamp_ns), imaging.encoding)
    return Frame(stamp_ns, image, imaging.encoding, depth, name=imaging.name, target_mask=mask,
                 camera=imaging.camera)  # fmt: skip


def _project_rolling_shutter(
    imaging: ImagingSettings, poses: Sequence[np.ndarray], stamp_ns: int, middle: int
) -> tuple[np.ndarray, np.ndarray | None] | None:
    """Project the outline and the points of the target with a rolling shutter.

    Args:
        poses: world_T_camera (4, 4) of the control camera, without vibration, for each exposure.
        stamp_ns: stamp of the image, ns.
        middle: index of the exposure in the middle of the image.

    Returns:
        Outline (n, 2) and points (m, 2), px; None if the target is not in view. The points are None
        if the target has no points.
    """
    bands, shape = imaging.exposure_bands, imaging.target.shape
    views = [imaging.target_T_camera(pose, stamp_ns + band.offset_ns)
             for pose, band in zip(poses, bands, strict=True)]  # fmt: skip
    try:
        outlines = _project_outlines(shape, views, middle)
        points = [shape.points(view) for view in views]
    except OutOfViewError:
        return None
    outline = _interpolate_rolling_shutter(
        np.array([imaging.camera.project_points(one) for one in outlines]), bands
    )
    last = np.array([imaging.camera.width, imaging.camera.height]) - 1
    if not imaging.is_unbounded and not ((outline >= 0.0) & (outline <= last)).all():
        return None
    if imaging.is_blind_at(outline) or imaging.is_clipped(
        shape.outline(views[middle]), views[middle]
    ):
        return None
    if points[0] is None:
        return outline, None
    return outline, _interpolate_rolling_shutter(
        np.array([imaging.camera.project_points(one) for one in points]), bands
    )


def _project_outlines(
    shape: Target, poses: Sequence[np.ndarray], middle: int
) -> list[np.ndarray]:
    """Project the outline of a target at several camera poses.

    The outline of a solid can have different corners at different poses. Therefore, the corners of
    the outline at `poses[middle]` are converted to points in the plane of the target, and these
    points are projected at all poses.

    Args:
        shape: geometry of the target.
        poses: target_T_camera (4, 4) at each instant.
        middle: index of the pose that determines the corners.

    Returns:
        Corners (n, 2) in normalised coordinates, for each pose.

    Raises:
        OutOfViewError: the target is behind the camera.
    """
    x, y = shape.outline(poses[middle]).T
    A, B, C = shape.plane(poses[middle])
    points = np.column_stack([x, y, np.ones_like(x)]) / (A * x + B * y + C)[:, None]
    in_target = points @ poses[middle][:3, :3].T + poses[middle][:3, 3]
    return [project(in_target, pose) for pose in poses]


def _interpolate_rolling_shutter(pixels: np.ndarray, bands: Sequence[RowBand]) -> np.ndarray:
    """Compute the pixel of each point at the time when the row of this pixel is exposed.

    Between two exposures, a point moves at constant velocity. A point above the image has its pixel
    at the first exposure, a point below the image its pixel at the last exposure.

    Args:
        pixels: pixels (b, n, 2) of n points at the times of b exposures.
        bands: rows of each exposure.

    Returns:
        Pixels (n, 2) of the points.
    """
    rows = np.array([0.5 * (band.first + band.last - 1) for band in bands])
    # row of each point minus the middle row of each exposed band, px
    ahead = pixels[..., 1] - rows[:, None]
    after = np.maximum(np.argmax(ahead <= 0.0, axis=0), 1)
    after = np.where((ahead > 0.0).all(axis=0), len(bands) - 1, after)
    n = np.arange(pixels.shape[1])
    first, last = ahead[after - 1, n], ahead[after, n]
    share = np.clip(first / (first - last), 0.0, 1.0)[:, None]
    return (1.0 - share) * pixels[after - 1, n] + share * pixels[after, n]
