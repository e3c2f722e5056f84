"""Targets by name. `SHAPES` has those that a file of this folder declares."""

from .base import SHAPES, FlatShape, OutlineShape, SolidShape, TargetShape

__all__ = ["SHAPES", "FlatShape", "OutlineShape", "SolidShape", "TargetShape"]
