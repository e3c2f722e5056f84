"""What a tracker is: it finds the points of a target in an image.

Points are found as pixels, and the lens is taken off afterwards; lines are bent by a lens, so it is
taken off before they are fitted. `numbered` says whether a point is known by itself (a marker's
corners) or by its place in the ring alone (dots, crossings).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from aras_visual_servo_base.registry import Registry

from ..errors import VisionError
from ..interaction import Plane
from ..undistortion import CameraModel


class TrackedPoints(NamedTuple):
    """What a tracker finds in a picture.

    points: (n, 2) normalised. plane: of the target, where it tells that. accuracy: normalised
    length to which the points are found. unshared: the part of it in which another picture from the
    same place, as the goal's, may differ. marker: `DICTIONARY:number` of the marker that they are.
    spread: (2n, m) effects on x_0, y_0, x_1, ... of independent errors, one standard deviation
    each, by how edges scatter about their lines; None: not known.
    """

    points: np.ndarray
    plane: Plane | None
    accuracy: float
    repeatability: float = 0.0
    marker: str = ""
    spread: np.ndarray | None = None


class Tracker(ABC):
    """Finds points of the target in an image, which count as its corners. Base class of all.

    A subclass gives `find`, and is named as 'package.module:Class'. Its parameters, if it has any,
    are the fields of a dataclass.

    Attributes:
        name: short name.
        numbered: whether a point is known by itself.
        accuracy: px to which points are found in the arm's pictures without noise.
    """

    name: ClassVar[str] = ""
    is_numbered: ClassVar[bool] = True
    accuracy: ClassVar[float] = 0.01

    @abstractmethod
    def find(self, grey: NDArray[np.uint8]) -> np.ndarray:
        """Points (n, 2) in a picture (rows, columns), px (column, row).

        Raises:
            VisionError: they are not to be seen.
        """

    def find_normalised(self, grey: NDArray[np.uint8], camera: CameraModel) -> np.ndarray:
        """The same points (n, 2), normalised and without the lens; VisionError as `find`."""
        x, y, _ = camera.normalise(*self.find(grey).T)
        return np.column_stack([x, y])

    def track(
        self, grey: NDArray[np.uint8], camera: CameraModel,
        world_T_camera: np.ndarray | None = None, depth: NDArray[np.float32] | None = None,
    ) -> TrackedPoints:  # fmt: skip
        """All that is found in the next picture of a loop; VisionError as `find`.

        Args:
            world_T_camera: (4, 4), where it is known. depth: (rows, columns) m, where there is one.
        """
        return TrackedPoints(self.find_normalised(grey, camera), None, self.accuracy / camera.K[0])

    def reset(self) -> None:
        """Forget earlier pictures."""


def sort_by_angle(points: np.ndarray) -> np.ndarray:
    """Return points (n, 2) in order of angle about their middle."""
    offset = points - points.mean(axis=0)
    return points[np.argsort(np.arctan2(offset[:, 1], offset[:, 0]))]


TRACKERS = Registry("tracker", __package__, (Tracker,), VisionError)
