"""A regular heptagon."""

from .base import SHAPES, OutlineShape, make_ring


@SHAPES.register("heptagon")
class Heptagon(OutlineShape):
    """A regular heptagon."""

    corners = make_ring(7)
