"""Polygon in the shape of an L."""

from .base import SHAPES, OutlineShape


@SHAPES.register("l_shape")
class LShape(OutlineShape):
    """Polygon in the shape of an L, with six corners."""

    corners = (
        (-0.5, -0.5), (0.5, -0.5), (0.5, -0.1), (-0.1, -0.1), (-0.1, 0.5), (-0.5, 0.5)
    )  # fmt: skip
