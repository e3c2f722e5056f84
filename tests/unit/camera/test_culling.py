"""Culling: objects outside the image are left out, and no visible object is."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import link_pose, looking, table_and_target

from aras_sim_bridge.camera import CameraConfig, CameraSensor
from aras_sim_bridge.rendering import create_renderer
from aras_sim_bridge.rendering.tiles import TILE, Tiles

LENSES = {
    "pinhole 115": dict(horizontal_fov=2.0),
    "equidistant 180": dict(lens="equidistant", horizontal_fov=np.pi),
    "equidistant 220": dict(lens="equidistant", horizontal_fov=np.radians(220)),
}


def sensor_of(bench, **settings) -> CameraSensor:
    config = CameraConfig.from_mapping({"width": 72, "height": 56, "near": 0.02, "far": 50.0,
                                        **settings})
    return CameraSensor(config, create_renderer("exact", bench.world))


def turned(rng) -> np.ndarray:
    """A unit quaternion xyzw in any direction."""
    turn = rng.normal(size=4)
    return turn / np.linalg.norm(turn)


def met(rays, T, half) -> np.ndarray:
    """Distances (N,) at which rays (N, 3) from the origin meet a box from outside, inf where they
    do not; T (4, 4) the box's pose."""
    eye, way = -T[:3, :3].T @ T[:3, 3], rays @ T[:3, :3]
    if (np.abs(eye) <= half).all():
        return np.full(len(rays), np.inf)
    with np.errstate(divide="ignore"):
        one, other = (-half - eye) / way, (half - eye) / way
    begin = np.minimum(one, other).max(axis=1)
    end = np.maximum(one, other).min(axis=1)
    return np.where((begin <= end) & (begin > 0.0), begin, np.inf)


@pytest.mark.parametrize("lens", LENSES)
def test_each_pixel_shows_the_box_that_its_ray_meets_first(bench, lens):
    """Long and short boxes all around, of which few are in view, by their slabs."""
    rng = np.random.default_rng(5)
    boxes = []
    for n in range(40):
        half = rng.uniform(0.005, 0.1, 3)
        half[n % 3] *= rng.choice([1.0, 20.0])
        model = bench.box(half, rng.uniform(-1.5, 1.5, 3), orientation=turned(rng))
        boxes.append((model.body_id, np.array(model.link_pose("link").matrix()), half))
    sensor = sensor_of(bench, **LENSES[lens])
    rays = sensor.config.projection.unproject(np.argwhere(np.ones((56, 72)))[:, ::-1].astype(float))
    wrong = compared = 0
    for _ in range(6):
        T = looking(rng.uniform(-1.0, 1.0, 3), rng.uniform(-1.0, 1.0, 3))
        view = sensor.make_view(link_pose(T))
        _, label = sensor.renderer.measure(view)
        known = np.isfinite(rays[:, 0])
        away = np.array([met(rays[known], view.optical_T_world @ box, half)
                         for _, box, half in boxes])
        near = away.argmin(axis=0)
        wanted = np.where(np.isfinite(away.min(axis=0)),
                          np.array([body for body, _, _ in boxes])[near], -1)
        drawn = np.where(label.reshape(-1)[known] >= 0, label.reshape(-1)[known] & 0xFFFFFF, -1)
        wrong += (drawn != wanted).sum()
        compared += (wanted >= 0).sum()
    assert compared > 2500
    # Within a misfit of an edge, and where near clips.
    assert wrong < 0.004 * compared, (wrong, compared)


def test_what_is_behind_the_camera_changes_no_pixel(bench):
    """Long thin beams behind it once took part in the pixels along their planes, of which crowded
    ones are drawn by samples."""
    rng = np.random.default_rng(2)
    table_and_target(bench)
    sensor = sensor_of(bench, **LENSES["pinhole 115"])
    views = []
    for _ in range(20):
        turn = rng.uniform(0, 2 * np.pi)
        T = looking([*rng.uniform(-0.1, 0.1, 2), 0.85], [*rng.uniform(-0.02, 0.02, 2), 0.59],
                    (np.cos(turn), np.sin(turn), 0.0))
        views.append(sensor.make_view(link_pose(T)))
    alone = [sensor.renderer.render(view).copy() for view in views]
    for _ in range(12):
        turn = rng.uniform(0, np.pi)
        bench.box([1.2, 0.003, 0.03], [*rng.uniform(-0.02, 0.02, 2), rng.uniform(1.4, 2.0)],
                  "Gazebo/Red", (0.0, 0.0, np.sin(turn / 2), np.cos(turn / 2)))
    for view, picture in zip(views, alone, strict=True):
        np.testing.assert_array_equal(sensor.renderer.render(view), picture)


@pytest.mark.parametrize("lens", LENSES)
def test_the_cones_around_tiles_are_around_their_rays_and_little_wider(bench, lens):
    view = sensor_of(bench, **LENSES[lens], width=320, height=240).make_view(np.eye(4))
    tiles, rays = view.get_tiles(), view.get_tiles().compute_rays()
    seen = np.isfinite(rays[..., 0])
    shown_angle = np.arccos(tiles.nodes[tiles.nodes[:, 3] < 1.5][0, 3])  # of one tile
    for (first, _, columns, _), size in zip(tiles.levels, (1, 4, 16, 64), strict=True):
        v, u = np.mgrid[:240, :320] // (TILE * size)
        cones = tiles.nodes[first + v * columns + u][seen]
        along = (rays[seen] * cones[:, :3]).sum(axis=1)
        assert (along >= cones[:, 3]).all()
        # A node's axis goes through the middle of what it shows, to a tile of it.
        node = (first + v * columns + u)[seen]
        middle = np.stack([np.bincount(node, way) for way in rays[seen].T], axis=1)[first:]
        there = np.linalg.norm(middle, axis=1) > 0.0
        middle, nodes = middle[there], tiles.nodes[first:first + len(there)][there]
        apart = np.arccos((nodes[:, :3] * middle).sum(axis=1) / np.linalg.norm(middle, axis=1))
        assert (apart < 0.1 * np.arccos(nodes[:, 3]) + shown_angle).all()
    # From the middle to the farthest pixel, and a tile more.
    shown = tiles.nodes[tiles.nodes[:, 3] < 1.5][0]
    assert np.arccos(cones[0, 3]) < np.arccos(along.min()) + 2 * np.arccos(shown[3])


@pytest.mark.parametrize("focal", [1e3, 1e5, 1e8])
def test_cones_are_known_however_narrow_they_are(focal):
    K = np.array([[focal, 0, 1e7], [0, focal / 2, -1e7], [0, 0, 1]])
    assert np.isfinite(Tiles.of_pinhole(320, 240, K).nodes).all()
