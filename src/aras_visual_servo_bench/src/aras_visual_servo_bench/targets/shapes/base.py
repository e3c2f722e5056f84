"""Base classes of target shapes; shapes that users write derive from them, too."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from aras_sim_bridge.description.types import Geometry
from aras_visual_servo_base.registry import Registry
from aras_visual_servo_base.settings import check, parameter
from aras_visual_servo_controller.parameters import MODEL_TRACKER, OUTLINE_TRACKER

from ...errors import ExperimentError
from ..geometry import ARAS, PolygonTarget, Target

Corners = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class TargetShape(ABC):
    """Base class of target shapes; a shape makes the geometry of a target from its parameters.

    Every shape is a dataclass, and its parameters are annotated attributes; `settings.parameter`
    declares their unit, bounds and help. The settings `target.size` and `target.marker` set the
    parameters `size` and `marker`.

    Attributes:
        name: short name, used in messages.
        tracker: name of the tracker that detects the target's points in images.
        is_solid: whether `make` returns a SolidTarget.
    """

    name: ClassVar[str] = ""
    tracker: ClassVar[str] = OUTLINE_TRACKER
    is_solid: ClassVar[bool] = False

    def __init_subclass__(cls, **options: Any) -> None:
        """Make every subclass a dataclass, and set `name` to the name of the class.

        When the shape is registered, `name` becomes its registered name.
        """
        super().__init_subclass__(**options)
        cls.name = cls.__name__
        dataclass(frozen=True)(cls)

    def __post_init__(self) -> None:
        check(self, ExperimentError, "target")

    @abstractmethod
    def make(self) -> Target:
        """Return the target in its own frame, whose z axis is the normal of its face."""


class FlatShape(TargetShape):
    """Flat shape inside a rectangle."""

    size: tuple[float, float] = parameter(
        (0.2, 0.2),
        "m",
        above=0.0,
        expected="two lengths, along x and y, m",
        help="along x and y, m",
    )


class OutlineShape(FlatShape):
    """Flat polygon.

    Attributes:
        corners: corners (x, y) inside a square of side 1 around the origin; `size` scales them.
    """

    corners: ClassVar[Corners] = ()

    def make(self) -> Target:
        """Return the polygon."""
        return PolygonTarget(self.scale_corners())

    def scale_corners(self) -> Corners:
        """Return the corners (x, y), scaled to the size of the target, m."""
        return tuple((x * self.size[0], y * self.size[1]) for x, y in self.corners)


class SolidShape(TargetShape):
    """Solid around the origin of its frame.

    Attributes:
        unit: geometry of the solid whose size is 1 along x, y and z.
    """

    tracker = MODEL_TRACKER
    is_solid = True
    unit: ClassVar[Geometry]

    size: tuple[float, float, float] = parameter(
        (0.2, 0.2, 0.2), "m", above=0.0, expected="three lengths, along x, y and z, m",
        help="along x, y and z, m",
    )  # fmt: skip

    def make(self) -> Target:
        """Return the solid."""
        from ..solids import make_scaled_solid

        return make_scaled_solid(self.unit, self.size, self.name)


SHAPES = Registry("target shape", __package__, (TargetShape,), ExperimentError)


def make_ring(count: int) -> Corners:
    """Return the corners (x, y) of a regular polygon in a circle of diameter 1."""
    angles = 2.0 * np.pi * np.arange(count) / count
    return tuple(zip((0.5 * np.cos(angles)).tolist(), (0.5 * np.sin(angles)).tolist(), strict=True))


@SHAPES.register("aras")
class Plates(TargetShape):
    """The two plates of the demo, of fixed size."""

    def make(self) -> Target:
        """Return the plates."""
        return ARAS
