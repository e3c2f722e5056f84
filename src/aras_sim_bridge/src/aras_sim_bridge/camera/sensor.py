"""Camera sensor: time of the exposures, rendering, and delivery of the frames."""

from __future__ import annotations

import logging
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from aras_visual_servo_base.poses import Pose, optical_pose

from ..errors import CameraError, RenderingError
from ..pose_interpolation import blend_pose
from ..rendering import View
from ..rendering.tiles import Tiles, get_shared_tiles
from . import pixel_formats
from .config import CameraConfig
from .intrinsics import CameraIntrinsics
from .pipeline import ImagePipeline
from .shutter import compute_duration, make_row_bands
from .vibration import Vibration

if TYPE_CHECKING:
    from ..rendering.renderer import Renderer

_log = logging.getLogger(__name__)
NEVER = (1 << 63) - 1  # time, ns, that is never reached; used while a camera waits for a trigger


@dataclass
class CameraReading:
    """One frame of a camera.

    Attributes:
        stamp_ns: middle of the exposure in simulated time, ns.
        image: pixels of the image.
        encoding: name of the image's encoding in ROS.
        depth: depth image (H, W) float32, m, as described in Renderer.measure; None if it is
            disabled.
        segmentation: segmentation (H, W) int32, also described in Renderer.measure; None if it is
            disabled.

    Depth and segmentation show the world at the stamp. If the image is the mean of several
    renderings, they show the world at the time of the rendering nearest to the stamp.
    """

    stamp_ns: int
    image: np.ndarray
    encoding: str
    depth: np.ndarray | None = None
    segmentation: np.ndarray | None = None


class CameraSensor:
    """Camera that exposes at the simulated times k / update_rate s, k = 1, 2, ...

    An exposure is usually due between the start and the end of a physics step. The image is
    rendered at the end of this step, with poses that are interpolated to the time of the exposure.
    In a step of dt that ends at time t, the simulation calls

        if sensor.needs_previous_pose(t): sensor.before_step(world_T_link, t - dt)  # before Bullet
        ...
        if sensor.is_due(t): frame = sensor.capture(world_T_link, t)                # after Bullet

    If `before_step` was not called, the image shows the world at the end of the step. A camera with
    a trigger_topic exposes only after a call of `trigger`, once for each call.

    Attributes:
        config: settings of the camera.
        renderer: renderer of the images.
        info: content of CameraInfo.
        vibration: vibration of the camera; None for a rigid mounting.
        due_ns: simulated time, ns, at which `capture` must be called next.
        depth, segmentation: whether frames contain depth and segmentation. They may be disabled
            while there is no subscriber.
    """

    def __init__(self, config: CameraConfig, renderer: Renderer) -> None:
        """Create the sensor, and prepare the renderer for the camera's image size and lens.

        Raises:
            CameraError: the images cannot be rendered.
        """
        self.config = config
        self.renderer = renderer
        self.info: CameraIntrinsics = config.make_intrinsics()
        self._is_grey = config.encoding.startswith("mono")
        self._link_T_optical = optical_pose(Pose.from_rpy(config.xyz, config.rpy).matrix())
        self._parts = make_row_bands(config.effects, config.height)
        try:
            self._full_view = self._make_row_camera(0, config.height)
            self._bands = {part.first: self._make_row_camera(part.first, part.last)
                           for part in self._parts}  # fmt: skip
            renderer.prepare(self.make_view(np.eye(4)))
        except (RenderingError, MemoryError) as error:
            reason = str(error) or "not enough memory; make width and height smaller"
            raise CameraError(f"camera '{config.name}': {reason}") from None
        shape = pixel_formats.find_shape(config.encoding, config.height, config.width)
        self._pipeline = ImagePipeline(config.effects, shape, config.seed, self._parts)
        self.vibration = None if config.shake is None else Vibration(config.shake, config.seed)
        self._rate = config.update_rate
        self._latency_ns = round(config.latency * 1e9)
        self._first, self._has_warned_black, self._has_warned_missed = True, False, False
        # The publisher switches depth and segmentation off while they have no subscriber.
        self.depth, self.segmentation = config.depth, config.segmentation
        self.reset()

    @property
    def rate(self) -> float:
        """Frame rate, Hz of simulated time."""
        return self._rate

    @property
    def link_T_optical(self) -> np.ndarray:
        """Pose (4, 4) of the optical frame in the link."""
        return self._link_T_optical.copy()

    def compute_rays(self) -> np.ndarray:
        """Return the rays (H, W, 3) float32 of the pixels, in the optical frame.

        The ray of a pixel times its depth is the visible point. A pixel that no ray reaches, such
        as one outside a fisheye's image circle, gets NaN.
        """
        c = self.config
        pixels = np.stack(np.meshgrid(np.arange(c.width), np.arange(c.height)), axis=2)
        rays = c.projection.unproject(pixels.reshape(-1, 2)).reshape(c.height, c.width, 3)
        lens = self._full_view[2]
        if lens is None or lens.forward:
            rays = rays / rays[..., 2:]
        return rays.astype(np.float32)

    def make_view(
        self, world_T_link: np.ndarray, pixels: tuple[int, np.ndarray, Tiles | None] | None = None,
        mounting_T_shaken: np.ndarray | None = None,
    ) -> View:
        """Return the renderer's input for the whole image or for a band of its rows.

        Args:
            world_T_link: pose (4, 4) of the camera's link.
            pixels: result of `_make_row_camera` for a band of rows; None for the whole image.
            mounting_T_shaken: displacement (4, 4) of the optical frame by vibration.
        """
        c, (rows, K, lens) = self.config, pixels or self._full_view
        world_T_optical = world_T_link @ self._link_T_optical
        if mounting_T_shaken is not None:
            world_T_optical = world_T_optical @ mounting_T_shaken
        return View(c.width, rows, world_T_optical, K, c.near, c.far, lens)

    def check_time_step(self, step_ns: int, rate: float | None = None) -> None:
        """Check that the frame rate is not above the physics rate.

        Args:
            step_ns: physics step.
            rate: frame rate, Hz; None for the present rate.

        Raises:
            CameraError: the frame rate is above the physics rate.
        """
        rate = self._rate if rate is None else rate
        if round(1e9 / rate) < step_ns:
            raise CameraError(
                f"camera '{self.config.name}': update_rate {rate:g} Hz is above the physics "
                f"rate of {1e9 / step_ns:g} Hz; lower update_rate or raise the physics rate"
            )

    def set_rate(self, rate: float, time_ns: int, step_ns: int) -> None:
        """Change the frame rate.

        The next exposure is at the first multiple of the new period after `time_ns`. Frames that
        wait for their publication are still delivered.

        Args:
            rate: frame rate, Hz.
            time_ns: present simulated time.
            step_ns: physics step.

        Raises:
            CameraError: the rate is not positive, above the physics rate, or too high for the
                exposure; nothing is changed.
        """
        if not (np.isfinite(rate) and rate > 0.0):
            raise CameraError(
                f"camera '{self.config.name}': rate is {rate} Hz, must be above 0"
            )
        self.check_time_step(step_ns, rate)
        self.config.check_rate(rate)
        self._rate = float(rate)
        pending = self._pending_frames
        self._restart(time_ns, exposure=False)
        self._pending_frames = pending
        self._schedule_next()

    def trigger(self, time_ns: int, step_ns: int) -> None:
        """Add an exposure that starts at the end of the next physics step.

        The next step starts at `time_ns` and has the length `step_ns`. If earlier triggered
        exposures are pending, the new one follows the last of them. A camera without a trigger is
        not affected.
        """
        if not self.config.trigger_topic:
            return
        stamp = time_ns + step_ns - self._parts[0].offset_ns
        if self._trigger_times:
            duration_ns = round(compute_duration(self.config.effects, self.config.height) * 1e9)
            stamp = max(stamp, self._trigger_times[-1] + max(step_ns, duration_ns))
        self._trigger_times.append(stamp)
        self._schedule_next()

    def reset(self, time_ns: int = 0) -> None:
        """Restart: the next image is the first one whose exposure starts after `time_ns`.

        Call this when the clock jumps back, and when images are enabled again after a pause.
        """
        self._restart(time_ns, exposure=True)

    def _restart(self, time_ns: int, exposure: bool) -> None:
        """Start again with the first image whose exposure starts after `time_ns`.

        If `exposure` is True, the auto exposure is reset, too.
        """
        self._trigger_times: deque[int] = deque()
        self._index = int(time_ns * self._rate / 1e9)
        while self._compute_instant(self._index) + self._parts[0].offset_ns <= time_ns:
            self._index += 1
        self._previous_pose: tuple[int, np.ndarray] | None = None
        self._pending_frames: deque[tuple[int, CameraReading]] = deque()
        self._pipeline.reset(exposure)
        self._depth_and_labels: tuple[np.ndarray, np.ndarray] | None = None
        self._part = 0
        self._schedule_next()

    def _compute_instant(self, index: int) -> int:
        if self.config.trigger_topic:
            return self._trigger_times[0] if self._trigger_times else NEVER
        return round(index * 1e9 / self._rate)

    def _schedule_next(self) -> None:
        """Set the stamp of the next frame, and the time at which it must be rendered next."""
        self._stamp_ns = self._compute_instant(self._index)
        self._next_ns = self.due_ns = self._stamp_ns + self._parts[self._part].offset_ns
        if self._pending_frames:
            self.due_ns = min(self._next_ns, self._pending_frames[0][0])

    def needs_previous_pose(self, time_after_ns: int) -> bool:
        """Return whether an exposure is due before the end `time_after_ns` of the next step."""
        return self._next_ns < time_after_ns

    def before_step(self, world_T_link: np.ndarray, time_ns: int) -> None:
        """Store `world_T_link` and the poses of all models at `time_ns`, the start of a step."""
        self.renderer.snapshot()
        self._previous_pose = (time_ns, np.array(world_T_link, dtype=float))

    def is_due(self, time_ns: int) -> bool:
        """Return whether `capture` must be called at the end of a step, `time_ns`."""
        return self.due_ns <= time_ns

    def capture(self, world_T_link: np.ndarray, time_ns: int) -> CameraReading | None:
        """Render what is due at `time_ns`, and return the frame whose latency has passed, or None.

        Call this at the end of a physics step. `world_T_link` is the pose (4, 4) of the camera's
        link at `time_ns`.
        """
        while self._next_ns <= time_ns:
            if self._part == 0 and self._compute_instant(self._index + 1) <= time_ns:
                self._skip_missed(time_ns)
            self._expose(np.asarray(world_T_link, dtype=float), time_ns)
        if not self._pending_frames or self._pending_frames[0][0] > time_ns:
            return None
        frame = self._pending_frames.popleft()[1]
        self._schedule_next()
        return frame

    def _skip_missed(self, time_ns: int) -> None:
        """Skip all but the last image that is due by the end of a step, unless triggered."""
        if self.config.trigger_topic:
            return
        if not self._has_warned_missed:
            self._has_warned_missed = True
            _log.warning("camera '%s' drops frames: its rate of %g Hz is above the physics rate; "
                         "lower it or raise the physics rate", self.config.name, self._rate)
        self._index = int(time_ns * self._rate / 1e9)
        if self._compute_instant(self._index + 1) <= time_ns:
            self._index += 1
        self._schedule_next()

    def _expose(self, pose: np.ndarray, time_ns: int) -> None:
        """Render the next partial exposure of the image; after the last one, make the frame."""
        stamp = self._stamp_ns
        if not self._pipeline.is_lost(stamp):
            self._draw(pose, time_ns)
            if self._part + 1 == len(self._parts):
                self._finish(stamp, pose)
        self._part += 1
        if self._part == len(self._parts):
            self._index, self._part = self._index + 1, 0
            if self._trigger_times:
                self._trigger_times.popleft()
        self._schedule_next()

    def _draw(self, pose: np.ndarray, time_ns: int) -> None:
        blend, pose = self._interpolate_pose(self._next_ns, pose, time_ns)
        displacement = (
            None if self.vibration is None else self.vibration.compute_pose(self._next_ns)
        )
        part = self._parts[self._part]
        render = self.renderer.render_grey if self._is_grey else self.renderer.render
        image = render(self.make_view(pose, self._bands[part.first], displacement), blend)
        if self._part == self._pipeline.middle_part and (self.depth or self.segmentation):
            self._depth_and_labels = self.renderer.measure(
                self.make_view(pose, mounting_T_shaken=displacement), blend
            )
        self._pipeline.exposure.add(self._part, image)

    def _finish(self, stamp: int, pose: np.ndarray) -> None:
        image = self._pipeline.exposure.take()
        # Test a single number first: this is fast, and the first pixel is usually not black.
        if self._first or not image.item(0):
            self._warn_if_blind(image, pose @ self._link_T_optical)
        encoding = self.config.encoding
        light = image if self._is_grey else pixel_formats.read_out(image, encoding)
        image = pixel_formats.widen(self._pipeline.read_out(light, stamp), encoding)
        depth, segmentation = self._depth_and_labels or (None, None)
        self._depth_and_labels = None
        frame = CameraReading(
            stamp, image, encoding, depth if self.depth else None,
            segmentation if self.segmentation else None,
        )  # fmt: skip
        self._pending_frames.append((stamp + self._latency_ns, frame))

    def _make_row_camera(self, first: int, last: int) -> tuple[int, np.ndarray, Tiles | None]:
        """Return the camera that sees only the rows first ... last - 1 of the image.

        The result is the number of rows, the camera matrix (3, 3) of this part of the image, and
        the renderer's tiles of the lens; None instead of the tiles for a pinhole camera.
        """
        model, width = self.config.projection, self.config.width
        K = model.K - [[0, 0, 0], [0, 0, first], [0, 0, 0]]
        if model.is_pinhole:
            return last - first, K, None
        size = width, last - first
        lens = get_shared_tiles(*size, (K.tobytes(), model.lens), lambda: Tiles.of_lens(
            *size, lambda pixels: model.unproject(pixels + [0, first])))  # fmt: skip
        return last - first, K, lens

    def _interpolate_pose(
        self, instant: int, pose: np.ndarray, time_ns: int
    ) -> tuple[float, np.ndarray]:
        if self._previous_pose is None or not self._previous_pose[0] <= instant < time_ns:
            return 1.0, pose
        before_ns, before = self._previous_pose
        share = (instant - before_ns) / (time_ns - before_ns)
        return share, blend_pose(before, pose, share)

    def _warn_if_blind(self, image: np.ndarray, world_T_optical: np.ndarray) -> None:
        """Warn once if the camera is inside an object, or if its image is black.

        There is no warning if the camera is inside its own link: as in Gazebo, the inner sides of
        surfaces are not drawn, so the link does not hide the view.
        """
        first, self._first = self._first, False
        black = not (self._has_warned_black or image[::8, ::8].any())
        if not first and not black:
            return
        around = [name for name in self.renderer.find_bodies_around(world_T_optical[:3, 3])
                  if name.split("::")[-1] != self.config.link]
        inside = f"the camera is inside {', '.join(around)}"
        if black:
            self._has_warned_black = True
            _log.warning("camera '%s' sends a black image: %s; check the camera's pose and near "
                         "clip distance", self.config.name,
                         inside if around else "all visible surfaces are black")
        elif around:
            _log.warning("camera '%s': %s and therefore does not see it; check the camera's pose",
                         self.config.name, inside)
