"""Textures on inclined surfaces, compared with the mean of 576 samples per pixel."""

import numpy as np
import pytest
from wall import aslant, blocks, errors, wall

from aras_sim_bridge.rendering import Lighting, View, create_renderer

K = np.array([[300.0, 0.0, 161.3], [0.0, 310.0, 117.2], [0.0, 0.0, 1.0]])
FLAT = Lighting(ambient=1.0, diffuse=0.0)
# Towards +x, -x, +y, -y and between them; the rows of the picture across the slant and along it.
VIEWS = [(0.0, 0.0), (np.pi, 0.0), (np.pi / 2, 0.0), (-np.pi / 2, 0.0), (0.0, np.pi / 2),
         (np.pi / 2, -np.pi / 2), (0.7, 0.7), (2.4, -0.8)]


@pytest.mark.parametrize(("angle", "most", "roll", "turn"), [
    (*slant, *view)
    for i, slant in enumerate([(0.0, 1.6), (60.0, 2.0), (80.0, 2.0), (87.0, 4.0)])
    for j, view in enumerate(VIEWS) if (i + j // 2) % 2 == 0
])
def test_a_pixel_shows_the_mean_of_what_it_covers(bench, tmp_path, angle, most, roll, turn):
    pixels = blocks(8)
    wall(bench, tmp_path, pixels)
    view = View(320, 240, aslant(np.radians(angle), roll, turn, 2.5), K)
    picture = create_renderer("exact", bench.world, FLAT).render(view)
    off = errors(pixels, view, picture)
    assert len(off) > 100
    assert np.sqrt((off**2).mean()) <= most
    assert abs(off.mean()) < 0.5
