"""Flat targets that carry a picture: made ones (dots, lines, marker, poster) and any PNG."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from aras_visual_servo_base.errors import DescriptionError
from aras_visual_servo_base.picture_files import picture_size, read_on_white
from aras_visual_servo_camera.markers import MarkerChoice

from ..errors import ExperimentError
from .geometry import FLIPPED, Target, project

PIXELS = 1200  # of a made picture's longer side
POSTER_SEED = 41


@dataclass(frozen=True, eq=False)
class TexturedTarget(Target):
    """A rectangle in its plane z = 0 with a picture on it, which faces along z.

    pixels: (rows, columns) uint8; its first row is at +y, its first column at -x. size: along x
    and y, m. known: points (n, 2) of it, m, that a tracker finds; None: the rectangle's corners.
    """

    is_textured = True

    pixels: np.ndarray
    size: tuple[float, float]
    known: np.ndarray | None = None

    def vertices(self) -> np.ndarray:
        """The rectangle's corners, from the picture's first pixel, round it."""
        w, h = 0.5 * np.asarray(self.size)
        return np.array([[-w, h, 0.0], [w, h, 0.0], [w, -h, 0.0], [-w, -h, 0.0]])

    def outline(self, target_T_camera: np.ndarray) -> np.ndarray:
        """The projected rectangle."""
        return project(self.vertices(), target_T_camera)

    def points(self, target_T_camera: np.ndarray) -> np.ndarray:
        """What a tracker would find, exactly."""
        if self.known is None:
            return self.outline(target_T_camera)
        known = np.column_stack([self.known, np.zeros(len(self.known))])
        return project(known, target_T_camera)

    def perturbed(self, seed: int) -> TexturedTarget:
        """The same with its picture disturbed as the protocols of Felton and of ViT-VS do it.

        With probability 1/2 a patch of 2 to 33 % of the area is erased; brightness times 0.4 to
        1.6, contrast times 0.6 to 1.4, Gaussian grains of 5 % of white.
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
        drawn = np.clip(np.round(pixels), 0, 255).astype(np.uint8)
        return TexturedTarget(drawn, self.size, self.known)


def from_picture(path: Path, size: tuple[float, float]) -> TexturedTarget:
    """A target with a PNG, a JPEG or another file that Pillow and OpenCV read; what is transparent
    is white.

    Raises:
        ExperimentError: it cannot be read, or is too large, by its header, before it is decoded.
    """
    try:
        size_px = picture_size(path)
    except DescriptionError as error:
        raise ExperimentError(f"target.texture: {error}") from None
    pixels = read_on_white(path) if size_px is not None else None
    if pixels is None or pixels.size == 0:
        raise ExperimentError(f"target.texture: {path} is no picture that can be read: give a PNG")
    return TexturedTarget(pixels, size)


def four_dots(size: tuple[float, float]) -> TexturedTarget:
    """Four black dots on white at a quarter from the rim, a tenth of the width across."""
    w, h = size
    middles = 0.25 * np.array([[-w, -h], [w, -h], [w, h], [-w, h]])
    pixels, per = _blank(size)
    for x, y in middles:
        centre = ((x + 0.5 * w) * per - 0.5, (y + 0.5 * h) * per - 0.5)
        _disc(pixels, centre, 0.05 * w * per)
    return TexturedTarget(pixels, size, middles * FLIPPED)


def marker(size: tuple[float, float], which: str = "") -> TexturedTarget:
    """An ArUco or AprilTag marker with a white rim; its corners are known.

    which: see MarkerChoice; '': AprilTag 36h11, number 0.
    """
    choice = MarkerChoice.read(which, "target.marker")
    pixels, _ = _blank(size)
    cells = choice.cells + 2  # one of white on either side
    side = min(pixels.shape) // cells * choice.cells
    tag = choice.image(side)
    top, left = ((n - side) // 2 for n in pixels.shape)
    pixels[top : top + side, left : left + side] = tag
    per = pixels.shape[1] / size[0]
    corners = np.array([[0, 0], [side, 0], [side, side], [0, side]], float) + (left, top)
    return TexturedTarget(pixels, size, (corners / per - 0.5 * np.asarray(size)) * FLIPPED)


def line_grid(size: tuple[float, float]) -> TexturedTarget:
    """Black lines on white, five by five; the crossings of the outermost four are known."""
    w, h = size
    pixels, per = _blank(size)
    wide = max(int(round(0.01 * w * per)), 1)
    across = np.linspace(-0.4, 0.4, 5)
    for part in across:
        u, v = ((part + 0.5) * w * per, (part + 0.5) * h * per)
        low_u, low_v = int(round(u - 0.5 * wide)), int(round(v - 0.5 * wide))
        first, last = (int(round(p * h * per)) for p in (0.1, 0.9))
        pixels[first:last, low_u : low_u + wide] = 0
        first, last = (int(round(p * w * per)) for p in (0.1, 0.9))
        pixels[low_v : low_v + wide, first:last] = 0
    low, high = across[0], across[-1]
    crossings = np.array([(low, low), (high, low), (high, high), (low, high)]) * size
    return TexturedTarget(pixels, size, crossings * FLIPPED)


def poster(size: tuple[float, float], seed: int = POSTER_SEED) -> TexturedTarget:
    """A picture of our own for feature points: shapes and grains of all sizes, by a seed."""
    random = np.random.default_rng(seed)
    pixels, _ = _blank(size)
    rows, columns = pixels.shape
    cloud = np.zeros((rows, columns), np.float32)
    for cells in (4, 8, 16, 32, 64):
        grains = random.normal(size=(cells, cells)).astype(np.float32)
        cloud += cv2.resize(grains, (columns, rows), interpolation=cv2.INTER_CUBIC) / cells**0.5
    pixels[:] = np.clip(128.0 + 50.0 * cloud, 30, 225)
    for _ in range(160):
        u, v = random.uniform(0, columns), random.uniform(0, rows)
        reach = columns * random.choice([0.01, 0.02, 0.04, 0.08])
        level = int(random.integers(0, 256))
        corners = random.uniform(-1.0, 1.0, (random.integers(3, 7), 2)) * reach + (u, v)
        cv2.fillPoly(pixels, [cv2.convexHull(corners.astype(np.int32))], level, cv2.LINE_AA)
    return TexturedTarget(pixels, size)


def _blank(size: tuple[float, float]) -> tuple[np.ndarray, float]:
    """A white picture of this size, and pixels per metre."""
    per = PIXELS / max(size)
    shape = tuple(int(round(length * per)) for length in reversed(size))
    return np.full(shape, 255, np.uint8), per


def _disc(pixels: np.ndarray, centre: tuple[float, float], radius: float) -> None:
    """A black disc with smooth edges, px."""
    left, top = (max(int(middle - radius) - 1, 0) for middle in centre)
    right, bottom = (int(middle + radius) + 3 for middle in centre)
    part = pixels[top:bottom, left:right]
    v, u = np.indices(part.shape)
    inside = np.clip(
        radius + 0.5 - np.hypot(u + (left - centre[0]), v + (top - centre[1])), 0.0, 1.0)
    np.minimum(part, np.round(255.0 * (1.0 - inside)).astype(np.uint8), out=part)


MADE: dict[str, Callable[[tuple[float, float]], TexturedTarget]] = {
    "four_dots": four_dots, "marker": marker, "line_grid": line_grid, "poster": poster,
}  # fmt: skip
