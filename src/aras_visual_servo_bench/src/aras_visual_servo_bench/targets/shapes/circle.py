"""A disc."""

from ..geometry import RoundTarget, Target
from .base import SHAPES, OutlineShape, make_ring

EDGES = 180


@SHAPES.register("circle")
class Circle(OutlineShape):
    """A disc, which has no corners."""

    corners = make_ring(EDGES)

    def make(self) -> Target:
        """Return the disc as a target."""
        return RoundTarget(self.scale_corners())
