"""A triangle without symmetry."""

from .base import SHAPES, OutlineShape


@SHAPES.register("triangle")
class Triangle(OutlineShape):
    """A triangle without symmetry."""

    corners = ((-0.5, -0.4), (0.5, -0.3), (-0.1, 0.5))
