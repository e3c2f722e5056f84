"""Targets of the cameras: geometry, motion, outlines, textures, and URDF and mesh files."""

from .geometry import (
    ARAS,
    BoxesTarget,
    Motion,
    PlacedTarget,
    PolygonTarget,
    RoundTarget,
    Target,
    project,
)

__all__ = [
    "ARAS", "BoxesTarget", "Motion", "PlacedTarget", "PolygonTarget", "RoundTarget", "Target",
    "project",
]  # fmt: skip
