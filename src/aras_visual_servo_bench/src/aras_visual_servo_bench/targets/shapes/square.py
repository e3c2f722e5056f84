"""A square, or a rectangle."""

from .base import SHAPES, OutlineShape


@SHAPES.register("square")
class Square(OutlineShape):
    """A square, or a rectangle."""

    corners = ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))
