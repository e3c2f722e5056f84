"""What the camera looks at: geometry, outlines, textures, and the files they are written to."""

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
