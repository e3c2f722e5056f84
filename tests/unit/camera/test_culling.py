"""Culling: objects outside the image are left out, and no visible object is."""

import numpy as np
import pytest
from scenes import link_pose, looking
from scipy.spatial.transform import Rotation

from aras_sim_bridge.camera import CameraConfig, CameraSensor
from aras_sim_bridge.rendering import create_renderer
from aras_sim_bridge.rendering.tiles import Tiles

LENSES = {
    "pinhole 115": dict(horizontal_fov=2.0),
    "equidistant 180": dict(lens="equidistant", horizontal_fov=np.pi),
    "equidistant 220": dict(lens="equidistant", horizontal_fov=np.radians(220)),
}


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
        turn = Rotation.random(random_state=n).as_quat()
        model = bench.box(half, rng.uniform(-1.5, 1.5, 3), orientation=turn)
        boxes.append((model.body_id, np.array(model.link_pose("link").matrix()), half))
    config = CameraConfig.from_mapping({"width": 72, "height": 56, "far": 50.0, "near": 0.02,
                                        **LENSES[lens]})
    sensor = CameraSensor(config, create_renderer("exact", bench.world))
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


@pytest.mark.parametrize("focal", [1e3, 1e5, 1e8])
def test_cones_are_known_however_narrow_they_are(focal):
    K = np.array([[focal, 0, 1e7], [0, focal / 2, -1e7], [0, 0, 1]])
    assert np.isfinite(Tiles.of_pinhole(320, 240, K).nodes).all()
