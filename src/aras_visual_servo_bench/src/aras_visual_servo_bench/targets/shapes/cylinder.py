"""A cylinder along z."""

from aras_sim_bridge.description.types import Geometry

from .base import SHAPES, SolidShape


@SHAPES.register("cylinder")
class CylinderShape(SolidShape):
    """A cylinder along z."""

    unit = Geometry("cylinder", radius=0.5, length=1.0)
