"""What is left out of a picture is not seen in it, and tiles show what their pixels show."""

import numpy as np
import pytest
from scenes import looking
from test_accuracy import LENSES, SIZE

from aras_sim_bridge.camera import CameraConfig, CameraSensor
from aras_sim_bridge.description import Geometry
from aras_sim_bridge.rendering import View, create_renderer
from aras_sim_bridge.rendering.faces import whole
from aras_sim_bridge.rendering.lens_tiles import LensTiles
from aras_sim_bridge.rendering.outlines import Outlines
from aras_sim_bridge.rendering.refinement import TILE, tile_origins

K = np.array([[150.0, 0, 80.3], [0, 155.0, 55.8], [0, 0, 1]])


def clutter(bench, rng):
    """Boxes and balls all around, near and far."""
    for _ in range(12):
        turn = rng.normal(size=4)
        bench.box(rng.uniform(0.02, 0.6, 3), rng.uniform(-1.5, 1.5, 3),
                  orientation=turn / np.linalg.norm(turn))
        ball = Geometry("sphere", radius=rng.uniform(0.05, 0.3))
        bench.body(ball, rng.uniform(-1.5, 1.5, 3))


def test_every_triangle_that_faces_the_eye_in_view_is_kept(bench):
    rng = np.random.default_rng(3)
    clutter(bench, rng)
    renderer = create_renderer("opengl", bench.world)
    kept = left_out = 0
    for _ in range(20):
        eye = rng.uniform(-2, 2, 3)
        view = View(160, 120, looking(eye, rng.uniform(-0.5, 0.5, 3)), K, 0.02)
        T, _ = renderer._prepare(view, 1.0)
        c, visibility = renderer._geometry.clusters, renderer._geometry.visibility
        few, many = (visibility.in_view(whole(view), T, most) for most in (10**9, 0))
        pose = T[c.tri_row]
        p = np.einsum("nij,nkj->nki", pose[:, :3, :3], c.corners) + pose[:, None, :3, 3]
        front = np.einsum("ni,ni->n", np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), p[:, 0]) < 0
        middle = p.mean(axis=1)
        pixel = middle[:, :2] / middle[:, 2:] @ K[:2, :2] + K[:2, 2]
        inside = (pixel > 0).all(axis=1) & (pixel < [159, 119]).all(axis=1)
        seen = np.flatnonzero(front & inside & (middle[:, 2] > 0.02))
        if few.backdrop is None:
            assert np.isin(seen, few.triangle).all()
            first, count = c.first[many.cluster], c.count[many.cluster]
            own = [np.arange(f, f + n) for f, n in zip(first, count, strict=True)]
            assert np.isin(seen, np.concatenate(own)).all()
        kept += len(seen)
        left_out += len(c.corners) - len(few.triangle)
    assert kept > 1000
    assert left_out > 3 * kept


def test_rectangles_get_the_triangles_that_reach_into_them():
    rng = np.random.default_rng(0)
    near = 0.1
    corners = rng.uniform([-2, -2, -0.5], [2, 2, 3], (300, 3, 3))
    low = rng.uniform(-1, 1, (40, 2))
    high = low + 0.1
    rectangle, triangle = Outlines.of(corners, near).overlapping(low, high)
    found = np.zeros((40, 300), bool)
    found[rectangle, triangle] = True
    weight = rng.dirichlet((1, 1, 1), 4000)
    points = np.einsum("sk,nki->nsi", weight, corners)
    ahead = points[..., 2] > near
    q = points[..., :2] / np.where(ahead, points[..., 2], 1.0)[..., None]
    for n in range(40):
        hit = (ahead & (q > low[n]).all(axis=2) & (q < high[n]).all(axis=2)).any(axis=1)
        assert not (hit & ~found[n]).any()
        assert hit.sum() > 0.4 * found[n].sum(), "many are beside the rectangle"


def test_a_sliver_beside_a_rectangle_is_told_apart():
    sliver = np.array([[[-1.0, -1.0, 1.0], [1.0, 1.0, 1.0], [1.0, 0.99, 1.0]]])
    low, high = np.array([[0.2, -0.3], [0.2, 0.15]]), np.array([[0.3, -0.2], [0.3, 0.25]])
    rectangle, _ = Outlines.of(sliver, 0.1).overlapping(low, high)
    assert rectangle.tolist() == [1]


@pytest.mark.parametrize("lens", [name for name in LENSES if name not in ("pinhole", "off_centre")])
def test_tiles_of_a_lens_follow_its_rays(bench, lens):
    config = CameraConfig.from_mapping({"width": SIZE[0], "height": SIZE[1], **LENSES[lens]})
    rays = CameraSensor(config, create_renderer("tiny", bench.world))._lens
    tiles = LensTiles(rays, 0.02, 10.0)
    number = np.flatnonzero(tiles.usable)
    assert len(number) > 0.7 * rays.valid.sum() / TILE**2
    matrix = tiles.faces(number, 4, -(-len(number) // 4)).rotation
    u, v = tile_origins(*SIZE)[number].T
    across = np.arange(TILE)
    own = rays.rays[(v[:, None] + across)[:, :, None], (u[:, None] + across)[:, None, :]]
    there = np.einsum("nij,nvuj->nvui", matrix, own)
    goal = (2 * across + 1) / TILE - 1
    error = there[..., :2] / there[..., 2:] - np.stack(np.meshgrid(goal, goal), axis=2)
    distance = np.linalg.norm(error, axis=3) * TILE / 2
    distance = distance[np.isfinite(distance)]
    assert np.sqrt((distance**2).mean()) < 0.02
    assert distance.max() <= 0.08
    np.testing.assert_allclose(np.linalg.norm(matrix[:, 2], axis=1), 1.0)
