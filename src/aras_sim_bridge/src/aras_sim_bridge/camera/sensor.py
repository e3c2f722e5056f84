"""A camera as a sensor: when it exposes, what it draws, and when it delivers."""

from __future__ import annotations

import logging
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from aras_visual_servo_base.poses import Pose, optical

from ..blending import blended
from ..errors import CameraError, RenderingError
from ..rendering import View
from ..rendering.tiles import Tiles, shared
from . import formats
from .config import CameraConfig
from .intrinsics import CameraIntrinsics
from .pipeline import ImagePipeline
from .shaking import Vibration
from .shutter import duration, parts

if TYPE_CHECKING:
    from ..rendering.renderer import Renderer

_log = logging.getLogger(__name__)
NEVER = (1 << 63) - 1  # ns: when a camera exposes that waits for its trigger


@dataclass(frozen=True)
class SensorFrame:
    """One picture.

    stamp_ns: middle of the exposure on the simulated clock; encoding as ROS names it.
    depth: (H, W) float32 m as Renderer.measure has it, inf where nothing is, or None.
    segmentation: (H, W) int32, body id + (link index + 1) << 24, -1 where nothing is, or None.
    Both are of the stamp's instant (with motion blur, of the partial exposure nearest to it).
    """

    stamp_ns: int
    image: np.ndarray
    encoding: str
    depth: np.ndarray | None = None
    segmentation: np.ndarray | None = None


class CameraSensor:
    """Exposes at k / update_rate s of simulated time, k = 1, 2, ...

    These instants rarely fall on physics ticks. A picture is drawn on the first tick at or after
    its instant, with all poses blended between that tick and the one before, so it shows the
    world as it was at the stamp, and stamps are exact multiples of the period. In a step that
    ends at time t, the simulation calls

        if sensor.needs_before(t): sensor.before_step(world_T_link, t - dt)   # before Bullet
        ...
        if sensor.due(t): frame = sensor.capture(world_T_link, t)             # after Bullet

    Without the first two lines pictures are taken at the tick itself. A camera with a trigger
    exposes once for each call of `trigger` instead, at the first tick after it.

    vibration: of a camera that shakes, from which its pictures are drawn; None: it sits still.
    """

    def __init__(self, config: CameraConfig, renderer: Renderer) -> None:
        """Raises CameraError for a camera whose pictures cannot be drawn."""
        self.config = config
        self.renderer = renderer
        self.info: CameraIntrinsics = config.intrinsics()
        self._link_T_optical = mounting(config.xyz, config.rpy)
        self._parts = parts(config.effects, config.height)
        try:
            self._whole = self._pixels(0, config.height)
            self._bands = {part.first: self._pixels(part.first, part.last)
                           for part in self._parts}  # fmt: skip
            renderer.prepare(self.view(np.eye(4)))
        except (RenderingError, MemoryError) as error:
            reason = str(error) or "not enough memory; make width and height smaller"
            raise CameraError(f"camera '{config.name}': {reason}") from None
        shape = formats.shape_of(config.encoding, config.height, config.width)
        self._pipeline = ImagePipeline(config.effects, shape, config.seed, self._parts)
        self.vibration = None if config.shake is None else Vibration(config.shake, config.seed)
        self._rate = config.update_rate
        self._latency_ns = round(config.latency * 1e9)
        self._first, self._told_black, self._told_missed = True, False, False
        # Whether pictures carry them now; who offers them may switch off what nobody reads.
        self.depth, self.segmentation = config.depth, config.segmentation
        self.reset()

    @property
    def rate(self) -> float:
        """Frames a second of simulated time."""
        return self._rate

    @property
    def link_T_optical(self) -> np.ndarray:
        """(4, 4) mounting pose of the optical frame."""
        return self._link_T_optical.copy()

    def rays(self) -> np.ndarray:
        """(H, W, 3) float32, of each pixel: a depth times its ray is the point that it shows, in
        the optical frame; NaN where the lens shows nothing."""
        c = self.config
        pixels = np.stack(np.meshgrid(np.arange(c.width), np.arange(c.height)), axis=2)
        rays = c.model.unproject(pixels.reshape(-1, 2)).reshape(c.height, c.width, 3)
        lens = self._whole[2]
        if lens is None or lens.forward:
            rays = rays / rays[..., 2:]
        return rays.astype(np.float32)

    def view(
        self, world_T_link: np.ndarray, pixels: tuple[int, np.ndarray, Tiles | None] | None = None,
        shaken: np.ndarray | None = None,
    ) -> View:
        """What the camera sees from a pose (4, 4) of its link, as the renderer takes it.

        pixels: of some rows, their number, camera matrix (3, 3) and lens; None: of all.
        shaken: (4, 4), by which the optical frame is off its mounting.
        """
        c, (rows, K, lens) = self.config, pixels or self._whole
        world_T_optical = world_T_link @ self._link_T_optical
        if shaken is not None:
            world_T_optical = world_T_optical @ shaken
        return View(c.width, rows, world_T_optical, K, c.near, c.far, lens)

    def check_time_step(self, step_ns: int, rate: float | None = None) -> None:
        """Raise CameraError if the camera, at its own rate or at `rate` Hz, outruns the physics."""
        rate = self._rate if rate is None else rate
        if round(1e9 / rate) < step_ns:
            raise CameraError(
                f"camera '{self.config.name}': update_rate {rate:g} Hz is above the physics "
                f"rate of {1e9 / step_ns:g} Hz; lower the one or raise the other"
            )

    def set_rate(self, rate: float, time_ns: int, step_ns: int) -> None:
        """Change the rate, Hz; the next picture is at the first multiple of the new period after
        `time_ns`. Frames that wait for their publication still come. step_ns: the physics step.

        Raises CameraError for a rate that is not above 0, above that of the physics, or that
        leaves no time for the exposure; nothing is changed then.
        """
        if not (np.isfinite(rate) and rate > 0.0):
            raise CameraError(f"camera '{self.config.name}': rate {rate} Hz: give one above 0")
        self.check_time_step(step_ns, rate)
        self.config.check_rate(rate)
        self._rate = float(rate)
        under_way = self._waiting
        self._restart(time_ns, exposure=False)
        self._waiting = under_way

    def trigger(self, time_ns: int, step_ns: int) -> None:
        """Expose once more, in the step of `step_ns` from `time_ns` on, or after the exposures
        that were asked for before; without effect on a camera that streams."""
        if not self.config.trigger_topic:
            return
        stamp = time_ns + step_ns - self._parts[0].offset_ns
        if self._triggered:
            taken_ns = round(duration(self.config.effects, self.config.height) * 1e9)
            stamp = max(stamp, self._triggered[-1] + max(step_ns, taken_ns))
        self._triggered.append(stamp)
        self._plan()

    def reset(self, time_ns: int = 0) -> None:
        """Start anew: the next picture is the first whose exposure begins after time_ns.

        Call it when the clock jumps back, and when pictures are wanted again after a pause.
        """
        self._restart(time_ns, exposure=True)

    def _restart(self, time_ns: int, exposure: bool) -> None:
        """`reset`; `exposure`: the auto exposure starts again too."""
        self._triggered: deque[int] = deque()
        self._index = int(time_ns * self._rate / 1e9)
        while self._instant(self._index) + self._parts[0].offset_ns <= time_ns:
            self._index += 1
        self._before: tuple[int, np.ndarray] | None = None
        self._waiting: deque[tuple[int, SensorFrame]] = deque()
        self._pipeline.reset(exposure)
        self._measured: tuple[np.ndarray, np.ndarray] | None = None
        self._part = 0
        self._plan()

    def _instant(self, index: int) -> int:
        if self.config.trigger_topic:
            return self._triggered[0] if self._triggered else NEVER
        return round(index * 1e9 / self._rate)

    def _plan(self) -> None:
        """Set the instant of the next picture: the frame's, or one of its partial exposures."""
        self._next_ns = self._instant(self._index) + self._parts[self._part].offset_ns

    def needs_before(self, time_after_ns: int) -> bool:
        """Whether a picture falls inside the step that ends at `time_after_ns`."""
        return self._next_ns < time_after_ns

    def before_step(self, world_T_link: np.ndarray, time_ns: int) -> None:
        """Remember the state at `time_ns`, before the step for which `needs_before` was true."""
        self.renderer.snapshot()
        self._before = (time_ns, np.array(world_T_link, dtype=float))

    @property
    def due_ns(self) -> int:
        """Simulated time from which on `capture` has something to do, ns."""
        return min(self._next_ns, self._waiting[0][0]) if self._waiting else self._next_ns

    def due(self, time_ns: int) -> bool:
        """Whether `capture` has something to do at this tick."""
        return self.due_ns <= time_ns

    def capture(self, world_T_link: np.ndarray, time_ns: int) -> SensorFrame | None:
        """Draw what is due, and give the frame whose time of publication has come, if any.

        world_T_link: (4, 4) pose of the camera's link at `time_ns`.
        """
        while self._next_ns <= time_ns:
            self._skip_missed(time_ns)
            self._expose(np.asarray(world_T_link, dtype=float), time_ns)
        if self._waiting and self._waiting[0][0] <= time_ns:
            return self._waiting.popleft()[1]
        return None

    def _skip_missed(self, time_ns: int) -> None:
        """Where one physics step spans several instants, only the newest is drawn."""
        if self.config.trigger_topic:
            return
        if self._part == 0 and self._instant(self._index + 1) <= time_ns:
            if not self._told_missed:
                self._told_missed = True
                _log.warning("camera '%s' leaves out frames: its %g Hz are above the physics rate; "
                             "lower the one or raise the other", self.config.name, self._rate)
            self._index = int(time_ns * self._rate / 1e9)
            if self._instant(self._index + 1) <= time_ns:
                self._index += 1
            self._plan()

    def _expose(self, pose: np.ndarray, time_ns: int) -> None:
        """Draw one partial exposure; with the last one, the frame is ready."""
        stamp = self._instant(self._index)
        if not self._pipeline.is_lost(stamp):
            self._draw(pose, time_ns)
            if self._part + 1 == len(self._parts):
                self._finish(stamp, pose)
        self._part += 1
        if self._part == len(self._parts):
            self._index, self._part = self._index + 1, 0
            if self._triggered:
                self._triggered.popleft()
        self._plan()

    def _draw(self, pose: np.ndarray, time_ns: int) -> None:
        blend, pose = self._blend(self._next_ns, pose, time_ns)
        shaken = None if self.vibration is None else self.vibration.at(self._next_ns)
        part = self._parts[self._part]
        image = self.renderer.render(self.view(pose, self._bands[part.first], shaken), blend)
        if self._part == self._pipeline.middle and (self.depth or self.segmentation):
            self._measured = self.renderer.measure(self.view(pose, shaken=shaken), blend)
        self._pipeline.light.add(self._part, image)

    def _finish(self, stamp: int, pose: np.ndarray) -> None:
        image = self._pipeline.light.take()
        self._warn_if_blind(image, pose @ self._link_T_optical)
        encoding = self.config.encoding
        image = self._pipeline.read_out(formats.read_out(image, encoding), stamp)
        depth, segmentation = self._measured or (None, None)
        self._measured = None
        frame = SensorFrame(stamp, formats.widened(image, encoding), encoding,
                      depth if self.depth else None,
                      segmentation if self.segmentation else None)
        self._waiting.append((stamp + self._latency_ns, frame))

    def _pixels(self, first: int, last: int) -> tuple[int, np.ndarray, Tiles | None]:
        """How many rows, the camera matrix (3, 3) and the lens of rows first ... last - 1."""
        model, width = self.config.model, self.config.width
        K = model.K - [[0, 0, 0], [0, 0, first], [0, 0, 0]]
        if model.is_pinhole:
            return last - first, K, None
        size = width, last - first
        lens = shared(*size, (K.tobytes(), model.lens), lambda: Tiles.of_lens(
            *size, lambda pixels: model.unproject(pixels + [0, first])))  # fmt: skip
        return last - first, K, lens

    def _blend(self, instant: int, pose: np.ndarray, time_ns: int) -> tuple[float, np.ndarray]:
        if self._before is None or not self._before[0] <= instant < time_ns:
            return 1.0, pose
        before_ns, before = self._before
        share = (instant - before_ns) / (time_ns - before_ns)
        return share, blended(before, pose, share)

    def _warn_if_blind(self, image: np.ndarray, world_T_optical: np.ndarray) -> None:
        """Say once when the camera stands inside something, or when nothing but black is seen.

        The camera's own link may well hold the lens: Gazebo too draws no faces from behind.
        """
        first, self._first = self._first, False
        # One number mostly settles it.
        black = not (self._told_black or image[0, 0, 0] or image[::8, ::8].any())
        if not first and not black:
            return
        around = [name for name in self.renderer.bodies_around(world_T_optical[:3, 3])
                  if name.split("::")[-1] != self.config.link]
        where = f"it is inside {', '.join(around)}" if around else "only black things are in view"
        if black:
            self._told_black = True
            _log.warning("camera '%s' sends a black picture: %s; check its mounting pose and near "
                         "clip", self.config.name, where)
        elif around:
            _log.warning("camera '%s': %s, whose faces are not drawn from inside; check its "
                         "mounting pose", self.config.name, where)


def mounting(xyz: tuple[float, float, float], rpy: tuple[float, float, float]) -> np.ndarray:
    """link_T_optical (4, 4) of a sensor mounted at xyz (m), rpy (fixed axes, rad) in its link."""
    return optical(Pose.from_rpy(xyz, rpy).matrix())
