"""The two plates that are the target of the demo."""

from ..geometry import ARAS, Target
from .base import SHAPES, TargetShape


@SHAPES.register("aras")
class Plates(TargetShape):
    """The two plates of the demo, of fixed size."""

    def make(self) -> Target:
        """Return the plates."""
        return ARAS
