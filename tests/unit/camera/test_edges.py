"""Antialiased images, compared with very dense sampling, for any scene and size."""

import numpy as np
import pytest
from scenes import bright_renderer, looking
from test_accuracy import LENSES

from aras_sim_bridge.camera import CameraConfig, CameraSensor
from aras_sim_bridge.description import Geometry
from aras_sim_bridge.rendering import View
from aras_sim_bridge.rendering.tiles import Tiles


@pytest.mark.parametrize(("size", "lens"), [
    ((1, 1), "pinhole"), ((1, 1), "plumb_bob"), ((37, 41), "equidistant_220"),
    ((16384, 8), "pinhole"),
])
def test_pictures_have_any_size(bench, size, lens):
    bench.box([0.1, 0.2, 0.3], [0.6, 0.1, 0.0], "Gazebo/Red", (0.0, 0.3, 0.2, np.sqrt(0.87)))
    bench.body(Geometry("sphere", radius=0.2), [0.8, -0.1, 0.1])
    settings = {**LENSES[lens], "width": size[0], "height": size[1]}
    if "camera_matrix" in settings:
        settings["camera_matrix"] = [1.5, 1.5, 0.5, 0.2]
    sensor = CameraSensor(CameraConfig.from_mapping(settings), bright_renderer(bench.world))
    view = sensor.make_view(np.eye(4))
    assert sensor.renderer.render(view).shape == (size[1], size[0], 3)
    depth, label = sensor.renderer.measure(view)
    assert depth.shape == label.shape == size[::-1]
    assert (np.isfinite(depth) == (label >= 0)).all() and ((label >= 0).any() or size == (1, 1))


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


@pytest.mark.parametrize("focal", [1e3, 1e5, 1e8])
def test_cones_are_known_however_narrow_they_are(focal):
    K = np.array([[focal, 0, 1e7], [0, focal / 2, -1e7], [0, 0, 1]])
    assert np.isfinite(Tiles.of_pinhole(320, 240, K).nodes).all()
