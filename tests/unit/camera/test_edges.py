"""Antialiased images, compared with very dense sampling, for any scene and size."""

import numpy as np
import pytest
from scenes import Bench, bright_renderer, looking, table_and_target
from test_accuracy import LENSES, sensor_of, target_errors

from aras_sim_bridge.camera import CameraConfig, CameraSensor
from aras_sim_bridge.description import Geometry
from aras_sim_bridge.rendering import View
from aras_sim_bridge.rendering.tiles import LARGEST_MISFIT, TILE, ExtrapolatedLens, Tiles

K = np.array([[150.0, 0, 80.3], [0, 155.0, 55.8], [0, 0, 1]])
UNLIKE = ("rational", "kannala_brandt", "equidistant_220", "orthographic")


def half_size(lens):
    """CameraConfig of one of LENSES, of 240 x 180 px."""
    settings = dict(LENSES[lens])
    if "camera_matrix" in settings:
        settings["camera_matrix"] = {k: x / 2 for k, x in settings["camera_matrix"].items()}
    return CameraConfig.from_mapping({"width": 240, "height": 180, **settings})


def clutter(bench, rng, count=12):
    """Boxes and balls all around, near and far, many through each other."""
    colours = ["Gazebo/Red", "Gazebo/Green", "Gazebo/Blue", "Gazebo/White", "Gazebo/Black"]
    for n in range(count):
        turn = rng.normal(size=4)
        bench.box(rng.uniform(0.02, 0.6, 3), rng.uniform(-1.5, 1.5, 3), colours[n % 5],
                  turn / np.linalg.norm(turn))
        bench.body(Geometry("sphere", radius=rng.uniform(0.05, 0.3)), rng.uniform(-1.5, 1.5, 3),
                   colours[(n + 2) % 5])


def test_tips_that_reach_no_corner_of_a_pixel_are_drawn(bench):
    """A square's corners poke into pixels from all four sides, over the borders of tiles too."""
    bench.box([1.5, 1.5, 0.05], [0, 0, -0.05])
    bench.box([0.05, 0.05, 1e-5], [0, 0, 0], "Gazebo/Black")
    renderer = bright_renderer(bench.world)
    rng = np.random.default_rng(8)
    lost = []
    for _ in range(30):
        turn = rng.uniform(0.0, 2 * np.pi)
        at = rng.uniform(-0.02, 0.02, 2)
        pose = looking([*at, 0.5], [*at, 0.0], (np.cos(turn), np.sin(turn), 0))
        view = View(64, 48, pose, np.array([[120.0, 0, 31.5], [0, 120.0, 23.5], [0, 0, 1]]), 0.02)
        black = (255.0 - renderer.render(view)[..., 0]).sum() / 255.0
        lost.append(24.0**2 * (0.5 / (0.5 - 1e-5)) ** 2 - black)
    assert np.abs(lost).max() < 0.12, "px²"


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_panes_before_an_edge_are_looked_through_from_far_to_near(bench, side):
    """Made in no order, seen from above or from below."""
    panes = {"Yellow": 0.15, "Red": -0.15, "Blue": 0.05, "Green": -0.05}
    for name, height in panes.items():
        bench.box([1.0, 1.0, 1e-3], [0.0, 0.0, height], f"Gazebo/{name}Transparent")
    bench.box([0.5, 0.5, 1e-3], [0.5, 0.0, -0.3 * side], "Gazebo/White")
    pose = looking([0.0, 0.0, 1.5 * side], [0.0, 0.0, 0.0], (0, 1, 0))
    K = np.array([[60.0, 0, 10.0], [0, 60.0, 5.0], [0, 0, 1]])
    renderer = bright_renderer(bench.world)
    row = renderer.render(View(21, 11, pose, K, 0.02))[5].astype(float)
    lit = 0.4 + 0.72 / np.sqrt(1.07) if side > 0.0 else 0.4
    rgb = {"Red": (1, 0, 0), "Green": (0, 1, 0), "Blue": (0, 0, 1), "Yellow": (1, 1, 0)}
    free, white = (255.0 * np.array(grey) for grey in (renderer.light.background[:3], [lit] * 3))
    ends = []
    for seen in (free, np.minimum(white, 255.0)):
        for name in sorted(panes, key=lambda name: side * panes[name]):
            seen = 0.5 * seen + 0.5 * np.minimum(255.0 * lit * np.array(rgb[name]), 255.0)
        ends.append(seen)
    middle = np.mean(ends, axis=0)
    assert row[10] == pytest.approx(middle, abs=1.5)
    assert sorted(map(tuple, row[[3, 17]])) == [pytest.approx(end, abs=1.5)
                                                for end in sorted(map(tuple, ends))]


def test_what_a_config_accepts_is_drawn(bench):
    size = 16384, 8
    table_and_target(bench)
    config = CameraConfig.from_mapping({"width": size[0], "height": size[1], "horizontal_fov": 1.0})
    sensor = CameraSensor(config, bright_renderer(bench.world))
    view = View(*size, looking([0, 0, 1.0], [0, 0, 0.59], (0, 1, 0)), config.K, 0.01)
    assert sensor.renderer.render(view).shape == (size[1], size[0], 3)


def test_edges_are_as_good_among_many_triangles(bench):
    """20 balls of 1024 triangles in the corners of the view: the target's edges do not know."""
    table_and_target(bench)
    alone, alone_area = target_errors(bright_renderer(bench.world), 6)
    for n in range(20):
        bench.body(Geometry("sphere", radius=0.02), [0.25 * np.cos(n), 0.25 * np.sin(n), 0.61],
                   "Gazebo/White")
    crowded, area = target_errors(bright_renderer(bench.world), 6)
    assert np.sqrt((alone**2).sum(axis=1).mean()) < 0.005
    assert np.abs(crowded - alone).max() < 1e-3
    assert np.abs(area - alone_area).max() < 1e-4


@pytest.mark.filterwarnings("error::RuntimeWarning")  # it may look behind itself
@pytest.mark.parametrize("lens", UNLIKE)
def test_tiles_follow_the_rays(bench, lens):
    config = half_size(lens)
    tiles = Tiles.of_lens(config.width, config.height, config.projection.unproject)
    v, u = np.mgrid[:config.height, :config.width]
    pixels = np.stack([u.ravel(), v.ravel()], axis=1).astype(float)
    rays = config.projection.unproject(pixels).reshape(config.height, config.width, 3)
    there = tiles.compute_rays()
    assert (np.isfinite(there[..., 0]) == np.isfinite(rays[..., 0])).all()
    # In pixels: by how far apart the rays of neighbours are.
    apart = np.linalg.norm(there - rays, axis=2)[:, 1:] / np.linalg.norm(np.diff(rays, axis=1),
                                                                         axis=2)
    # At its rim an orthographic lens shows any angle on a pixel.
    assert np.nanpercentile(apart, 99) < LARGEST_MISFIT
    assert np.nanmedian(apart) < LARGEST_MISFIT / 2
    # And to all sides alike: what covers some tiles is not shifted.
    rows, columns = config.height // TILE, config.width // TILE
    across = np.gradient(rays, axis=1)
    shift = ((there - rays) * across).sum(axis=2) / (across**2).sum(axis=2)
    shift = shift[:rows * TILE, :columns * TILE].reshape(rows, TILE, columns, TILE)
    assert np.nanpercentile(np.abs(shift.mean(axis=(1, 3))), 95) < 0.003


def test_rays_beyond_a_lens_s_rim_go_on_as_they_do_there_for_two_tiles():
    """Of a pinhole that ends at 30 px from its centre."""
    centre, focal = np.array([40.0, 25.0]), np.array([90.0, 60.0])

    def unproject(points):
        rays = np.column_stack([(points - centre) / focal, np.ones(len(points))])
        rays[np.hypot(*(points - centre).T) > 30.0] = np.nan
        return rays

    points = np.indices((80, 70)).reshape(2, -1).T.astype(float)
    away = np.hypot(*(points - centre).T)
    nearer = np.minimum(away, 46.0) / np.maximum(away, 1e-9)
    wanted = np.column_stack([(points - centre) / focal * nearer[:, None], np.ones(len(points))])
    wanted[away > 30.0] /= np.linalg.norm(wanted[away > 30.0], axis=1, keepdims=True)
    found = ExtrapolatedLens(unproject, centre)
    np.testing.assert_allclose(found.compute_rays(points), wanted, atol=1e-6)
    shown = np.random.default_rng(2).random((9, 10)) < 0.3
    corners, middles = found.corner_rays(shown, TILE), found.centre_rays(shown, TILE)
    v, u = np.nonzero(shown)
    np.testing.assert_allclose(middles, found.compute_rays(np.column_stack([u, v]) * 8.0 + 3.5))
    at = {(v[n] + k, u[n] + m) for n in range(len(u)) for k in (0, 1) for m in (0, 1)}
    for place in np.ndindex(10, 11):
        ray = found.compute_rays(np.array([place[::-1]]) * 8.0 - 0.5)[0]
        np.testing.assert_array_equal(corners[place], ray if place in at else [0.0, 0.0, 1.0])


@pytest.mark.parametrize("lens", ["equidistant_220", "stereographic"])
def test_tiles_as_one_cell_are_beside_their_cells_by_no_more_than_their_spread(lens):
    config = half_size(lens)
    tiles = Tiles.of_lens(config.width, config.height, config.projection.unproject)
    rays = tiles.compute_rays()
    v, u = np.nonzero(np.isfinite(rays[..., 0]))
    tile = (v // TILE) * tiles.columns + u // TILE
    x, y, w = np.einsum("nij,nj->in", tiles.inverse[tile], rays[v, u])
    known = np.isfinite(tiles.spread[tile])
    assert known.mean() > 0.9 and (w[known] > 0.0).all()
    aside = np.hypot(x / w - u % TILE, y / w - v % TILE)[known]
    assert (aside <= tiles.spread[tile][known]).all()
    assert np.median(tiles.spread[np.isfinite(tiles.spread)]) < 2.0 * aside.max()  # and little more
    assert Tiles.of_pinhole(30, 20, K).spread.max() < 1e-5


def test_what_covers_much_does_not_hide_what_covers_less_and_crosses_it(bench):
    """A plank goes through a wall that fills the view, inside one node of the tree over the tiles;
    as it is larger, the plank is noted there before the wall is noted above."""
    turn = 0.05
    wall = bench.box([0.01, 2.0, 2.0], [1.01, 0.0, 0.0])
    middle = [1.0 + 0.01 * np.cos(turn), 0.1 + 0.01 * np.sin(turn), 0.0]
    plank = bench.box([0.01, 20.0, 0.25], middle,
                      orientation=(0.0, 0.0, np.sin(turn / 2), np.cos(turn / 2)))
    config = CameraConfig.from_mapping({"horizontal_fov": np.pi / 2, "near": 0.02})
    sensor = CameraSensor(config, bright_renderer(bench.world))
    _, label = sensor.renderer.measure(sensor.make_view(np.eye(4)))
    rows = label[90:150]
    crossing = config.K[0, 2] - config.K[0, 0] * 0.1
    u = np.arange(320)
    assert (rows[:, u < crossing] == plank.body_id).all()
    assert (rows[:, u > crossing] == wall.body_id).all()
    assert (label[:70] == wall.body_id).all() and (label[170:] == wall.body_id).all()


@pytest.mark.parametrize("size", [(1, 1), (37, 41)])
@pytest.mark.parametrize("lens", ["pinhole", "plumb_bob", "equidistant_220"])
def test_pictures_have_any_size(size, lens):
    bench = Bench()
    clutter(bench, np.random.default_rng(0), 3)
    settings = {**LENSES[lens], "width": size[0], "height": size[1]}
    if "camera_matrix" in settings:
        focal = 0.5 * size[0] + 1
        settings["camera_matrix"] = [focal, focal, size[0] / 2, size[1] / 2]
    config = CameraConfig.from_mapping(settings)
    sensor = CameraSensor(config, bright_renderer(bench.world))
    view = sensor.make_view(np.eye(4))
    assert sensor.renderer.render(view).shape == (size[1], size[0], 3)
    depth, label = sensor.renderer.measure(view)
    assert depth.shape == label.shape == size[::-1]
    assert (np.isfinite(depth) == (label >= 0)).all()
    bench.close()


@pytest.mark.parametrize("lens", ["off_centre", *UNLIKE])
def test_depth_through_a_lens_is_where_the_ray_of_the_pixel_meets_the_plane(bench, lens):
    """A slanted wall 0.5 m ahead, below 0.2 mm RMS."""
    half = np.radians(15.0)
    bench.box([0.001, 30.0, 30.0], [0.5, 0.0, 0.0], "Gazebo/White",
              [0.0, np.sin(half), 0.0, np.cos(half)])
    sensor = sensor_of(half_size(lens), bench)
    config = sensor.config
    view = sensor.make_view(np.eye(4))
    depth, label = sensor.renderer.measure(view)
    v, u = np.mgrid[:config.height, :config.width]
    rays = config.projection.unproject(np.stack([u.ravel(), v.ravel()], axis=1).astype(float))
    to_world = view.world_T_optical[:3, :3]
    normal = np.array([np.cos(2 * half), 0.0, -np.sin(2 * half)])
    with np.errstate(invalid="ignore", divide="ignore"):
        length = (normal @ [0.5, 0.0, 0.0] - 0.001) / (rays @ to_world.T @ normal)
        sideways = view.lens is not None and not view.lens.forward
        expected = (length * (1.0 if sideways else rays[:, 2])).reshape(depth.shape)
        near = (label >= 0) & (expected > 0.0) & (expected < 1.5)
    assert near.mean() > 0.25
    off = depth[near] - expected[near]
    assert np.sqrt((off**2).mean()) < 2e-5
    assert np.abs(off).max() < 2e-4


def test_tiles_are_numbered_row_by_row():
    tiles = Tiles.of_pinhole(20, 12, K)
    assert (tiles.columns, tiles.rows, TILE) == (3, 2, 8)
    v, u = np.mgrid[:16, :24]
    np.testing.assert_array_equal(tiles.valid, (v < 12) & (u < 20))
    np.testing.assert_array_equal(tiles.axis, np.tile([0.0, 0.0, 1.0], (6, 1)))
    ray = tiles.matrices[4] @ np.array([3.0, 2.0, 1.0])
    np.testing.assert_allclose(ray, np.linalg.inv(K) @ [11.0, 10.0, 1.0])
