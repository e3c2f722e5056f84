"""Pictures of which only the parts around outlines are drawn look like those drawn whole."""

import numpy as np
import pytest
from scenes import looking

from aras_sim_bridge.rendering import View, create_renderer
from aras_sim_bridge.rendering.faces import whole
from aras_sim_bridge.rendering.outlines import Outlines
from aras_sim_bridge.rendering.recent import Recent
from aras_sim_bridge.rendering.refinement import TILE
from aras_sim_bridge.rendering.regions import BLOCK, Regions, _boxes

SIZE = 320, 240
K = np.array([[300.0, 0, 158.3], [0, 302.0, 121.8], [0, 0, 1]])


def seen_from(eye, at, turn=0.0) -> View:
    return View(*SIZE, looking(eye, at, (np.cos(turn), np.sin(turn), 0)), K, 0.02)


def whole_picture(renderer, view, monkeypatch) -> np.ndarray:
    with monkeypatch.context() as patch:
        patch.setattr(Regions, "around", lambda *_: None)
        return renderer.render(view)


@pytest.mark.parametrize("table", [True, False])
def test_picture_is_that_drawn_whole(bench, monkeypatch, table):
    if table:
        bench.box([3.0, 3.0, 0.05], [0, 0, 0.5], "Gazebo/Wood")
    places = {"Black": (-0.15, 0.1), "Red": (0.1, -0.12), "Blue": (0.3, 0.3)}
    for name, (x, y) in places.items():
        bench.box([0.03, 0.04, 0.02], [x, y, 0.57], f"Gazebo/{name}",
                  orientation=(0, 0, 0.3, 0.954))
    renderer = create_renderer("opengl", bench.world)
    drawn, parts = [], []
    around, picture = Regions.around, renderer._picture
    monkeypatch.setattr(Regions, "around", lambda *a: parts.append(around(*a)) or parts[-1])
    monkeypatch.setattr(renderer, "_picture",
                        lambda *a, **k: drawn.append(a[1]) or picture(*a, **k))
    rng = np.random.default_rng(0)
    differing = 0
    for _ in range(60):
        eye = np.array([*rng.uniform(-0.3, 0.3, 2), rng.uniform(0.9, 1.4)])
        view = seen_from(eye, [*(eye[:2] + rng.uniform(-0.2, 0.2, 2)), 0.55], rng.uniform(0, 6))
        drawn.clear()
        ours = renderer.render(view)
        if parts[-1] is not None:
            assert SIZE not in drawn
        theirs = whole_picture(renderer, view, monkeypatch)
        difference = np.abs(ours.astype(int) - theirs).max(axis=2)
        # Some tiles at the rectangles' borders are drawn finer without need, and so more exactly.
        assert np.count_nonzero(difference) <= 20 and difference.max() <= 32
        differing += np.count_nonzero(difference)
    assert differing < 60
    used = [part for part in parts if part is not None]
    assert len(used) > 40
    assert max(len(part.rows) for part in used) >= 3


@pytest.mark.parametrize("table", [True, False])
def test_nothing_but_background_is_not_drawn_at_all(bench, monkeypatch, table):
    if table:
        bench.box([3.0, 3.0, 0.05], [0, 0, 0.5], "Gazebo/Green")
    renderer = create_renderer("opengl", bench.world)
    view = seen_from([0, 0, 1.2], [0.1, 0, 0.55])
    whole = whole_picture(renderer, view, monkeypatch)
    monkeypatch.setattr(renderer, "_picture", None)
    picture = renderer.render(view)
    assert np.array_equal(picture, whole)
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) == 1


def test_sizes_that_are_no_whole_tiles_and_full_pictures_are_drawn_whole(bench):
    view = seen_from([0, 0, 1.2], [0.1, 0, 0.55])
    small = Outlines.of(np.array([[[0.0, 0, 1], [0.01, 0, 1], [0, 0.01, 1]]]), 0.02)
    large = Outlines.of(np.array([[[-1.0, -1, 1], [2, 0, 1], [0, 2, 1]]]), 0.02)
    assert Regions.around(small, view) is not None
    assert Regions.around(large, view) is None
    columns = np.arange(-1.5, 1.5, 0.05)
    strips = np.array([[[x, -1.0, 1.0], [x, 1.0, 1.0], [x + 1e-4, 1.0, 1.0]] for x in columns])
    huge = View(9600, 4800, view.world_T_optical, np.diag([2400.0, 2400, 1]) + [[0, 0, 4800],
                [0, 0, 2400], [0, 0, 0]], 0.02)
    assert Regions.around(Outlines.of(strips[:3], 0.02), huge) is None, "three of 4800 rows"
    assert Regions.around(Outlines.of(strips[:1], 0.02), huge).atlas_size == (64, 4800)
    odd = View(SIZE[0] + 1, SIZE[1], view.world_T_optical, K, 0.02)
    assert Regions.around(small, odd) is None


def test_rectangles_hold_every_coloured_pixel_and_its_neighbours():
    rng = np.random.default_rng(1)
    view = seen_from([0, 0, 1.2], [0.1, 0, 0.55])
    found = 0
    for _ in range(200):
        corners = rng.uniform([-0.7, -0.6, 1.0], [0.7, 0.6, 1.0], (3, 1, 3))
        corners = corners + np.append(rng.uniform(-0.05, 0.05, (3, 3, 2)), np.zeros((3, 3, 1)), 2)
        outlines = Outlines.of(corners, 0.02)
        outlines = outlines.of_some(outlines.within(*whole(view).window()))
        regions = Regions.around(outlines, view)
        if regions is None:
            continue
        found += 1
        inside = np.zeros(SIZE[::-1], int)
        for (u, v), (w, h) in zip(regions.origins, regions.sizes, strict=True):
            assert u % TILE == v % TILE == w % TILE == h % TILE == 0
            inside[v:v + h, u:u + w] += 1
        assert inside.max() <= 1
        u, v = np.meshgrid(*map(np.arange, SIZE))
        for low_x, low_y, high_x, high_y in outlines.bounds:
            x, y = (u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1]
            px, py = 1 / K[0, 0], 1 / K[1, 1]
            near = (x > low_x - px) & (x < high_x + px) & (y > low_y - py) & (y < high_y + py)
            assert inside[near].all()
    assert found > 100


def test_boxes_are_apart_and_cover():
    rng = np.random.default_rng(2)
    for share in (0.02, 0.1, 0.3):
        for _ in range(50):
            touched = (rng.random((15, 20)) < share).astype(np.uint8)
            covered = np.zeros((17, 22), int)
            boxes = _boxes(touched.copy())
            for u, v, w, h in boxes:
                assert not covered[v:v + h + 2, u:u + w + 2].any(), "two boxes touch"
                covered[v + 1:v + h + 1, u + 1:u + w + 1] = 1
            assert covered[1:-1, 1:-1][touched > 0].all()


def test_pixels_of_the_atlas_find_their_place():
    regions = Regions(np.array([[64, 32], [0, 160]]), np.array([[32, 64], [64, 32]]),
                      np.array([0, 64]), (64, 128))
    some, place = regions.in_picture(np.array([[0, 0], [24, 56], [32, 0], [56, 88], [0, 96]]))
    assert some.tolist() == [0, 1, 3]
    assert place.tolist() == [[64, 32], [88, 88], [56, 184]]
    assert BLOCK % TILE == 0


def test_recent_keeps_what_was_used_last_and_releases_the_rest():
    released, made = [], []
    recent = Recent(2, released.append)
    for key in "abaca":
        assert recent.get(key, lambda key=key: made.append(key) or key.upper()) == key.upper()
    assert made == ["a", "b", "c"]
    assert released == ["B"]
