"""Objects thinner than a pixel darken it by the area that they cover."""

import numpy as np
import pytest
from scenes import BRIGHT, looking

from aras_sim_bridge.description import Geometry
from aras_sim_bridge.rendering import View, create_renderer

FOCAL = 100.0  # px; the eye is 1 m above what it looks at
K = np.array([[FOCAL, 0, 23.5], [0, FOCAL, 19.5], [0, 0, 1.0]])
SIZE = 48, 40
LONG = 24.0  # px
ANGLES = np.arange(8) * np.pi / 8 + 0.013 * np.arange(8)
PLACES = np.random.default_rng(5).uniform(-0.5, 0.5, (6, 2))


def view_at(place, angle) -> View:
    """A view straight down, turned by an angle and shifted by a place (2,), px."""
    up = (np.sin(angle), np.cos(angle), 0.0)
    x, y = np.array(place) / FOCAL
    return View(*SIZE, looking([x, y, 1.0], [x, y, 0.0], up), K, 0.02)


def half_plane(a, b, c):
    """The area of pixels (around 0) in which a + b x + c y >= 0."""
    p = np.maximum(np.maximum(np.abs(b), np.abs(c)), 1e-300)
    q = np.maximum(np.minimum(np.abs(b), np.abs(c)), 1e-7 * p)
    s = a + (p + q) / 2
    square = [np.maximum(s - back, 0.0)**2 for back in (0.0, p, q, p + q)]
    return (square[0] - square[1] - square[2] + square[3]) / (2 * p * q)


def strip_of(view, wide):
    """Shares (rows, columns) of pixels in a strip along the world's x axis, NaN near its ends."""
    T = view.world_T_optical
    v, u = np.mgrid[:SIZE[1], :SIZE[0]]
    turn = T[:2, :2]  # the eye looks straight down: pixels to metres and back are a turn
    x, y = np.tensordot(turn, [u - K[0, 2], v - K[1, 2]], axes=1) + FOCAL * T[:2, 3, None, None]
    b, c = turn[1]
    share = half_plane(wide / 2 + y, b, c) + half_plane(wide / 2 - y, -b, -c) - 1.0
    share[np.abs(x) > LONG / 2 - 1.5] = np.nan
    return share


def covered(renderer, view, body) -> float:
    """Area that a body covers, px, before anything is rounded."""
    one = renderer.sample(view, 1.0, -0.5)
    edges, fragments = renderer.resolve(one, view)
    rows = renderer.triangles.row[one.visible.triangle]
    mine = renderer.scene.compute_labels()[rows] == body.body_id
    area = float(fragments.share[mine[fragments.member]].sum())
    width = one.canvas.tiles.columns
    for n, tile in enumerate(one.samples.tile):
        v, u = 8 * (n // width), 8 * (n % width)
        shown = (one.samples.pixel[v:v + 8, u:u + 8] if tile == -3 else np.full((8, 8), tile))
        whole = (shown >= 0) & mine[np.maximum(shown, 0)]
        bits = edges[n] >> np.arange(64, dtype=np.uint64).reshape(8, 8) & np.uint64(1)
        area += float((whole & (bits == 0)).sum())
    return area


def wire(bench, wide, height=0.0):
    """A black wire along x, `wide` and LONG px, whose upper side is at a height."""
    half = [LONG / FOCAL / 2, wide / FOCAL / 2, 1e-6]
    return bench.box(half, [0, 0, height - 1e-6], "Gazebo/Black")


@pytest.mark.parametrize(("wide", "behind"), [
    (0.1, "floor"), (0.5, "floor"), (2.0, "floor"), (0.1, "grid"), (0.1, "round")])
def test_a_wire_covers_its_area_wherever_it_lies(bench, wide, behind):
    """Also over wires that cross under many angles, and of many triangles."""
    bench.box([1.5, 1.5, 0.05], [0, 0, -0.16])
    for n in range(40 if behind == "grid" else 0):
        turn = 0.3 + 0.07 * n
        bench.box([0.5, 0.0007, 1e-6], [0.0031 * (n - 20), 0, -0.01 - 0.002 * n], "Gazebo/Red",
                  (0.0, 0.0, np.sin(turn / 2), np.cos(turn / 2)))
    if behind == "round":
        shape = Geometry("cylinder", radius=wide / 2 / FOCAL, length=LONG / FOCAL)
        body = bench.body(shape, colour="Gazebo/Black", orientation=(0, 1, 0, 1) / np.sqrt(2.0))
    else:
        body = wire(bench, wide)
    renderer = create_renderer("exact", bench.world, BRIGHT)
    for angle in ANGLES:
        for place in PLACES:
            view = view_at(place, angle)
            assert covered(renderer, view, body) == pytest.approx(LONG * wide, rel=0.02)
            if behind == "floor":
                off = 255.0 - renderer.render(view)[..., 0] - 255.0 * strip_of(view, wide)
                assert np.nanmax(np.abs(off)) <= 0.55, (angle, place)


@pytest.mark.parametrize("wide", [0.1, 0.5])
def test_through_a_slit_one_sees_what_is_behind(bench, wide):
    """Between two white plates, a black floor or the sky."""
    half = 0.5 * wide / FOCAL
    for side in (-1, 1):
        plate = Geometry("plane", size=(1.0, 0.5, 0.0))  # whose sides nobody sees
        bench.body(plate, [0, side * (half + 0.25), 0.0])
    renderer = create_renderer("exact", bench.world, BRIGHT)
    for sky in (True, False):
        if not sky:
            bench.box([1.5, 1.5, 0.05], [0, 0, -0.06], "Gazebo/Black")
        for angle in ANGLES:
            for place in PLACES[:3]:
                view = view_at(place, angle)
                dark = 255.0 - renderer.render(view)[..., 0]
                depth = 255.0 * (1 - 0.7) if sky else 255.0
                off = dark - depth * strip_of(view, wide)
                assert np.nanmax(np.abs(off)) <= 0.55, (sky, angle, place)
