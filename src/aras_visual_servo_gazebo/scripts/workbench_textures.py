"""Textures of the workbench world: wood, bricks, posters and labels, drawn with a fixed seed."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

SEED = 2016
SURFACE_SIZE, PRINT_SIZE = 1024, 512  # sides of the textures of surfaces and of prints, px
INK = (40, 36, 34)
PAPERS = ((214, 228, 240), (196, 214, 226), (225, 225, 214), (205, 220, 205))
PAINTS = ((60, 90, 200), (170, 110, 40), (60, 150, 80), (40, 160, 220), (140, 70, 140),
          (190, 170, 60), (50, 50, 170), (120, 160, 30))


def make_noise(rng: np.random.Generator, shape: tuple[int, int], scales: tuple[int, ...]
           ) -> np.ndarray:
    """Return smooth noise (H, W) between 0 and 1.

    scales: distances, px. For each of them, random values on a grid with this distance are
        interpolated, and added with a weight that increases with the distance.
    """
    total = np.zeros(shape)
    for scale in scales:
        knots = rng.uniform(-1, 1, (shape[0] // scale + 4, shape[1] // scale + 4))
        fine = cv2.resize(knots, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
        total += scale**0.7 * fine[scale:scale + shape[0], scale:scale + shape[1]]
    total -= total.min()
    return total / total.max()


def mix_colours(share: np.ndarray, dark: tuple[int, ...], bright: tuple[int, ...]) -> np.ndarray:
    """Return colours (H, W, 3) between `dark` and `bright`, in the order blue, green, red.

    share: (H, W) fraction of `bright`, 0 to 1.
    """
    return np.array(dark) + share[..., None] * (np.array(bright, float) - dark)


def draw_wood(rng: np.random.Generator, boards: int) -> np.ndarray:
    """Return a texture of parallel wooden boards whose grain is along the rows of pixels."""
    size = SURFACE_SIZE
    image = np.zeros((size, size, 3))
    high = size // boards
    for n in range(boards):
        noise = make_noise(rng, (high, size // 8), (64, 16))
        noise = cv2.resize(noise, (size, high), interpolation=cv2.INTER_CUBIC)
        rings = 0.5 + 0.5 * np.sin(2 * np.pi * (9 * noise + np.arange(high)[:, None] / high * 2))
        streaks = cv2.blur(rng.uniform(0, 1, (high, size)), (61, 1))
        share = np.clip(0.45 * rings + 1.8 * (streaks - 0.5) + 0.3, 0, 1)
        tone = rng.uniform(0.8, 1.05)
        board = tone * mix_colours(share, (62, 104, 148), (112, 163, 205))
        board[:3] *= 0.45
        image[n * high:(n + 1) * high] = board
    return image


def draw_bricks(rng: np.random.Generator) -> np.ndarray:
    """Return a texture of 16 rows of 8 bricks; every second row is shifted by half a brick."""
    size = SURFACE_SIZE
    image = mix_colours(make_noise(rng, (size, size), (32, 8, 4)), (150, 158, 162), (186, 194, 198))
    rough = make_noise(rng, (size, size), (32, 8, 4))
    high, wide = size // 16, size // 8
    for row in range(16):
        for column in range(-1, 8):
            left = column * wide + (wide // 2 if row % 2 else 0)
            top = row * high
            red = rng.uniform(0.75, 1.1) * np.array([72, 88, 152]) + rng.normal(0, 5, 3)
            rows = slice(top + 4, top + high - 3)
            columns = slice(max(left + 4, 0), max(min(left + wide - 4, size), 0))
            image[rows, columns] = red * (0.72 + 0.5 * rough[rows, columns, None])
    return image


def draw_text(image: np.ndarray, words: str, at: tuple[int, int], scale: float,
         colour: tuple[int, ...] = INK, thick: int = 2) -> None:
    cv2.putText(image, words, at, cv2.FONT_HERSHEY_DUPLEX, scale, colour, thick, cv2.LINE_AA)


def draw_poster(rng: np.random.Generator, kind: int) -> np.ndarray:
    """Return a poster with a heading, a drawing of one of six kinds, and lines of small text."""
    size, paper = PRINT_SIZE, PAPERS[kind % len(PAPERS)]
    image = np.full((size, size, 3), paper, np.uint8)
    paints = [PAINTS[k] for k in rng.permutation(len(PAINTS))]
    cv2.rectangle(image, (12, 12), (size - 13, size - 13), paints[0], 5)
    heading = ("ROBOTICS", "MOMENTS", "FEATURES", "GEOMETRY", "CONTROL", "HORIZON")[kind % 6]
    draw_text(image, heading, (34, 78), 1.9, paints[0], 4)
    low, high = 105, 395
    if kind % 6 == 0:  # draw nested circles
        for _ in range(26):
            centre = tuple(int(x) for x in rng.integers((40, low + 20), (size - 40, high - 20)))
            radius = int(rng.integers(10, 52))
            cv2.circle(image, centre, radius, paints[int(rng.integers(0, 8))], -1, cv2.LINE_AA)
            cv2.circle(image, centre, radius // 2, paper, 3, cv2.LINE_AA)
    elif kind % 6 == 1:  # draw the regions in which smooth noise is above a level
        field = make_noise(rng, (high - low, size - 60), (48, 24))
        for level, paint in zip((0.35, 0.5, 0.65, 0.78), paints, strict=False):
            image[low:high, 30:size - 30][field > level] = paint
    elif kind % 6 == 2:  # draw squares of all sizes
        for _ in range(120):
            x, y = int(rng.integers(32, size - 70)), int(rng.integers(low, high - 36))
            side = int(rng.integers(6, 36))
            cv2.rectangle(image, (x, y), (x + side, y + side), paints[int(rng.integers(0, 8))],
                          -1 if rng.random() < 0.7 else 2)
    elif kind % 6 == 3:  # draw triangles
        points = rng.integers((32, low), (size - 32, high), (48, 2))
        for n in range(0, 48, 3):
            cv2.fillPoly(image, [points[n:n + 3]], paints[n // 3 % 8], cv2.LINE_AA)
    elif kind % 6 == 4:  # draw curves
        x = np.arange(40, size - 40)
        for n in range(9):
            swing = 30 + 10 * n
            y = (low + high) / 2 + swing * np.sin(x / (14 + 5 * n) + n) * np.exp(-x / 400)
            cv2.polylines(image, [np.stack([x, y], 1).astype(np.int32)], False, paints[n % 8], 3,
                          cv2.LINE_AA)
    else:  # draw hills in front of a sky
        for n, level in enumerate((0.25, 0.45, 0.62, 0.8)):
            ridge = high - (1 - level) * 260 + 60 * (make_noise(rng, (8, size), (64, 24))[4] - 0.5)
            for x in range(30, size - 30):
                image[int(ridge[x]):high, x] = paints[n]
        cv2.circle(image, (380, 160), 34, (90, 200, 245), -1, cv2.LINE_AA)
    for row in range(6):
        y, x = 420 + 12 * row, 34
        while x < size - 60:
            wide = int(rng.integers(8, 46))
            cv2.rectangle(image, (x, y), (min(x + wide, size - 36), y + 4), INK, -1)
            x += wide + 8
    return image


def draw_label(rng: np.random.Generator, words: str, kind: int) -> np.ndarray:
    """Return the texture of the printed side of a tin or a box, with `words` as its name.

    kind: number that selects the colours; it also defines the printed product number and weight.
    """
    size, back, front = PRINT_SIZE, PAINTS[kind % 8], PAPERS[kind % 4]
    share = make_noise(rng, (size, size), (64, 16))
    image = np.ascontiguousarray(
        mix_colours(share, tuple(int(0.8 * x) for x in back), tuple(min(x + 35, 255) for x in back))
    ).astype(np.uint8)
    cv2.rectangle(image, (0, 140), (size, 380), front, -1)
    for n in range(9):
        cv2.circle(image, (28 + 57 * n, 70), 20, PAINTS[(kind + n) % 8], -1, cv2.LINE_AA)
        cv2.circle(image, (28 + 57 * n, 448), 14 + n, front, 4, cv2.LINE_AA)
    draw_text(image, words, (24, 250), 2.3, back, 5)
    draw_text(image, f"No. {kind + 11}   {100 * kind + 250} g", (30, 330), 1.2)
    return image


def write_images(folder: Path) -> None:
    """Write all textures."""
    def write(name: str, image: np.ndarray) -> None:
        image = np.clip(np.rint(image), 0, 255).astype(np.uint8)
        if name.endswith(".jpg"):
            cv2.imwrite(str(folder / name), image, [cv2.IMWRITE_JPEG_QUALITY, 88])
        else:
            cv2.imwrite(str(folder / name), image, [cv2.IMWRITE_PNG_COMPRESSION, 9])

    write("boards.jpg", draw_wood(np.random.default_rng(SEED), 8))
    write("bench.jpg", draw_wood(np.random.default_rng(SEED + 1), 3))
    write("bricks.jpg", draw_bricks(np.random.default_rng(SEED + 2)))
    for n in range(6):
        write(f"poster{n}.png", draw_poster(np.random.default_rng(SEED + 10 + n), n))
    for n, words in enumerate(("SCREWS", "NUTS M4", "GREASE", "WASHERS")):
        write(f"label{n}.png", draw_label(np.random.default_rng(SEED + 20 + n), words, n))
