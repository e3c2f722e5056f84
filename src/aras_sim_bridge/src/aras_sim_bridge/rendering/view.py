"""Input of the renderer: a view of the world, and the lighting."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from aras_visual_servo_base.poses import inverse

from ..description.types import Light, Rgba
from ..errors import RenderingError
from .packed_colours import pack_colour
from .sky import MIDDLE
from .tiles import Tiles, get_shared_tiles


@dataclass
class View:
    """View of the world through a pinhole or a lens.

    Attributes:
        width, height: image size, px.
        world_T_optical: (4, 4) pose of the optical frame (z forward, x right, y down).
        K: (3, 3) camera matrix of a pinhole, without skew. Pixel centres have integer coordinates,
            so the centre of the image is ((width - 1) / 2, (height - 1) / 2).
        near, far: clip distances along the optical axis, m. Surfaces nearer than `near` or farther
            than `far` are not drawn.
        lens: rays of the pixels for a camera with a lens, which replace K; None for a pinhole. The
            image is divided into tiles. If rays point sideways or backwards, near and far are
            measured along the middle ray of each tile.
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
            raise RenderingError(
                f"a view of {self.width} x {self.height} px has no image: give sizes above 0"
            )
        if not 0.0 < self.near < self.far:
            raise RenderingError(
                f"clip distances are near={self.near} far={self.far}, must fulfil 0 < near < far"
            )

    @property
    def optical_T_world(self) -> np.ndarray:  # noqa: N802
        """Inverse (4, 4) of world_T_optical."""
        return inverse(self.world_T_optical)

    @property
    def rays_key(self) -> Hashable:
        """Key that is equal for views with the same rays in the optical frame."""
        return self.lens or (self.width, self.height, self.K.tobytes())

    def get_tiles(self) -> Tiles:
        """Return the tiles into which the image is divided, with the rays of its pixels."""
        return self.lens or get_shared_tiles(self.width, self.height, self.K.tobytes(), lambda: (
            Tiles.of_pinhole(self.width, self.height, self.K)))


@dataclass(frozen=True)
class Lighting:
    """Light of a scene: ambient light, and either a white sun without shadows or `lights`.

    With the sun, a surface of albedo a and normal n reflects a * (ambient + diffuse * max(0, n .
    -direction)). The grey level is 255 times this value times `scale`. The defaults are those of
    Gazebo.

    Attributes:
        direction: direction of the sunlight in the world frame, from the sun to the ground.
        ambient: intensity of the ambient light.
        diffuse: intensity of the sunlight.
        background: colour of the background.
        exposure: 'gazebo' does not scale the light, and clips grey levels above 255. This moves the
            edges of textures towards the dark side by hundredths of a pixel. 'unclipped' scales the
            light down if a white surface that faces the sun would be brighter than 255.
        lights: lights of any kind and colour (see lamps.py), which replace the sun.
        shadows: kind of shadows, one of SHADOWS. It applies to all lights that cast shadows.
        tint: colour of the ambient light (red, green, blue), by which `ambient` is multiplied.
        sky: whether a sky replaces the background.
        reference_white_level: intensity that 'unclipped' scales to the grey level 255. If None, it
            is the intensity of the brightest white surface. A fixed value keeps the exposure
            constant while lights vary.
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

    @cached_property
    def background_levels(self) -> np.ndarray:
        """Colour (3,) of pixels without a surface, rgb, 0 to 255."""
        return 255.0 * np.array(MIDDLE if self.sky else self.background[:3])

    @cached_property
    def packed_background(self) -> np.uint32:
        """Packed colour of pixels without a surface; see packed_colours.py."""
        return pack_colour(*self.background_levels.tolist())

    @property
    def white_level(self) -> float:
        """Largest intensity that a white surface can reflect under these lights."""
        if self.lights:
            diffuse = np.sum([light.diffuse[:3] for light in self.lights], axis=0)
            return float((diffuse + self.ambient * np.array(self.tint)).max())
        return self.ambient + self.diffuse

    @cached_property
    def scale(self) -> float:
        """Fraction of the grey level 255 per unit of reflected light intensity."""
        if self.exposure == "gazebo":
            return 1.0
        return 1.0 / max(
            self.white_level if self.reference_white_level is None else self.reference_white_level,
            1.0,
        )

    @property
    def ambient_levels(self) -> np.ndarray:
        """Ambient light (red, green, blue) as a fraction of the grey level 255."""
        return self.scale * self.ambient * np.array(self.tint)

    @cached_property
    def sun_levels(self) -> np.ndarray:
        """Ambient light and diffuse light of the sun (2,), as fractions of the grey level 255."""
        return self.scale * np.array([self.ambient, self.diffuse])

    @cached_property
    def to_sun(self) -> np.ndarray:
        """Unit vector (3,) towards the sun in the world frame."""
        d = -np.asarray(self.direction, dtype=float)
        norm = np.linalg.norm(d)
        if not norm > 0.0:
            raise RenderingError("the sun's direction is the zero vector; give another direction")
        return d / norm
