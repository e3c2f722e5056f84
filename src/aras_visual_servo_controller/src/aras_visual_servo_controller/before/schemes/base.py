"""What a scheme is given and what it answers."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from ...desired import Desired
from ..laws import Law

LONGEST_GAP = 0.3  # s
LONGEST_JUMP = 1.0  # m or rad: an angle that wrapped round


@dataclass(frozen=True)
class Measurement:
    """What the camera node reports of one image.

    Attributes:
        stamp: exposure instant, s of simulated time.
        valid: the target is whole in the image; when False, reason says why not.
        moments: `aras_visual_servo_camera.moments.Moments`, or None for a kernel scheme.
        kernel: (20,) inverse Jacobian row by row and four features, or None.
        K: (3, 3) intrinsics of the image, pixels.
        width, height: of the image, pixels.
        pixel_count: pixels of the target as the camera node segments it; 0 where it is not known.
    """

    stamp: float
    valid: bool = True
    reason: str = ""
    moments: Any = None
    kernel: np.ndarray | None = None
    K: np.ndarray = field(default_factory=lambda: np.eye(3))
    width: int = 0
    height: int = 0
    pixel_count: int = 0


@dataclass(frozen=True)
class SchemeResult:
    """Answer of a scheme; the vectors have the length of the names.

    Attributes:
        names: of the features.
        features, desired, error: s, s* and s - s* with angles wrapped.
        twist: (6,) asked of the camera, optical frame, m/s and rad/s.
    """

    names: tuple[str, ...]
    features: np.ndarray
    desired: np.ndarray
    error: np.ndarray
    twist: np.ndarray


class Scheme(ABC):
    """Base of all schemes, also of a user's own.

    A scheme is constructed as `YourScheme(desired, law)`, by the node from the parameter `scheme`:
    a short name or 'package.module:Class'. It may not keep state between images other than what
    `reset` clears.

    Attributes:
        desired, law: as given.
        smoothing: time constant of `smoothed`, s; set by the node after construction.

    Class attributes:
        source: 'moments' (ImageMoments) or 'kernel' (the 20 numbers of camera/data).
        feature_names: of the features, in order.
        thresholds: of |error| below which the target counts as reached, in order.
    """

    source: ClassVar[str] = "moments"
    feature_names: ClassVar[tuple[str, ...]]
    thresholds: ClassVar[tuple[float, ...]]

    def __init__(self, desired: Desired, law: Law) -> None:
        self.desired = desired
        self.law = law
        self.smoothing = 0.0
        self._smooth: tuple[float, np.ndarray] | None = None

    @abstractmethod
    def compute(self, measurement: Measurement, elapsed: float) -> SchemeResult:
        """Features of a valid measurement and the twist they ask for.

        Args:
            measurement: of this image.
            elapsed: since servoing began, s.

        Raises:
            MeasurementError: these features cannot be had from this measurement.
        """

    def reset(self) -> None:
        """Forget what was kept of earlier images."""
        self._smooth = None

    def smoothed(self, error: np.ndarray, stamp: float) -> np.ndarray:
        """The error (k,) behind a first-order low-pass of time constant `smoothing` (s).

        Edges of an image have finitely many grey levels: the angle of a near-square jumps by some
        mrad from one image to the next, and a joint with friction turns that into a tremor. After
        a gap, or a jump that no camera makes, it begins anew.
        """
        if self.smoothing <= 0.0:
            return error
        if self._smooth is not None:
            before, value = self._smooth
            dt = stamp - before
            if 0.0 <= dt <= LONGEST_GAP and np.abs(error - value).max() < LONGEST_JUMP:
                error = value + (1.0 - np.exp(-dt / self.smoothing)) * (error - value)
        self._smooth = (stamp, error)
        return error


def wrap(angle: float, period: float = 2.0 * np.pi) -> float:
    """The angle (rad) modulo the period, in [-period/2, period/2)."""
    return float((angle + 0.5 * period) % period - 0.5 * period)
