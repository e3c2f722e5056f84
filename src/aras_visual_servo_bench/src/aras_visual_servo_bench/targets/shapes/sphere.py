"""An ellipsoid; a sphere if all its sizes are equal."""

from aras_sim_bridge.description.types import Geometry

from .base import SHAPES, SolidShape


@SHAPES.register("sphere")
class SphereShape(SolidShape):
    """An ellipsoid; a sphere if all its sizes are equal."""

    unit = Geometry("sphere", radius=0.5)
