"""Named target shapes: each file of this folder registers its shapes in `SHAPES`."""

from .base import SHAPES, FlatShape, OutlineShape, SolidShape, TargetShape

__all__ = ["SHAPES", "FlatShape", "OutlineShape", "SolidShape", "TargetShape"]
