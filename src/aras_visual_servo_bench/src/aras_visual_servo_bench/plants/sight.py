"""How a plant without a simulated world sees its target."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

import numpy as np

from aras_sim_bridge.camera.effects import EffectChain
from aras_sim_bridge.camera.shaking import Vibration
from aras_sim_bridge.camera.shutter import RowBand
from aras_sim_bridge.description.types import within
from aras_visual_servo_camera.moments import find_crossing
from aras_visual_servo_camera.undistortion import CameraModel

from ..asked import cameras
from ..errors import ViewError
from ..targets.geometry import PlacedTarget, project
from ..targets.pictures import seen, shows
from ..targets.solids import SolidTarget
from ..targets.textures import TexturedTarget
from .base import CAMERA, CameraReading, Place

NS = 1_000_000_000
OCCLUDED = 128  # grey level of the cover's own drawing from which on it hides
TRIES = 100  # draws of an outline's noise


@dataclass(frozen=True)
class Sight:
    """How a plant without a simulated world sees its target.

    camera: the true one. target: in the world. rate: pictures a second.
    pictures: draw them; otherwise outlines and corners are exact.
    grey_noise: standard deviation of drawn pixels, grey levels. jitter: of exact points, px.
    depth: deliver a depth image too. labelled: and which pixels are the target's.
    drop: probability that an image is lost.
    occluder: corners (x, y), m, of a white rectangle on the target. occluded: from when and until
        when it lies there, s; None: always.
    unbounded: exact features have no picture's border, and are lost behind the camera alone.
    name: of the camera. place: of another camera than the control camera.
    parts: rows that are exposed one after the other; empty: all at once.
    sensor: adds a calibrated sensor's noise to drawn pictures; None: there is none.
    vibration: how it shakes about its place; None: it does not.
    """

    camera: CameraModel
    target: PlacedTarget
    rate: float = 30.0
    pictures: bool = False
    grey_noise: float = 0.0
    jitter: float = 0.0
    depth: bool = False
    labelled: bool = False
    drop: float = 0.0
    occluder: tuple[tuple[float, float], tuple[float, float]] | None = None
    occluded: tuple[tuple[float, float], ...] | None = None
    unbounded: bool = False
    name: str = CAMERA
    place: Place | None = None
    parts: tuple[RowBand, ...] = ()
    sensor: EffectChain | None = None
    vibration: Vibration | None = None

    def look(self, pose: np.ndarray, stamp_ns: int, random: np.random.Generator) -> CameraReading:
        """What the camera sees where the control camera, at rest, is at world_T_camera (4, 4)."""
        seen_from = self.seen_from(pose, stamp_ns)
        try:
            outline = self.target.shape.outline(seen_from)
            points = self.target.shape.points(seen_from)
        except ViewError:
            outline = points = None
        if not self.pictures:
            if outline is None or not (
                self.unbounded or cameras.in_view(outline, self.camera, 0.0)
            ):
                return CameraReading(stamp_ns, camera=self.name)
            return CameraReading(
                stamp_ns,
                outline=self.jittered(self.pixels(outline), random, closed=True),
                points=self.jittered(self.pixels(points), random),
                camera=self.name, jitter=self.jitter,
            )
        drawn = self._drawn(outline, seen_from, within(self.occluded, stamp_ns / NS))
        image = self.noisy(drawn, stamp_ns, random)
        depth = self._depth(seen_from) if self.depth else None
        labelled = None
        if self.labelled:
            labelled = self._labelled(drawn, seen_from)
        return CameraReading(
            stamp_ns, image, "mono8", depth, camera=self.name, labelled=labelled
        )

    def noisy(
        self, image: np.ndarray, stamp_ns: int, random: np.random.Generator
    ) -> np.ndarray:
        """A drawn picture (rows, columns) uint8 with its noise."""
        if self.sensor is not None:
            image = self.sensor.apply(image, stamp_ns)
        if self.grey_noise:
            noise = image + random.normal(0.0, self.grey_noise, image.shape)
            image = np.clip(np.round(noise), 0, 255).astype(np.uint8)
        return image

    def jittered(
        self, pixels: np.ndarray | None, random: np.random.Generator, closed: bool = False
    ) -> np.ndarray | None:
        """Pixels (n, 2) with their noise; that of an outline, closed, is drawn anew where edges
        cross, as no picture's do."""
        if pixels is None or not self.jitter:
            return pixels
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
        if isinstance(shape, TexturedTarget | SolidTarget):
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

    def _labelled(self, drawn: np.ndarray, seen_from: np.ndarray) -> np.ndarray:
        """(rows, columns) 255 where the target is; of a flat black one, where the picture
        without noise is dark."""
        shape = self.target.shape
        if isinstance(shape, SolidTarget):
            return shows(shape, self.camera, seen_from)
        return (drawn < OCCLUDED).view(np.uint8) * 255

    def _depth(self, target_T_camera: np.ndarray) -> np.ndarray:
        """(rows, columns) m of the plane that the target lies in; inf where it is not before."""
        a, b, c = self.target.shape.plane(target_T_camera)
        u, v = np.meshgrid(np.arange(self.camera.width), np.arange(self.camera.height))
        x, y, valid = self.camera.normalise(u.ravel(), v.ravel())
        nearness = a * x + b * y + c
        depth = np.full(nearness.shape, np.inf, np.float32)
        before = valid & (nearness > 0.0)
        depth[before] = 1.0 / nearness[before]
        return depth.reshape(self.camera.height, self.camera.width)
