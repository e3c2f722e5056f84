"""An L of six corners."""

from .base import SHAPES, OutlineShape


@SHAPES.register("l_shape")
class LShape(OutlineShape):
    """An L of six corners."""

    corners = (
        (-0.5, -0.5), (0.5, -0.5), (0.5, -0.1), (-0.1, -0.1), (-0.1, 0.5), (-0.5, 0.5)
    )  # fmt: skip
