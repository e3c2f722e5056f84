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
from aras_sim_bridge.camera.shaking import Vibration
from aras_sim_bridge.camera.shutter import RowBand
from aras_sim_bridge.description.types import within
from aras_visual_servo_camera.polygons import find_crossing
from aras_visual_servo_camera.undistortion import CameraModel
from aras_visual_servo_controller.seeing.frame import Frame

from ..asked import cameras
from ..errors import ViewError
from ..targets.geometry import PlacedTarget, Target, project
from .base import CAMERA, Place

NS = 1_000_000_000
OCCLUDED = 128  # grey level of the cover's own drawing from which on it hides
TRIES = 100  # draws of an outline's noise


@dataclass(frozen=True)
class Sight:
    """How a plant without a renderer sees its target.

    What becomes of its images is the affair of `Exposures`: effects and lost frames.

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
    pictures: bool = False
    effects: Effects = Effects()
    seed: int = 0
    encoding: str = "mono8"
    jitter: float = 0.0
    depth: bool = False
    labelled: bool = False
    occluder: tuple[tuple[float, float], tuple[float, float]] | None = None
    occluded: tuple[tuple[float, float], ...] | None = None
    unbounded: bool = False
    name: str = CAMERA
    place: Place | None = None
    parts: tuple[RowBand, ...] = ()
    vibration: Vibration | None = None
    blind: np.ndarray | None = None
    clip: tuple[float, float] | None = None

    @cached_property
    def exposures(self) -> tuple[RowBand, ...]:
        """`parts`, at least one."""
        return self.parts or (RowBand(0, 0, self.camera.height),)

    @cached_property
    def bands(self) -> tuple[Sight, ...]:
        """The same with a camera of the rows of each of `exposures`."""
        return tuple(self.at_rows(part) for part in self.exposures)

    def pipeline(self) -> ImagePipeline:
        """What becomes of its images, from the first one on."""
        shape = (self.camera.height, self.camera.width)
        return ImagePipeline(self.effects, shape, self.seed, self.exposures)

    def at_rows(self, part: RowBand) -> Sight:
        """The same with a camera of these rows alone."""
        if part.last - part.first == self.camera.height:
            return self
        K = np.reshape(self.camera.K, (3, 3)) - [[0, 0, 0], [0, 0, part.first], [0, 0, 0]]
        camera = replace(
            self.camera, height=part.last - part.first, K=tuple(K.ravel().tolist())
        )
        blind = None if self.blind is None else self.blind[part.first : part.last]
        return replace(self, camera=camera, parts=(), blind=blind)

    def exact(self, pose: np.ndarray, stamp_ns: int) -> tuple[np.ndarray, np.ndarray] | None:
        """Outline (n, 2) and points (m, 2), px, at one instant; None: the target is not in view.

        pose: world_T_camera (4, 4) of the control camera at rest.
        """
        seen_from = self.seen_from(pose, stamp_ns)
        try:
            outline = self.target.shape.outline(seen_from)
            points = self.target.shape.points(seen_from)
        except ViewError:
            return None
        in_view = self.unbounded or cameras.in_view(outline, self.camera, 0.0)
        if not in_view or self.clip is not None and self.is_clipped(outline, seen_from):
            return None
        found = self.pixels(outline)
        if self.blind is not None and self.is_blind_at(found):
            return None
        return found, self.pixels(points)

    def is_clipped(self, outline: np.ndarray, seen_from: np.ndarray) -> bool:
        """Whether a point of the outline (n, 2), normalised, is nearer or farther than is seen."""
        if self.clip is None:
            return False
        a, b, c = self.target.shape.plane(seen_from)
        depth = 1.0 / (a * outline[:, 0] + b * outline[:, 1] + c)
        return bool(depth.min() < self.clip[0] or depth.max() > self.clip[1])

    def is_blind_at(self, pixels: np.ndarray) -> bool:
        """Whether the lens shows nothing at one of pixels (n, 2) of the picture."""
        if self.blind is None:
            return False
        last = np.array([self.camera.width, self.camera.height]) - 1
        u, v = np.clip(np.rint(pixels), 0, last).astype(int).T
        return bool(self.blind[v, u].any())

    def draw(self, pose: np.ndarray, stamp_ns: int) -> np.ndarray:
        """The image (rows, columns) uint8 at one instant, before effects; `pose`: as of `exact`."""
        seen_from = self.seen_from(pose, stamp_ns)
        try:
            outline = self.target.shape.outline(seen_from)
        except ViewError:
            outline = None
        if outline is not None and self.is_clipped(outline, seen_from):
            return np.full((self.camera.height, self.camera.width), cameras.WHITE, np.uint8)
        image = self._drawn(outline, seen_from, within(self.occluded, stamp_ns / NS))
        return image if self.blind is None else np.where(self.blind, np.uint8(cameras.DARK), image)

    def jittered(
        self, pixels: np.ndarray | None, random: np.random.Generator, closed: bool = False
    ) -> np.ndarray | None:
        """Pixels (n, 2) with their noise; that of an outline, closed, is drawn anew where edges
        cross, as no picture's do."""
        if pixels is None:
            return None
        for _ in range(TRIES):
            found = pixels + random.normal(0.0, self.jitter, pixels.shape)
            if not closed or find_crossing(found) is None:
                break
        return found

    def seen_from(self, pose: np.ndarray, stamp_ns: int) -> np.ndarray:
        """target_T_camera (4, 4) where the control camera, at rest, is at world_T_camera (4, 4)."""
        at = pose if self.place is None else self.place.at(pose)
        if self.vibration is not None:
            at = at @ self.vibration.at(stamp_ns)
        return self.target.seen_from(at, stamp_ns / NS)

    def pixels(self, points: np.ndarray | None) -> np.ndarray | None:
        """Where normalised points (n, 2) are in the picture, px."""
        return None if points is None else np.column_stack(self.camera.project(*points.T))

    def _drawn(
        self, outline: np.ndarray | None, seen_from: np.ndarray, occluded: bool
    ) -> np.ndarray:
        """The picture (rows, columns) uint8; `occluded`: with what lies on the target."""
        shape, occluder = self.target.shape, self.occluder if occluded else None
        if shape.is_textured or shape.is_solid:
            from ..targets.pictures import seen

            return seen(shape, self.camera, seen_from, occluder)
        image = cameras.draw(outline, self.camera)
        if outline is not None and occluder is not None:
            (x0, y0), (x1, y1) = occluder
            corners = np.array([(x, y, shape.height) for x, y in (
                (x0, y0), (x1, y0), (x1, y1), (x0, y1))])  # fmt: skip
            with contextlib.suppress(ViewError):
                covered = cameras.draw(project(corners, seen_from), self.camera)
                image = np.where(covered < OCCLUDED, np.uint8(cameras.WHITE), image)
        return image

    def label(self, pose: np.ndarray, stamp_ns: int) -> np.ndarray | None:
        """(rows, columns) 255 where a solid target is, at one instant; None of a flat black one,
        which is where the image without effects is dark. `pose`: as of `exact`."""
        if not self.target.shape.is_solid:
            return None
        from ..targets.pictures import shows

        return shows(self.target.shape, self.camera, self.seen_from(pose, stamp_ns))

    def depth_image(self, pose: np.ndarray, stamp_ns: int) -> np.ndarray:
        """(rows, columns) m of the plane that the target lies in; inf where it is not before.
        `pose`: as of `exact`."""
        a, b, c = self.target.shape.plane(self.seen_from(pose, stamp_ns))
        u, v = np.meshgrid(np.arange(self.camera.width), np.arange(self.camera.height))
        x, y, valid = self.camera.normalise(u.ravel(), v.ravel())
        nearness = a * x + b * y + c
        depth = np.full(nearness.shape, np.inf, np.float32)
        before = valid & (nearness > 0.0)
        depth[before] = 1.0 / nearness[before]
        return depth.reshape(self.camera.height, self.camera.width)


def capture(
    camera: Sight,
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
    parts = camera.exposures
    poses = [world_T_camera] * len(parts) if np.ndim(world_T_camera) == 2 else world_T_camera
    random = np.random.default_rng(0) if random is None else random
    if camera.pictures or len(parts) > 1:
        pipeline = camera.pipeline() if pipeline is None else pipeline
        if camera.pictures:
            return _image(camera, poses, stamp_ns, pipeline)
        found = _shuttered(camera, poses, stamp_ns, pipeline.middle)
    else:
        found = camera.exact(poses[0], stamp_ns)
    if found is None:
        return Frame(stamp_ns, name=camera.name, camera=camera.camera)
    outline, points = found
    if camera.jitter:
        outline = camera.jittered(outline, random, closed=True)
        points = camera.jittered(points, random)
    return Frame(stamp_ns, outline=outline, points=points, name=camera.name, jitter=camera.jitter,
                 camera=camera.camera)  # fmt: skip


def _image(
    sight: Sight, poses: Sequence[np.ndarray], stamp_ns: int, pipeline: ImagePipeline
) -> Frame:
    """The drawn image, after the effects of the sensor."""
    labels = ExposureMean(sight.exposures, sight.camera.height)
    is_solid = False
    for index, (band, pose) in enumerate(zip(sight.bands, poses, strict=True)):
        ns = stamp_ns + sight.exposures[index].offset_ns
        pipeline.light.add(index, band.draw(pose, ns))
        if sight.labelled and (label := band.label(pose, ns)) is not None:
            labels.add(index, label)
            is_solid = True
    light = pipeline.light.take()
    labelled = depth = None
    if sight.labelled:
        # Of a solid where it is for the greater part of the exposure.
        found = labels.take() >= OCCLUDED if is_solid else light < OCCLUDED
        labelled = found.view(np.uint8) * 255
    if sight.depth:
        depth = sight.depth_image(poses[pipeline.middle], stamp_ns)
    image = formats.widened(pipeline.read_out(light, stamp_ns), sight.encoding)
    return Frame(stamp_ns, image, sight.encoding, depth, name=sight.name, labelled=labelled,
                 camera=sight.camera)  # fmt: skip


def _shuttered(
    sight: Sight, poses: Sequence[np.ndarray], stamp_ns: int, middle: int
) -> tuple[np.ndarray, np.ndarray | None] | None:
    """As `Sight.exact`, of an image whose rows are exposed one after the other."""
    parts, shape = sight.exposures, sight.target.shape
    looks = [sight.seen_from(pose, stamp_ns + part.offset_ns)
             for pose, part in zip(poses, parts, strict=True)]  # fmt: skip
    try:
        outlines = _outlines(shape, looks, middle)
        places = [shape.points(look) for look in looks]
    except ViewError:
        return None
    outline = _in_own_rows(np.array([sight.pixels(one) for one in outlines]), parts)
    last = np.array([sight.camera.width, sight.camera.height]) - 1
    if not sight.unbounded and not ((outline >= 0.0) & (outline <= last)).all():
        return None
    seen = shape.outline(looks[middle])
    if sight.is_blind_at(outline) or sight.is_clipped(seen, looks[middle]):
        return None
    if places[0] is None:
        return outline, None
    return outline, _in_own_rows(np.array([sight.pixels(one) for one in places]), parts)


class Exposures:
    """The images of one camera: when it exposes, and what it sees then.

    Poses are those of the control camera at rest: a `Sight` knows how its camera shakes.

    Attributes:
        due_ns: simulated time at which it has to be asked next: of an exposure, or of its part.
    """

    def __init__(self, sight: Sight, random: np.random.Generator, first: int = 1) -> None:
        """`random`: draws the jitter of exact points. `first`: period with the first image."""
        self._sight, self._random, self._count = sight, random, first
        self._period = NS / sight.rate
        self._pipeline = sight.pipeline()
        self._poses: list[np.ndarray] = []
        self._stamp_ns = round(self._count * self._period)
        self.due_ns = self._stamp_ns + sight.exposures[0].offset_ns

    def expose(self, pose: np.ndarray) -> Frame | None:
        """Where the control camera is at world_T_camera (4, 4); None: the image is lost, or not
        whole yet."""
        stamp_ns, poses, parts = self._stamp_ns, [*self._poses, pose], self._sight.exposures
        is_whole = len(poses) == len(parts)
        self._poses, self._count = [] if is_whole else poses, self._count + is_whole
        self._stamp_ns = round(self._count * self._period)
        self.due_ns = self._stamp_ns + parts[len(self._poses)].offset_ns
        if not is_whole or self._pipeline.is_lost(stamp_ns):
            return None
        return capture(self._sight, poses, stamp_ns, self._random, self._pipeline)


def exposures(
    sight: Sight, others: Sequence[Sight], random: np.random.Generator, seed: int
) -> list[Exposures]:
    """Those of the control camera, whose jitter `random` draws, and of the other cameras."""
    # From 1 on: (seed, 0) draws as `seed` alone does, which is the control camera's.
    return [Exposures(sight, random)] + [
        Exposures(other, np.random.default_rng((seed, i))) for i, other in enumerate(others, 1)
    ]


def vibrations(*sights: Sight) -> dict[str, Vibration]:
    """Of those that shake, by the names of their cameras."""
    return {sight.name: sight.vibration for sight in sights if sight.vibration is not None}


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
