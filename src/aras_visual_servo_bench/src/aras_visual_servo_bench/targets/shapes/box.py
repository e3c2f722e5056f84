"""A box."""

from aras_sim_bridge.description.types import Geometry

from .base import SHAPES, SolidShape


@SHAPES.register("box")
class BoxShape(SolidShape):
    """A box."""

    unit = Geometry("box", size=(1.0, 1.0, 1.0))
