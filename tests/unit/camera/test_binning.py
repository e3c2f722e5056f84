"""Triangles that are assigned to each tile of an image, compared with rays through its pixels."""

import numpy as np
import pytest
from scenes import looking
from test_recomputed import AT, EYE, things

from aras_sim_bridge.rendering import Lighting, View, create_renderer
from aras_sim_bridge.rendering.binning import TileBinning
from aras_sim_bridge.rendering.scene import Scene
from aras_sim_bridge.rendering.tiles import TILE
from aras_sim_bridge.rendering.triangles import Triangles

LIGHT = Lighting(direction=(-0.5, 0.4, -0.8), ambient=0.3, diffuse=0.9)
# Over 16 tiles wide or high: three levels of tiles joined 4 x 4, the last ones in part.
VIEWS = {"wide": ((195, 61), (150.0, 140.0, 88.2, 33.1)),
         "high": ((75, 170), (170.0, 160.0, 31.2, 90.4))}


@pytest.fixture
def seen_of(bench, tmp_path):
    """The things of test_recomputed, a wall behind them with a board through it, one aside."""
    things(bench, tmp_path)
    bench.box([3.0, 0.01, 0.5], [0.0, 0.9, 0.3], "Gazebo/Red", (0.0, 0.02, 0.14, 0.99))
    bench.box([2.0, 0.01, 2.0], [0.0, 0.9, 0.0], "Gazebo/Grey", (0.0, 0.0, 0.1, np.sqrt(0.99)))
    bench.box([0.01, 3.0, 3.0], [-0.8, 0.0, 0.0], "Gazebo/Grey", (0.1, 0.0, 0.0, np.sqrt(0.99)))
    renderer = create_renderer("exact", bench.world, LIGHT)

    def seen(name, near=0.02, far=50.0):
        (width, height), (fx, fy, cx, cy) = VIEWS[name]
        K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
        view = View(width, height, looking(EYE, AT, (0.2, 0.1, 1.0)), K, near, far)
        return renderer, view, renderer.sample(view, 1.0, 0.0).visible

    return seen


@pytest.mark.parametrize(("near", "far"), [(0.02, 50.0), (0.4, 1.1)])
def test_triangles_are_in_the_camera_s_frame_and_cut_at_near_and_far(seen_of, near, far):
    """Their light: test_recomputed.py."""
    renderer, view, seen = seen_of("wide", near, far)
    g, T = renderer.triangles, view.optical_T_world @ renderer.scene.read_poses()
    own = T[g.row[seen.triangle]]
    corners = np.einsum("nij,nkj->nki", own[:, :3, :3], g.corners[seen.triangle])
    corners += own[:, None, :3, 3]
    np.testing.assert_allclose(seen.corner, corners, atol=1e-12)
    # Shares of the corners: 1 at their own, 0 at the others.
    shares = np.einsum("nij,nkj->nik", seen.side, corners)
    np.testing.assert_allclose(shares, np.tile(np.eye(3), (len(own), 1, 1)), atol=1e-6)
    away = 1.0 / np.linalg.norm(seen.side.sum(axis=1), axis=1)
    cut = np.linalg.norm(corners, axis=2).max(axis=1) > far
    assert (seen.cut == (cut | (away < near * view.get_tiles().widest))).all()
    assert (seen.opaque == (g.albedo[seen.triangle, 3] >= 1.0)).all()
    assert 0 < seen.cut.sum() < len(seen.cut)


@pytest.mark.parametrize("name", VIEWS)
def test_tiles_list_what_their_rays_meet_first_and_little_else(seen_of, name):
    renderer, view, seen = seen_of(name)
    tiles, g = view.get_tiles(), renderer.triangles
    plane, part = seen.side.sum(axis=1), g.part[seen.triangle]
    side, listed, aside = seen.side.reshape(-1, 3), 0, 0
    # Half pixels of a tile, its border included, and half a tile around it.
    x, y = (a.ravel() - 4.5 for a in np.meshgrid(np.arange(18.0), np.arange(18.0)))
    inner = (np.abs(x - 3.5) <= 4.0) & (np.abs(y - 3.5) <= 4.0)
    for n, M in enumerate(tiles.matrices):
        shares = (side @ M @ np.stack([x, y, np.ones_like(x)])).reshape(-1, 3, len(x))
        there, ahead = (shares >= 0.0).all(axis=1), shares.sum(axis=1)
        members, full = (a[seen.start[n]:seen.start[n + 1]] for a in (seen.member, seen.full))
        assert (np.diff(members) > 0).all()
        cover = [seen.cover[n]] if seen.cover[n] >= 0 else []
        assert seen.opaque[cover].all() and not seen.cut[cover].any()
        known = np.zeros(inner.sum())
        for m in [*members[full], *cover]:
            # It covers the tile, alone or with the other half of its quad.
            quad = (part == part[m]) & (np.abs(plane - plane[m]).max(axis=1) < 1e-6)
            assert there[quad][:, inner].any(axis=0).all()
            known = np.maximum(known, ahead[m, inner] * seen.opaque[m])
        # What is nearest somewhere is listed, or covers the tile.
        first = np.where(there & seen.opaque[:, None], ahead, 0.0)[:, inner]
        known = np.maximum(known, first[members].max(axis=0, initial=0.0))
        shown = (n % tiles.columns * TILE + x[inner] < view.width) & (
            n // tiles.columns * TILE + y[inner] < view.height)
        assert (known >= first.max(axis=0) * (1.0 - 1e-9))[shown].all()
        listed, aside = listed + len(members), aside + (~there[members].any(axis=1)).sum()
    assert listed > 300 and aside < 0.1 * listed and (seen.cover >= 0).mean() > 0.9


def test_a_pane_before_all_of_a_picture_is_listed_in_each_of_its_tiles(bench):
    """16 x 16 of them, so that each node of the tree over them has as many as it can."""
    bench.box([0.01, 1.0, 1.2], [1.0, 0.1, 0.0], "Gazebo/GreyTransparent", (0.1, 0.0, 0.0, 0.99))
    scene = Scene(bench.world)
    scene.refresh()
    view = View(128, 128, looking([0.0, 0.0, 0.0], [1.0, 0.0, 0.0]),
                np.array([[150.0, 0.0, 70.2], [0.0, 140.0, 60.4], [0.0, 0.0, 1.0]]))
    seen = TileBinning(Triangles.from_visuals(scene.visuals)).find_visible(
        view.get_tiles(), view.optical_T_world @ scene.read_poses(), np.array([[0.0, 0.0, 1.0]]),
        np.array([0.4, 0.8]), 0.02, 50.0)
    assert (np.diff(seen.start) >= 1).all() and len(seen.start) == 257
    assert not seen.opaque.any() and (seen.cover < 0).all()
