"""What a renderer is asked for: a view of the world, and its light."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from aras_visual_servo_base.poses import inverse

from ..description.types import Light, Rgba
from ..errors import RenderingError
from .tiles import Tiles, get_shared_tiles


@dataclass(frozen=True)
class View:
    """A view of the world, through a pinhole or a lens.

    width, height: image size, pixels.
    world_T_optical: (4, 4), pose of the optical frame (z forward, x right, y down) in the world.
    K: (3, 3) without skew; pixel centres have integer coordinates, so the centre of the image
        is ((width - 1) / 2, (height - 1) / 2).
    near, far: nothing nearer or farther along the optical axis is drawn, m.
    lens: the tiles of a picture through a lens; K is not used then. Where rays go sideways or
        back, near and far are measured along each tile's own axis.
    """

    width: int
    height: int
    world_T_optical: np.ndarray  # noqa: N815 (a_T_b maps b to a)
    K: np.ndarray
    near: float = 0.02
    far: float = 300.0
    lens: Tiles | None = None

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1:
            raise RenderingError(f"a view of {self.width} x {self.height} pixels has no image")
        if not 0.0 < self.near < self.far:
            raise RenderingError(
                f"clip distances near={self.near} far={self.far}: need 0 < near < far"
            )

    @property
    def optical_T_world(self) -> np.ndarray:  # noqa: N802
        """(4, 4), inverse of world_T_optical."""
        return inverse(self.world_T_optical)

    @property
    def rays_key(self) -> Hashable:
        """Equal for views whose pixels have the same rays in the optical frame."""
        return self.lens or (self.width, self.height, self.K.tobytes())

    def get_tiles(self) -> Tiles:
        """The tiles that the picture is drawn in."""
        return self.lens or get_shared_tiles(self.width, self.height, self.K.tobytes(), lambda: (
            Tiles.of_pinhole(self.width, self.height, self.K)))


@dataclass(frozen=True)
class Lighting:
    """One white sun without shadows, or `lights` in its place; the defaults are Gazebo's.

    direction: from the sun to the ground, world frame. A surface of albedo a gives back
    a * (ambient + diffuse * max(0, n . -direction)), and shows that times `scale`.
    exposure: 'unclipped': all light is scaled so that a white surface square to the sun, the
        brightest that there can be, is 255 at most; what is darker than that anyway stays as it is.
        'gazebo': light is not scaled, and what is brighter than 255 is cut, which moves the edges
        of textures towards the dark by hundredths of a pixel.
    lights: of any kind and colour, as lamps says what they give, ambient light besides.
    shadows: one of SHADOWS, of those lights that cast them.
    tint: of the ambient light, red, green, blue, times `ambient`.
    sky: whether one is seen in place of the background.
    white: what a white surface gives back at most, by which `unclipped` scales; None: of this
        light. More where lights that come and go are dark, for the camera stays as it is.
    """

    direction: tuple[float, float, float] = (-0.5, 0.1, -0.9)
    ambient: float = 0.4
    diffuse: float = 0.8
    background: Rgba = (0.7, 0.7, 0.7, 1.0)
    exposure: str = "unclipped"
    lights: tuple[Light, ...] = ()
    shadows: str = "none"
    tint: tuple[float, float, float] = (1.0, 1.0, 1.0)
    sky: bool = False
    reference_white_level: float | None = None

    @property
    def white_level(self) -> float:
        """What a white surface gives back of this light at most."""
        if self.lights:
            diffuse = np.sum([light.diffuse[:3] for light in self.lights], axis=0)
            return float((diffuse + self.ambient * np.array(self.tint)).max())
        return self.ambient + self.diffuse

    @property
    def scale(self) -> float:
        """Grey levels, in parts of 255, that a surface shows for the light that it gives back."""
        if self.exposure == "gazebo":
            return 1.0
        return 1.0 / max(
            self.white_level if self.reference_white_level is None else self.reference_white_level,
            1.0,
        )

    @property
    def ambient_levels(self) -> np.ndarray:
        """(3,) ambient light, parts of 255."""
        return self.scale * self.ambient * np.array(self.tint)

    @cached_property
    def to_sun(self) -> np.ndarray:
        """Unit vector towards the sun, (3,), world frame."""
        d = -np.asarray(self.direction, dtype=float)
        norm = np.linalg.norm(d)
        if not norm > 0.0:
            raise RenderingError("the sun's direction is the zero vector")
        return d / norm
