"""A regular heptagon."""

from .base import SHAPES, OutlineShape, ring


@SHAPES.register("heptagon")
class Heptagon(OutlineShape):
    """A regular heptagon."""

    corners = ring(7)
