"""Targets of the cameras: geometry, motion, outlines, textures, and URDF and mesh files."""

from .geometry import (
    ARAS,
    PlacedTarget,
    PlatesTarget,
    PolygonTarget,
    RoundTarget,
    Target,
    TargetMotion,
    project,
)

__all__ = [
    "ARAS", "PlacedTarget", "PlatesTarget", "PolygonTarget", "RoundTarget", "Target",
    "TargetMotion", "project",
]  # fmt: skip
