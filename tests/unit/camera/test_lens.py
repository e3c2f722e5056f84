"""Lens models, compared with their inverses, and at their limits."""

import numpy as np
import pytest

from aras_sim_bridge.camera.lens import (
    LARGEST_ANGLE,
    RADIUS_FUNCTION,
    BrownLens,
    FisheyeLens,
    fit_fisheye,
)


@pytest.mark.parametrize("seed", range(20))
def test_the_fold_is_where_the_radius_stops_growing(seed):
    random = np.random.default_rng(seed)
    k = random.uniform(-0.15, 0.15, 6)
    lens = BrownLens((k[0], k[1], 0.0, 0.0, k[2], k[3], k[4], k[5]))
    fold = lens.fold_radius()
    r = np.linspace(1e-3, 0.9999 * min(fold, 4.0), 4000)
    out = lens.project(np.stack([r, 0.0 * r, 0.0 * r + 1.0], axis=1))[:, 0]
    assert (np.diff(out) > 0.0).all(), "it grows up to there"
    if fold < 4.0:
        beyond = fold * np.array([0.999, 1.0, 1.001])
        with np.errstate(all="ignore"):  # at a pole
            near = lens.project(np.stack([beyond, 0.0 * beyond, 0.0 * beyond + 1.0], axis=1))[:, 0]
        turned = near[1] > near[0] and near[1] > near[2]
        pole = near[0] * near[2] < 0.0 or abs(near[1]) > 100.0
        assert turned or pole


def test_brown_has_no_ray_beyond_the_fold():
    lens = BrownLens((-0.3, 0.0, 0.0, 0.0, 0.0))
    fold = lens.fold_radius()
    assert fold == pytest.approx(np.sqrt(1 / 0.9))
    largest = fold * (1 - 0.3 * fold**2)
    inside, outside = lens.unproject(np.array([[0.99 * largest, 0.0], [1.01 * largest, 0.0]]))
    assert np.isfinite(inside).all() and np.isnan(outside).all()
    # Beyond a second fold the radius grows again: those rays land where others did before.
    lens = BrownLens((-0.9, 0.3, 0.0, 0.0, 0.0))
    beyond = np.column_stack([np.linspace(0.45, 2.0, 20), np.zeros(20)])
    assert lens.project(np.array([[lens.fold_radius(), 0.0, 1.0]]))[0, 0] < 0.45
    assert np.isnan(lens.unproject(beyond)).all()
    # And a ray from the side or from behind is nowhere in the image.
    rays = np.array([[0.1, 0.2, z] for z in (1.0, 0.0, -1.0)])
    assert np.isfinite(lens.project(rays)[:, 0]).tolist() == [True, False, False]


@pytest.mark.parametrize(("D", "cutoff"), [
    ((0.02, -0.01, 0.003, -0.0005), 110.0),
    ((0.48, -0.18, 0.18, -0.06), 85.9),
    ((0.39, 0.15, -0.09, 0.0), np.degrees(1.5)),  # or to and fro between the same two angles
    ((-0.4, 0.09, 0.02, 0.0), 86.0),  # of slopes that send Newton's method out of the picture
])  # fmt: skip
def test_fisheye_unprojection_inverts_projection_behind_the_camera_too(D, cutoff):
    lens = FisheyeLens(D, np.radians(cutoff))
    theta = np.append(np.linspace(0.0, np.radians(cutoff - 0.1), 199), 1.01)
    turn = np.linspace(0.0, 20.0, 200)
    expected = np.stack([np.sin(theta) * np.cos(turn), np.sin(theta) * np.sin(turn),
                         np.cos(theta)], axis=1)
    np.testing.assert_allclose(lens.unproject(lens.project(expected)), expected, atol=1e-9)
    edge = float(lens.radius(np.radians(cutoff)))
    assert np.isnan(lens.unproject(np.array([[edge * 1.001, 0.0]]))).all()


@pytest.mark.parametrize("name", [n for n in RADIUS_FUNCTION if n != "pinhole"])
def test_published_coefficients_describe_the_ideal_projection(name):
    theta = np.linspace(0.0, LARGEST_ANGLE[name], 500)
    lens = FisheyeLens(fit_fisheye(name, LARGEST_ANGLE[name]), LARGEST_ANGLE[name])
    assert np.abs(lens.radius(theta) - RADIUS_FUNCTION[name](theta)).max() < 1e-4
