"""Flat targets with a texture, drawn or read from an image file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from aras_visual_servo_base.errors import DescriptionError
from aras_visual_servo_base.image_files import read_image_size, read_on_white

from ..errors import catch_setting_errors, require
from .geometry import Target, project

PIXELS = 1200  # longer side of a generated texture, px


@dataclass(frozen=True, eq=False)
class TexturedTarget(Target):
    """Rectangle in the plane z = 0 with a texture on the side that faces +z.

    pixels: image, uint8, grey (rows, columns) or in the order blue, green, red (rows, columns, 3);
        the first row is at +y, the first column at -x.
    size: size along x and y, m.
    known_points: points (n, 2), m, that a tracker detects; None: the corners of the rectangle.
    """

    is_textured = True

    pixels: np.ndarray
    size: tuple[float, float]
    known_points: np.ndarray | None = None

    def vertices(self) -> np.ndarray:
        """Return the corners (4, 3) of the rectangle in order, starting at the first pixel."""
        w, h = 0.5 * np.asarray(self.size)
        return np.array([[-w, h, 0.0], [w, h, 0.0], [w, -h, 0.0], [-w, -h, 0.0]])

    def outline(self, target_T_camera: np.ndarray) -> np.ndarray:
        """Project the corners of the rectangle."""
        return project(self.vertices(), target_T_camera)

    def points(self, target_T_camera: np.ndarray) -> np.ndarray:
        """Project the points that a tracker detects."""
        if self.known_points is None:
            return self.outline(target_T_camera)
        points = np.column_stack([self.known_points, np.zeros(len(self.known_points))])
        return project(points, target_T_camera)

    def perturb(self, seed: int) -> TexturedTarget:
        """Return a copy with a random change of its texture, like those in two publications.

        The changes are those of Felton et al. and of ViT-VS. Brightness is multiplied by a factor
        from 0.4 to 1.6, contrast by a factor from 0.6 to 1.4. Gaussian noise is added, with a
        standard deviation of 5 % of white. With probability 1/2, a patch of 2 to 33 % of the area
        is erased.
        """
        random = np.random.default_rng((seed, 489))
        pixels = self.pixels.astype(np.float32) * random.uniform(0.4, 1.6)
        mean = float(pixels.mean())
        pixels = mean + (pixels - mean) * random.uniform(0.6, 1.4)
        pixels += random.normal(0.0, 0.05 * 255.0, pixels.shape)
        rows, columns = pixels.shape
        if random.random() < 0.5:
            area, shape = random.uniform(0.02, 0.33), np.exp(random.uniform(-1.0, 1.0))
            high = min(int(np.sqrt(area * shape) * rows), rows)
            wide = min(int(np.sqrt(area / shape) * columns), columns)
            top, left = random.integers(0, rows - high + 1), random.integers(0, columns - wide + 1)
            pixels[top : top + high, left : left + wide] = random.uniform(0.0, 255.0)
        perturbed = np.clip(np.round(pixels), 0, 255).astype(np.uint8)
        return TexturedTarget(perturbed, self.size, self.known_points)


def read_image_target(path: Path, size: tuple[float, float]) -> TexturedTarget:
    """Make a target from an image file; transparent pixels become white.

    Raises:
        ExperimentError: the image cannot be read, or its header gives too large a size.
    """
    with catch_setting_errors(DescriptionError, "target.texture"):
        pixels = None if read_image_size(path) is None else read_on_white(path)
    require(pixels is not None and pixels.size > 0,
            f"target.texture: {path} is not a readable image: give a PNG")
    return TexturedTarget(pixels, size)


def make_blank_image(size: tuple[float, float]) -> tuple[np.ndarray, float]:
    """Return a white image for a rectangle of this size (m), and its resolution in px per metre."""
    per_metre = PIXELS / max(size)
    shape = tuple(int(round(length * per_metre)) for length in reversed(size))
    return np.full(shape, 255, np.uint8), per_metre
