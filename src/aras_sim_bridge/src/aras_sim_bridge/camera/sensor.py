"""A camera as a sensor: when it exposes, and what it delivers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import CameraError
from ..rendering import SENSOR_R_OPTICAL, Renderer, View
from .config import CameraConfig
from .model import CameraIntrinsics


@dataclass(frozen=True)
class Frame:
    """One picture. stamp_ns: instant of exposure on the simulated clock; encoding as ROS names."""

    stamp_ns: int
    image: np.ndarray
    encoding: str


class CameraSensor:
    """Exposes at k / update_rate s of simulated time, k = 1, 2, ...

    The instants rarely fall on physics ticks. A frame is drawn on the first tick at or after
    its instant, with all poses blended between that tick and the one before, so that the picture
    shows the world at the stamp and stamps are exact multiples of the period. For
    that, `before_step` must be called before a physics step.
    """

    def __init__(self, config: CameraConfig, renderer: Renderer) -> None:
        self.config = config
        self.renderer = renderer
        self.info: CameraIntrinsics = config.intrinsics()
        self._K = config.K
        self._link_T_optical = _mounting(config.xyz, config.rpy)
        self._index = 1
        self._before: tuple[int, np.ndarray] | None = None

    @property
    def period_ns(self) -> int:
        """Nominal period, ns, rounded; instants do not accumulate the rounding."""
        return round(1e9 / self.config.update_rate)

    @property
    def next_exposure_ns(self) -> int:
        """Simulated time of the next exposure, ns."""
        return self._instant(self._index)

    def _instant(self, index: int) -> int:
        return round(index * 1e9 / self.config.update_rate)

    def check_time_step(self, step_ns: int) -> None:
        """Raise CameraError if the camera is faster than the physics."""
        if self.period_ns < step_ns:
            raise CameraError(
                f"camera '{self.config.name}': update_rate {self.config.update_rate:g} Hz is above "
                f"the physics rate of {1e9 / step_ns:g} Hz; lower one or raise the other"
            )

    def reset(self, time_ns: int = 0) -> None:
        """Start anew at a simulated time: the next exposure is the first instant after it."""
        self._index = max(1, int(time_ns * self.config.update_rate / 1e9))
        while self._instant(self._index) <= time_ns:
            self._index += 1
        self._before = None

    def needs_before(self, time_after_ns: int) -> bool:
        """Whether the step that ends at `time_after_ns` passes over an instant between ticks."""
        return self.next_exposure_ns < time_after_ns

    def before_step(self, world_T_link: np.ndarray, time_ns: int) -> None:
        """Remember the state at `time_ns`, before a step for which `needs_before` is true."""
        self.renderer.snapshot()
        self._before = (time_ns, np.array(world_T_link, dtype=float))

    def due(self, time_ns: int) -> bool:
        """Whether `capture` has something to do at this tick."""
        return self.next_exposure_ns <= time_ns

    def capture(self, world_T_link: np.ndarray, time_ns: int) -> Frame | None:
        """Draw the frame whose instant has come; None if none has.

        world_T_link: (4, 4) pose of the camera's link at `time_ns`.
        """
        stamp = self.next_exposure_ns
        if stamp > time_ns:
            return None
        # After a jump in time only the newest instant is drawn.
        while self._instant(self._index + 1) <= time_ns:
            self._index += 1
        stamp = self.next_exposure_ns
        self._index += 1
        blend, pose = self._blend(stamp, np.asarray(world_T_link, dtype=float), time_ns)
        view = View(self.config.width, self.config.height, pose @ self._link_T_optical,
                    self._K, self.config.near, self.config.far)
        return Frame(stamp, self.renderer.render(view, blend), "rgb8")

    def _blend(self, stamp: int, pose: np.ndarray, time_ns: int) -> tuple[float, np.ndarray]:
        from ..rendering.scene import blend_poses

        if self._before is None or stamp >= time_ns:
            return 1.0, pose
        before_ns, before = self._before
        if not before_ns <= stamp < time_ns:
            return 1.0, pose
        blend = (stamp - before_ns) / (time_ns - before_ns)
        return blend, blend_poses(before, pose, blend)


def _mounting(xyz: tuple, rpy: tuple) -> np.ndarray:
    """link_T_optical (4, 4) of a sensor mounted at xyz, rpy (fixed axes) in its link."""
    (cr, sr), (cp, sp), (cy, sy) = ((np.cos(a), np.sin(a)) for a in rpy)
    Rx = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    Ry = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    Rz = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    T = np.eye(4)
    T[:3, :3] = Rz @ Ry @ Rx @ SENSOR_R_OPTICAL
    T[:3, 3] = xyz
    return T
