"""The numbers behind a solid's pose, worked out here by other code: where edges are in a picture's
rows and columns, their remembered levels, normal equations, and what is said of the pose."""

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from aras_visual_servo_camera.model_tracker import edge_search, pose_fitting

UNKNOWN = edge_search.UNKNOWN_LEVEL


@pytest.mark.parametrize("plain", [True, False])
def test_levels_are_remembered_edge_by_edge(plain):
    """Compiled, and as plain Python, which reads nothing beyond an array."""
    expected_levels, learn = edge_search.predict_levels, edge_search.update_levels
    if plain:
        expected_levels, learn = expected_levels.py_func, learn.py_func
    random = np.random.default_rng(3)
    edge, facing = random.integers(0, 9, 80), random.random((80, 2)) < 0.6
    values, residuals = random.uniform(0.0, 255.0, (80, 4)), random.normal(0.0, 1.0, 80)
    levels = np.where(random.random((10, 2)) < 0.5, UNKNOWN, random.uniform(0.0, 255.0, (10, 2)))
    known = expected_levels(edge, facing, levels)
    assert (known == np.where(facing, levels[edge], UNKNOWN)).all()
    renewed = levels.copy()
    learn(renewed, edge, facing, values, residuals, 0.8)
    for side in range(2):
        used = facing[:, side] & (np.abs(residuals) < 0.8)
        means = pd.Series(values[used, 1 + side]).groupby(edge[used]).mean().reindex(range(10))
        was = levels[:, side]
        wanted = np.where(was < 0.0, means, was + 0.2 * (means - was))
        np.testing.assert_allclose(renewed[:, side], np.where(means.isna(), was, wanted))


def tukey(residuals, least):
    """Weights (n,) of residuals, and which of them count."""
    scale = max(1.4826 * np.median(np.abs(residuals)), least)
    part = residuals / (4.685 * scale)
    return np.where(np.abs(part) < 1.0, (1.0 - part**2) ** 2, 0.0), scale


def moved(T, change, about, unit):
    """A pose (4, 4) after a change (v, w), w of the length `unit` times radians, about a point."""
    turn = Rotation.from_rotvec(change[3:] / unit).as_matrix()
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = turn @ T[:3, :3], about + change[:3] + turn @ (T[:3, 3] - about)
    return out


def gradient(function):
    """(n, 6) of values (n,) of a change, by differences."""
    steps = 1e-6 * np.eye(6)
    return np.stack([(function(s) - function(-s)) / 2e-6 for s in steps], axis=1)


T = np.eye(4)
T[:3, :3] = Rotation.from_euler("xyz", (2.4, 0.3, -0.5)).as_matrix()
T[:3, 3] = (0.02, -0.03, 0.5)
ABOUT, UNIT = np.array([0.01, -0.02, 0.45]), 0.07


def test_the_equations_of_edges_are_those_of_their_residuals():
    random = np.random.default_rng(7)
    at, gain = random.uniform(-0.1, 0.1, (60, 3)), random.normal(0.0, 500.0, (60, 2))
    at[5] = T[:3, :3].T @ ((0.0, 0.0, -0.1) - T[:3, 3])  # behind the camera

    def seen(pose):
        p = at @ pose[:3, :3].T + pose[:3, 3]
        return p[:, :2] / p[:, 2:]

    near = seen(T) + random.normal(0.0, 0.002, (60, 2))
    away = random.normal(0.0, 3.0, (60, 3))
    away[random.random(away.shape) < 0.3] = np.nan
    away[7], away[11:15] = np.nan, 60.0
    weight = random.uniform(0.5, 2.0, 60)
    A, b, residuals = pose_fitting.build_edge_equations(
        at, near, gain, away, weight, T, ABOUT, UNIT, 0.3
    )
    now = (gain * (seen(T) - near)).sum(axis=1)
    left = pd.DataFrame(away - now[:, None])
    wanted = np.array([min(row.dropna(), key=abs, default=np.nan) for _, row in left.iterrows()])
    wanted[5] = np.nan
    np.testing.assert_allclose(residuals, wanted)
    used = np.isfinite(wanted)
    w, _ = tukey(wanted[used], 0.3)
    J = gradient(lambda c: (gain * seen(moved(T, c, ABOUT, UNIT))).sum(axis=1))[used]
    w *= weight[used]
    assert 3 < (w == 0.0).sum() < 20
    np.testing.assert_allclose(A, J.T @ (w[:, None] * J), rtol=1e-5, atol=1e-6 * A.max())
    np.testing.assert_allclose(b, J.T @ (w * wanted[used]), rtol=1e-5)


def test_a_ray_beside_a_face_does_not_meet_it():
    """Along its plane, to the last digit."""
    corners, face = np.array([(-0.1, 0.5, 0.3), (-0.1, 0.0, 1.5), (-0.1, -0.5, 0.3)]), [[0, 1, 2]]
    rays, counts = np.column_stack([np.zeros(5), np.linspace(-0.4, 0.4, 5), np.full(5, 0.5)]), []
    for rays[:, 0] in (0.0, -0.2):
        counts.append(pose_fitting.build_surface_equations(
            corners, np.array(face), np.array([(1.0, 0.0, 0.0)]), rays, np.eye(4), np.zeros(3), 1.0,
            1.0)[2])
    assert counts[0] == 0 < counts[1]


@pytest.mark.parametrize(("strength", "slips", "is_open"), [
    ((9e4, 8e4, 7e4, 6e4, 5e4, 4.5e4), 0, False), ((9e8, 8e8, 7e8, 6e8, 5e8, 1.0), 0, True),
    ((9e8, 8e8, 7e8, 6e8, 5e8, -1.0), 1, False), ((9e8, 8e8, 7e8, 6e8, 1.0, 0.0), 1, True)])
@pytest.mark.parametrize("spread", [0.01, 0.3])
def test_a_pose_is_known_as_well_as_its_points_fit(strength, slips, is_open, spread):
    random = np.random.default_rng(10)
    basis = np.linalg.qr(random.normal(size=(6, 6)))[0]
    A = (basis * strength) @ basis.T
    residuals, weight = random.normal(0.0, spread, 50), random.uniform(300.0, 900.0, 50)
    residuals[:5], residuals[7] = (1.5, -2.0, 1.01, 4.0, -1.2), np.nan
    found = pose_fitting.assess_pose(residuals, weight, A, slips, 0.07)
    count, rms, excess, covariance, opened = found
    used = np.abs(residuals) < 1.0
    assert count == used.sum() == 44
    assert rms == pytest.approx(np.sqrt(np.mean(residuals[used]**2)))
    chi = max((weight * residuals**2)[used].sum() / (count - 6), 1.0)
    assert excess == pytest.approx(chi)
    unit = np.array([1.0] * 3 + [0.07] * 3)
    variance = [min(chi / s, 1e4) if s > 0.0 else 1e4 for s in strength]
    # A direction whose strength is next to none is told to some digits of the greatest.
    wanted = (basis * variance) @ basis.T / np.outer(unit, unit)
    np.testing.assert_allclose(covariance, wanted, rtol=1e-5, atol=1e-6 * np.abs(wanted).max())
    assert opened == (is_open or (slips == 0 and min(strength) < chi / 5e-3**2))


def test_a_pose_of_few_points_is_not_known_better_than_by_noise():
    for residual, expected in ((0.5, (4, 0.5, 8.0)), (2.0, (0, np.inf, 1.0))):
        found = pose_fitting.assess_pose(np.full(4, residual), np.full(4, 8.0), np.eye(6), 0, 0.1)
        assert found[:3] == expected
