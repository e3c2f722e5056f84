"""How a plant without a renderer sees its target: exact features, or drawn images."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from aras_sim_bridge.camera import formats
from aras_sim_bridge.camera.effects import Effects
from aras_sim_bridge.camera.pipeline import ExposureMean, ImagePipeline
from aras_sim_bridge.camera.shutter import RowBand
from aras_sim_bridge.camera.vibration import Vibration
from aras_sim_bridge.description.types import is_present
from aras_visual_servo_camera.polygons import find_crossing
from aras_visual_servo_camera.undistortion import CameraModel
from aras_visual_servo_controller.observation.frame import Frame

from ..errors import ViewError
from ..experiment import cameras
from ..targets.geometry import PlacedTarget, Target, project
from .base import CAMERA, CameraPlacement

NS = 1_000_000_000
OCCLUSION_LEVEL = 128  # grey level of the cover's own drawing from which on it hides
MAX_TRIES = 100  # draws of an outline's noise


@dataclass(frozen=True)
class ImagingSettings:
    """How a plant without a renderer sees its target.

    What becomes of its images is the affair of `ExposureSchedule`: effects and lost frames.

    camera: the true one. target: in the world. rate: pictures a second.
    pictures: draw them; otherwise outlines and corners are exact.
    effects: of the camera; on exact features those of light do nothing. seed: of their chance.
    encoding: of drawn images, which are grey: mono8, mono16 or a Bayer pattern.
    jitter: standard deviation of exact points, px.
    depth: deliver a depth image too. labelled: and which pixels are the target's.
    occluder: corners (x, y), m, of a white rectangle on the target. occluded: from when and until
        when it lies there, s; None: always.
    unbounded: exact features have no picture's border, and are lost behind the camera alone.
    name: of the camera. place: of another camera than the control camera.
    parts: the exposures of an image, in the order of time; empty: all of it at the stamp.
    vibration: how it shakes about its place; None: it does not.
    blind: (rows, columns) where its lens shows nothing; None: nowhere.
    clip: least and greatest depth, m, at which the whole target is seen; None: there are none.
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
        """`parts`, at least one."""
        return self.row_bands or (RowBand(0, 0, self.camera.height),)

    @cached_property
    def band_settings(self) -> tuple[ImagingSettings, ...]:
        """The same with a camera of the rows of each of `exposures`."""
        return tuple(self.crop_rows(part) for part in self.exposure_bands)

    def make_pipeline(self) -> ImagePipeline:
        """What becomes of its images, from the first one on."""
        shape = (self.camera.height, self.camera.width)
        return ImagePipeline(self.effects, shape, self.seed, self.exposure_bands)

    def crop_rows(self, band: RowBand) -> ImagingSettings:
        """The same with a camera of these rows alone."""
        if band.last - band.first == self.camera.height:
            return self
        K = np.reshape(self.camera.K, (3, 3)) - [[0, 0, 0], [0, 0, band.first], [0, 0, 0]]
        camera = replace(
            self.camera, height=band.last - band.first, K=tuple(K.ravel().tolist())
        )
        blind = None if self.blind_mask is None else self.blind_mask[band.first : band.last]
        return replace(self, camera=camera, row_bands=(), blind_mask=blind)

    def compute_exact_features(
        self, pose: np.ndarray, stamp_ns: int
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Outline (n, 2) and points (m, 2), px, at one instant; None: the target is not in view.

        pose: world_T_camera (4, 4) of the control camera at rest.
        """
        seen_from = self.target_T_camera(pose, stamp_ns)
        try:
            outline = self.target.shape.outline(seen_from)
            points = self.target.shape.points(seen_from)
        except ViewError:
            return None
        in_view = self.is_unbounded or cameras.is_in_view(outline, self.camera, 0.0)
        if not in_view or self.depth_range is not None and self.is_clipped(outline, seen_from):
            return None
        found = self.to_pixels(outline)
        if self.blind_mask is not None and self.is_blind_at(found):
            return None
        return found, self.to_pixels(points)

    def is_clipped(self, outline: np.ndarray, target_T_camera: np.ndarray) -> bool:
        """Whether a point of the outline (n, 2), normalised, is nearer or farther than is seen."""
        if self.depth_range is None:
            return False
        a, b, c = self.target.shape.plane(target_T_camera)
        depth = 1.0 / (a * outline[:, 0] + b * outline[:, 1] + c)
        return bool(depth.min() < self.depth_range[0] or depth.max() > self.depth_range[1])

    def is_blind_at(self, pixels: np.ndarray) -> bool:
        """Whether the lens shows nothing at one of pixels (n, 2) of the picture."""
        if self.blind_mask is None:
            return False
        last = np.array([self.camera.width, self.camera.height]) - 1
        u, v = np.clip(np.rint(pixels), 0, last).astype(int).T
        return bool(self.blind_mask[v, u].any())

    def draw_image(self, pose: np.ndarray, stamp_ns: int) -> np.ndarray:
        """The image (rows, columns) uint8 at one instant, before effects; `pose`: as of
        `compute_exact_features`.
        """
        seen_from = self.target_T_camera(pose, stamp_ns)
        try:
            outline = self.target.shape.outline(seen_from)
        except ViewError:
            outline = None
        if outline is not None and self.is_clipped(outline, seen_from):
            return np.full((self.camera.height, self.camera.width), cameras.WHITE_LEVEL, np.uint8)
        image = self._draw_outline(
            outline, seen_from, is_present(self.occlusion_times, stamp_ns / NS)
        )
        return (
            image
            if self.blind_mask is None
            else np.where(self.blind_mask, np.uint8(cameras.DARK_LEVEL), image)
        )

    def add_jitter(
        self, pixels: np.ndarray | None, random: np.random.Generator, is_closed: bool = False
    ) -> np.ndarray | None:
        """Pixels (n, 2) with their noise; that of an outline, closed, is drawn anew where edges
        cross, as no picture's do."""
        if pixels is None:
            return None
        for _ in range(MAX_TRIES):
            found = pixels + random.normal(0.0, self.jitter, pixels.shape)
            if not is_closed or find_crossing(found) is None:
                break
        return found

    def target_T_camera(self, pose: np.ndarray, stamp_ns: int) -> np.ndarray:
        """target_T_camera (4, 4) where the control camera, at rest, is at world_T_camera (4, 4)."""
        at = pose if self.placement is None else self.placement.compute_pose(pose)
        if self.vibration is not None:
            at = at @ self.vibration.compute_pose(stamp_ns)
        return self.target.target_T_camera(at, stamp_ns / NS)

    def to_pixels(self, points: np.ndarray | None) -> np.ndarray | None:
        """Where normalised points (n, 2) are in the picture, px."""
        return None if points is None else np.column_stack(self.camera.project(*points.T))

    def _draw_outline(
        self, outline: np.ndarray | None, target_T_camera: np.ndarray, is_occluded: bool
    ) -> np.ndarray:
        """The picture (rows, columns) uint8; `occluded`: with what lies on the target."""
        shape, occluder = self.target.shape, self.occluder if is_occluded else None
        if shape.is_textured or shape.is_solid:
            from ..targets.rendering import render_target

            return render_target(shape, self.camera, target_T_camera, occluder)
        image = cameras.draw_outline(outline, self.camera)
        if outline is not None and occluder is not None:
            (x0, y0), (x1, y1) = occluder
            corners = np.array([(x, y, shape.height) for x, y in (
                (x0, y0), (x1, y0), (x1, y1), (x0, y1))])  # fmt: skip
            with contextlib.suppress(ViewError):
                covered = cameras.draw_outline(project(corners, target_T_camera), self.camera)
                image = np.where(covered < OCCLUSION_LEVEL, np.uint8(cameras.WHITE_LEVEL), image)
        return image

    def draw_labels(self, pose: np.ndarray, stamp_ns: int) -> np.ndarray | None:
        """(rows, columns) 255 where a solid target is, at one instant; None of a flat black one,
        which is where the image without effects is dark. `pose`: as of `compute_exact_features`."""
        if not self.target.shape.is_solid:
            return None
        from ..targets.rendering import render_mask

        return render_mask(self.target.shape, self.camera, self.target_T_camera(pose, stamp_ns))

    def draw_depth_image(self, pose: np.ndarray, stamp_ns: int) -> np.ndarray:
        """(rows, columns) m of the plane that the target lies in; inf where it is not before.
        `pose`: as of `compute_exact_features`."""
        a, b, c = self.target.shape.plane(self.target_T_camera(pose, stamp_ns))
        u, v = np.meshgrid(np.arange(self.camera.width), np.arange(self.camera.height))
        x, y, valid = self.camera.normalise(u.ravel(), v.ravel())
        nearness = a * x + b * y + c
        depth = np.full(nearness.shape, np.inf, np.float32)
        before = valid & (nearness > 0.0)
        depth[before] = 1.0 / nearness[before]
        return depth.reshape(self.camera.height, self.camera.width)


def capture(
    imaging: ImagingSettings,
    world_T_camera: np.ndarray | Sequence[np.ndarray],
    stamp_ns: int = 0,
    random: np.random.Generator | None = None,
    pipeline: ImagePipeline | None = None,
) -> Frame:
    """Image or exact features of the target that a camera delivers.

    Args:
        camera: the true one, with the target in the world.
        world_T_camera: (4, 4) of the control camera at rest; of an image with several exposures
            one for each.
        stamp_ns: of the exposure, ns.
        random: draws the noise of exact features; None: from seed 0.
        pipeline: sensor effects, which follow the earlier images; None: this is the first one.

    Returns:
        The frame; without features where the target is not in view.
    """
    parts = imaging.exposure_bands
    poses = [world_T_camera] * len(parts) if np.ndim(world_T_camera) == 2 else world_T_camera
    random = np.random.default_rng(0) if random is None else random
    if imaging.has_images or len(parts) > 1:
        pipeline = imaging.make_pipeline() if pipeline is None else pipeline
        if imaging.has_images:
            return _draw_image(imaging, poses, stamp_ns, pipeline)
        found = _project_rolling_shutter(imaging, poses, stamp_ns, pipeline.middle_part)
    else:
        found = imaging.compute_exact_features(poses[0], stamp_ns)
    if found is None:
        return Frame(stamp_ns, name=imaging.name, camera=imaging.camera)
    outline, points = found
    if imaging.jitter:
        outline = imaging.add_jitter(outline, random, is_closed=True)
        points = imaging.add_jitter(points, random)
    return Frame(stamp_ns, outline=outline, points=points, name=imaging.name, jitter=imaging.jitter,
                 camera=imaging.camera)  # fmt: skip


def _draw_image(
    imaging: ImagingSettings, poses: Sequence[np.ndarray], stamp_ns: int, pipeline: ImagePipeline
) -> Frame:
    """The drawn image, after the effects of the sensor."""
    labels = ExposureMean(imaging.exposure_bands, imaging.camera.height)
    is_solid = False
    for index, (band, pose) in enumerate(zip(imaging.band_settings, poses, strict=True)):
        ns = stamp_ns + imaging.exposure_bands[index].offset_ns
        pipeline.exposure.add(index, band.draw_image(pose, ns))
        if imaging.has_labels and (label := band.draw_labels(pose, ns)) is not None:
            labels.add(index, label)
            is_solid = True
    light = pipeline.exposure.take()
    labelled = depth = None
    if imaging.has_labels:
        # Of a solid where it is for the greater part of the exposure.
        found = labels.take() >= OCCLUSION_LEVEL if is_solid else light < OCCLUSION_LEVEL
        labelled = found.view(np.uint8) * 255
    if imaging.has_depth:
        depth = imaging.draw_depth_image(poses[pipeline.middle_part], stamp_ns)
    image = formats.widen(pipeline.read_out(light, stamp_ns), imaging.encoding)
    return Frame(stamp_ns, image, imaging.encoding, depth, name=imaging.name, target_mask=labelled,
                 camera=imaging.camera)  # fmt: skip


def _project_rolling_shutter(
    imaging: ImagingSettings, poses: Sequence[np.ndarray], stamp_ns: int, middle: int
) -> tuple[np.ndarray, np.ndarray | None] | None:
    """As `ImagingSettings.compute_exact_features`, of an image whose rows are exposed one after the
    other.
    """
    parts, shape = imaging.exposure_bands, imaging.target.shape
    looks = [imaging.target_T_camera(pose, stamp_ns + part.offset_ns)
             for pose, part in zip(poses, parts, strict=True)]  # fmt: skip
    try:
        outlines = _project_outlines(shape, looks, middle)
        places = [shape.points(look) for look in looks]
    except ViewError:
        return None
    outline = _interpolate_rolling_shutter(
        np.array([imaging.to_pixels(one) for one in outlines]), parts
    )
    last = np.array([imaging.camera.width, imaging.camera.height]) - 1
    if not imaging.is_unbounded and not ((outline >= 0.0) & (outline <= last)).all():
        return None
    seen = shape.outline(looks[middle])
    if imaging.is_blind_at(outline) or imaging.is_clipped(seen, looks[middle]):
        return None
    if places[0] is None:
        return outline, None
    return outline, _interpolate_rolling_shutter(
        np.array([imaging.to_pixels(one) for one in places]), parts
    )


class ExposureSchedule:
    """The images of one camera: when it exposes, and what it sees then.

    Poses are those of the control camera at rest: a `ImagingSettings` knows how its camera shakes.

    Attributes:
        due_ns: simulated time at which it has to be asked next: of an exposure, or of its part.
    """

    def __init__(
        self, imaging: ImagingSettings, random: np.random.Generator, first: int = 1
    ) -> None:
        """`random`: draws the jitter of exact points. `first`: period with the first image."""
        self._imaging, self._random, self._count = imaging, random, first
        self._period = NS / imaging.rate
        self._pipeline = imaging.make_pipeline()
        self._poses: list[np.ndarray] = []
        self._stamp_ns = round(self._count * self._period)
        self.due_ns = self._stamp_ns + imaging.exposure_bands[0].offset_ns

    def expose(self, pose: np.ndarray) -> Frame | None:
        """Where the control camera is at world_T_camera (4, 4); None: the image is lost, or not
        whole yet."""
        stamp_ns, poses, parts = self._stamp_ns, [*self._poses, pose], self._imaging.exposure_bands
        is_whole = len(poses) == len(parts)
        self._poses, self._count = [] if is_whole else poses, self._count + is_whole
        self._stamp_ns = round(self._count * self._period)
        self.due_ns = self._stamp_ns + parts[len(self._poses)].offset_ns
        if not is_whole or self._pipeline.is_lost(stamp_ns):
            return None
        return capture(self._imaging, poses, stamp_ns, self._random, self._pipeline)


def make_exposure_schedules(
    imaging: ImagingSettings,
    other_imaging: Sequence[ImagingSettings],
    random: np.random.Generator,
    seed: int,
) -> list[ExposureSchedule]:
    """Those of the control camera, whose jitter `random` draws, and of the other cameras."""
    # From 1 on: (seed, 0) draws as `seed` alone does, which is the control camera's.
    return [ExposureSchedule(imaging, random)] + [
        ExposureSchedule(other, np.random.default_rng((seed, i)))
        for i, other in enumerate(other_imaging, 1)
    ]


def collect_vibrations(*sights: ImagingSettings) -> dict[str, Vibration]:
    """Of those that shake, by the names of their cameras."""
    return {sight.name: sight.vibration for sight in sights if sight.vibration is not None}


def _project_outlines(
    shape: Target, poses: Sequence[np.ndarray], middle: int
) -> list[np.ndarray]:
    """Where the corners (n, 2) of the outline seen at one of target_T_camera (4, 4) are at each,
    normalised: as if they lay in the target's plane, for an outline may have others meanwhile.

    Raises:
        ViewError: it is behind the camera.
    """
    x, y = shape.outline(poses[middle]).T
    A, B, C = shape.plane(poses[middle])
    places = np.column_stack([x, y, np.ones_like(x)]) / (A * x + B * y + C)[:, None]
    in_target = places @ poses[middle][:3, :3].T + poses[middle][:3, 3]
    return [project(in_target, look) for look in poses]


def _interpolate_rolling_shutter(pixels: np.ndarray, bands: Sequence[RowBand]) -> np.ndarray:
    """Pixels (n, 2) where points were when their own rows were exposed.

    pixels: (parts, n, 2), px, of a camera that stands still at each part. Between two parts a point
    moves evenly; what lies above or below the picture is of its first or last rows.
    """
    rows = np.array([0.5 * (part.first + part.last - 1) for part in bands])
    ahead = pixels[..., 1] - rows[:, None]  # rows that the shutter still has to go
    after = np.maximum(np.argmax(ahead <= 0.0, axis=0), 1)
    after = np.where((ahead > 0.0).all(axis=0), len(bands) - 1, after)
    n = np.arange(pixels.shape[1])
    first, last = ahead[after - 1, n], ahead[after, n]
    share = np.clip(first / (first - last), 0.0, 1.0)[:, None]
    return (1.0 - share) * pixels[after - 1, n] + share * pixels[after, n]
