"""The numbers behind a solid's pose, worked out here by other code: where edges are in a picture's
rows and columns, their remembered levels, normal equations, and what is said of the pose."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from aras_visual_servo_camera.model_tracker import edge_search, pose_fitting

UNKNOWN = edge_search.UNKNOWN_LEVEL
# px that an edge may be off where it is measured, and from where it was expected; and part of the
# contrast by which the pixels of one level may differ.
SLACK, FARTHEST, UNEVEN = 0.35, 1.5, 0.35


def pictures():
    """Yield grey images with edges: shaded stripes with noise at all angles, and noise alone."""
    random = np.random.default_rng(4)
    v, u = np.mgrid[:70, :90]
    for angle, pitch, noise in ((0.1, 17.0, 0.0), (0.9, 23.0, 2.0), (1.9, 14.0, 0.0),
                                (2.6, 31.0, 5.0)):
        across = (u * np.cos(angle) + v * np.sin(angle)) / pitch
        stripes = np.clip((across % 1.0 - 0.5) * pitch + 0.5, 0.0, 1.0)
        grey = 60.0 + 90.0 * stripes + 9.0 * np.sin(0.09 * u) + random.normal(0.0, noise, u.shape)
        yield np.clip(np.rint(grey), 0, 255).astype(np.uint8), angle
    yield random.integers(0, 255, u.shape).astype(np.uint8), 0.4


def places(angle, random, count=80):
    """Return points (n, 2) in and next to an image, and normals, mostly along an angle."""
    pixel = random.uniform(-2.0, (92.0, 72.0), (count, 2))
    turn = np.where(random.random(count) < 0.6, angle, random.uniform(0.0, 2 * np.pi, count))
    turn += np.pi * random.integers(0, 2, count) + random.normal(0.0, 0.05, count)
    return pixel, np.column_stack([np.cos(turn), np.sin(turn)])


def levels_asked(random, count):
    """(n, 2) expected grey levels, many of them unknown."""
    levels = random.choice([70.0, 150.0], (count, 2))
    return np.where(random.random((count, 2)) < 0.6, UNKNOWN, levels)


def searched(grey, pixel, normal):
    """The row or column that is searched for a point: its levels, where in it the edge is expected,
    the normal along it; None outside of the picture."""
    k = int(abs(normal[1]) > abs(normal[0]))
    line = int(np.rint(pixel[1 - k]))
    if not 0 <= line < grey.shape[k]:
        return None
    here = pixel[k] - (line - pixel[1 - k]) * normal[1 - k] / normal[k]
    return (grey.T if k else grey)[line].astype(float), here, normal[k]


def agree(levels, along, expected, tolerance):
    """Return whether levels (left, right) agree with the expected ones on both sides of an edge."""
    sides = levels[::-1] if along > 0.0 else levels
    return all(want < 0.0 or abs(is_ - want) <= tolerance
               for is_, want in zip(sides, expected, strict=True))


def steepest(levels, here, along, expected, reach, least, tolerance):
    """Places of steepest change, px along the normal, the nearest four first."""
    span, middle = int(reach / abs(along)) + 1, int(np.rint(here))
    inner = np.arange(max(middle - span, 2), min(middle + span, len(levels) - 4) + 1)
    change = np.full(len(levels), np.nan)
    change[inner] = np.abs(levels[inner + 1] + levels[inner + 2]
                           - levels[inner] - levels[inner - 1]) / 2
    found = []
    for i in inner[1:-1]:
        if change[i] < least or change[i] < change[i - 1] or change[i] <= change[i + 1]:
            continue
        if not agree((levels[i - 2:i].mean(), levels[i + 2:i + 4].mean()), along, expected,
                     tolerance):
            continue
        a, b, _ = np.polyfit([-1.0, 0.0, 1.0], change[i - 1:i + 2], 2)
        found.append((i + 0.5 - b / (2.0 * a) - here) * along)
    found = sorted(found, key=abs)[:4]
    return np.array(found + [np.nan] * (4 - len(found)))


@pytest.mark.parametrize(("reach", "least"), [(4.0, 20.0), (12.0, 8.0)])
def test_edges_are_looked_for_where_rows_and_columns_change_most(reach, least):
    random, full = np.random.default_rng(1), 0
    for grey, angle in pictures():
        pixel, normal = places(angle, random)
        expected = levels_asked(random, len(pixel))
        found = edge_search.find_candidates(grey, pixel, normal, expected, reach, least, 30.0)
        wanted = np.full(found.shape, np.nan)
        for n in range(len(pixel)):
            line = searched(grey, pixel[n], normal[n])
            if line is not None:
                wanted[n] = steepest(*line, expected[n], reach, least, 30.0)
        np.testing.assert_allclose(found, wanted, atol=1e-9)
        full += np.isfinite(found[:, -1]).sum()
    assert full > 5


def edge_at(levels, here, along, slope, room, expected, least, tolerance, noise):
    """px along the normal, levels on its side and on the other, variance; NaN where there is
    none."""
    none, place = np.full(4, np.nan), here
    for _ in range(3):
        half = 0.5 * (1.0 + slope) + SLACK
        first, end = int(np.ceil(place - half)), int(np.floor(place + half)) + 1
        # Pixels of an even level: up to the next edges, whose own changes are as wide.
        before = min(3, int(first - here + room[0] - 0.5 - 0.5 * slope))
        behind = min(3, int(here + room[1] - 0.5 - 0.5 * slope - end + 1.0))
        if min(before, behind) < 1 or first < before or end + behind > len(levels):
            return none
        a, b = levels[first - before:first], levels[end:end + behind]
        left, right = a.mean(), b.mean()
        if abs(right - left) < least:
            return none
        spread = max(abs(a - left).max(), abs(b - right).max())
        shaded = max(spread - 3.0 * noise, 0.0)
        if shaded > 0.0:
            left = a[-1] + (0.5 * (a[-1] - a[-2]) if before > 1 else 0.0)
            right = b[0] + (0.5 * (b[0] - b[1]) if behind > 1 else 0.0)
        contrast = right - left
        if abs(contrast) < least or spread > UNEVEN * abs(contrast) + 3.0 * noise:
            return none
        was, place = place, first - 0.5 + ((right - levels[first:end]) / contrast).sum()
        if abs(place - here) > FARTHEST:
            return none
        if abs(place - was) < 0.3 * SLACK:
            break
    if not agree((left, right), along, expected, tolerance):
        return none
    sides = (right, left) if along > 0.0 else (left, right)
    many = end - first
    variance = (many + 0.5 * many**2 / min(before, behind)) * ((noise + shaded) / contrast)**2
    return np.array([(place - here) * along, *sides, variance * along**2])


@pytest.mark.parametrize("noise", [0.0, 2.0])
def test_edges_are_measured_by_the_sum_of_levels_over_their_change(noise):
    random, found_any = np.random.default_rng(2), 0
    for grey, angle in pictures():
        rough, normal = places(angle, random, 200)
        near = edge_search.find_candidates(
            grey, rough, normal, np.full((200, 2), UNKNOWN), 9.0, 12.0, 1.0
        )
        pixel = np.ascontiguousarray(rough + (np.nan_to_num(near[:, :1]) + random.normal(
            0.0, 0.5, (200, 1))) * normal)
        room, expected = random.uniform(0.0, 14.0, (200, 2)), levels_asked(random, 200)
        found = edge_search.measure_edges(grey, pixel, normal, room, expected, 12.0, 30.0, noise)
        wanted = np.full(found.shape, np.nan)
        for n in range(len(pixel)):
            line = searched(grey, pixel[n], normal[n])
            if line is not None:
                slope = np.abs(normal[n]).min() / np.abs(normal[n]).max()
                wanted[n] = edge_at(*line, slope, room[n], expected[n], 12.0, 30.0, noise)
        np.testing.assert_allclose(found, wanted, atol=1e-9)
        found_any += np.isfinite(found[:, 0]).sum()
    assert 100 < found_any < 600


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


@pytest.mark.parametrize("size", [(5, 40), (23, 31), (60, 80)])
def test_noise_is_told_by_rows_all_over_the_picture(size):
    grey = np.random.default_rng(6).integers(0, 256, size).astype(np.uint8)
    grey[:, ::3] //= 2
    rows = grey[::max(size[0] // 8, 1)].astype(int)
    bends = np.abs(2 * rows[:, 1:-1] - rows[:, :-2] - rows[:, 2:])
    assert edge_search.estimate_noise(grey) == pytest.approx(
        1.4826 * np.median(bends) / np.sqrt(6.0)
    )


def test_the_noise_of_a_row_that_bends_in_half_its_pixels_is_half_of_that():
    grey = np.array([[10, 10, 10, 14, 18, 18]], np.uint8)  # by 0, 4, 0, 4
    assert edge_search.estimate_noise(grey) == pytest.approx(1.4826 * 2.0 / np.sqrt(6.0))
    assert edge_search.estimate_noise(grey[:, :2]) == 0.0


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


@pytest.mark.parametrize(("wide", "exact", "open_ways", "off"), [
    (3.0, 0.3, 0, 2e-3), (3.0, 0.3, 1, 2e-3), (0.3, 0.3, 0, 2e-3), (0.3, 0.3, 0, 1e-7),
    (9.0, 1e-3, 0, 1e-7),
])  # fmt: skip
def test_a_pose_is_fitted_by_steps_that_end_where_it_is_still(wide, exact, open_ways, off):
    """Six at most, of scales each three tenths of the last; none ends before it is exact."""
    random = np.random.default_rng(11)
    at, gain = random.uniform(-0.1, 0.1, (60, 3)), random.normal(0.0, 500.0, (60, 2))
    middle, true = np.array([0.01, -0.02, 0.03]), moved(T, off * np.ones(6), T[:3, 3], UNIT)
    p, q = (at @ pose[:3, :3].T + pose[:3, 3] for pose in (T, true))
    near, seen = p[:, :2] / p[:, 2:], q[:, :2] / q[:, 2:]
    away = ((gain * (seen - near)).sum(axis=1) + 0.05 * random.normal(size=60))[:, None]
    away[::9] += 40.0
    weight, slips = random.uniform(0.5, 2.0, 60), np.eye(6)[:open_ways]
    none, faces = np.zeros((1, 3)), np.zeros((1, 3), np.int64)
    found = pose_fitting.fit_pose(at, near, gain, away, weight, T, wide, exact, middle, UNIT, slips,
                           none, faces, none, np.zeros((0, 3)))  # fmt: skip
    pose, least, turned = T.copy(), wide, np.zeros(3)
    focal, first = np.hypot(*gain[0]), T[:3, :3] @ middle + T[:3, 3]
    for step in range(7):
        about = pose[:3, :3] @ middle + pose[:3, 3]
        A, b, residuals = pose_fitting.build_edge_equations(
            at, near, gain, away, weight, pose, about, UNIT, least)
        for slip in slips:
            pose_fitting._remove_motion(A, b, np.concatenate([pose[:3, :3] @ slip[:3],
                                                   pose[:3, :3] @ slip[3:]]))
        if step == 6:
            break
        change = np.linalg.solve(A + np.eye(6) / (0.1 * UNIT) ** 2, b)
        pose, turned = moved(pose, change, about, UNIT), turned + change[3:]
        size = np.linalg.norm(change[:3]) + np.linalg.norm(change[3:])
        if least == exact and focal * size < 0.01 * about[2]:
            break
        least = max(0.3 * least, exact)
    total = np.linalg.norm(about - first) + np.linalg.norm(turned)
    np.testing.assert_allclose(found[0], pose, atol=1e-9)
    assert found[1] == pytest.approx(focal * total / about[2], rel=1e-6, abs=1e-9)
    np.testing.assert_allclose(found[2], residuals, atol=1e-6)
    np.testing.assert_allclose(found[3], A, rtol=1e-6, atol=1e-9 * A.max())


def test_the_equations_of_a_depth_image_are_those_of_its_distances():
    """Of a tetrahedron, whose faces are met by rays one by one."""
    random = np.random.default_rng(8)
    vertices = np.array([(0.1, 0.0, -0.02), (-0.06, 0.09, 0.0), (-0.05, -0.08, 0.01),
                         (0.0, 0.01, 0.11)])
    faces = np.array([(0, 1, 3), (1, 2, 3), (2, 0, 3), (0, 2, 1)])
    a, b, c = vertices[faces].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    measured = np.column_stack([random.uniform(-0.2, 0.3, (400, 2)), np.full(400, 0.5)])
    P, turned = vertices @ T[:3, :3].T + T[:3, 3], normals @ T[:3, :3].T
    on = np.full(400, -1)
    for n, (x, y, _) in enumerate(measured):
        ray, nearest = np.array([x, y, 1.0]), np.inf
        for f, face in enumerate(faces):
            shares = np.linalg.solve(P[face].T, ray)
            if (shares > 0.0).all() and turned[f] @ ray < 0.0 and 1.0 / shares.sum() < nearest:
                nearest, on[n] = 1.0 / shares.sum(), f
        if on[n] >= 0:
            measured[n, 2] = nearest + random.normal(0.0, 0.002) + 0.2 * (n % 9 == 0)
    X = measured * [1.0, 1.0, 0.0] + [0.0, 0.0, 1.0]
    X = (X * measured[:, 2:])[on >= 0]
    normal, point = turned[on[on >= 0]], P[faces[on[on >= 0], 0]]
    r = (normal * (X - point)).sum(axis=1)
    for least in (1e-4, 0.02):
        w, scale = tukey(r, least)
        J = np.hstack([normal, np.cross((X - ABOUT) / UNIT, normal)])
        A, b, count = pose_fitting.build_surface_equations(
            vertices, faces, normals, measured, T, ABOUT, UNIT, least
        )
        w /= scale**2
        assert count == (w > 0.0).sum() and 30 < count < len(r)
        np.testing.assert_allclose(A, J.T @ (w[:, None] * J), rtol=1e-8, atol=1e-8 * A.max())
        np.testing.assert_allclose(b, J.T @ (w * r), rtol=1e-8)


def test_a_ray_beside_a_face_does_not_meet_it():
    """Along its plane, to the last digit."""
    corners, face = np.array([(-0.1, 0.5, 0.3), (-0.1, 0.0, 1.5), (-0.1, -0.5, 0.3)]), [[0, 1, 2]]
    rays, counts = np.column_stack([np.zeros(5), np.linspace(-0.4, 0.4, 5), np.full(5, 0.5)]), []
    for rays[:, 0] in (0.0, -0.2):
        counts.append(pose_fitting.build_surface_equations(
            corners, np.array(face), np.array([(1.0, 0.0, 0.0)]), rays, np.eye(4), np.zeros(3), 1.0,
            1.0)[2])
    assert counts[0] == 0 < counts[1]


def test_a_pose_is_turned_about_the_solids_middle():
    middle = np.array([0.02, -0.01, 0.05])
    for turn in ((0.3, -0.2, 0.7), (0.0, 0.0, 0.0), (1e-9, 2e-9, 0.0), (0.0, 3.0, 0.5)):
        found = pose_fitting._update_pose(T, np.array(turn), ABOUT, middle)
        wanted = Rotation.from_rotvec(turn).as_matrix() @ T[:3, :3]
        np.testing.assert_allclose(found[:3, :3], wanted, atol=1e-12)
        np.testing.assert_allclose(found[:3, :3] @ middle + found[:3, 3], ABOUT)
        assert found[3].tolist() == [0.0, 0.0, 0.0, 1.0]


def test_what_is_left_out_of_equations_is_projected_away():
    random = np.random.default_rng(9)
    J, slip = random.normal(size=(9, 6)), random.normal(size=6)
    slip /= np.linalg.norm(slip)
    A, b, keep = J.T @ J, random.normal(size=6), np.eye(6) - np.outer(slip, slip)
    wanted = keep @ A @ keep, keep @ b
    pose_fitting._remove_motion(A, b, slip)
    np.testing.assert_allclose(A, wanted[0], atol=1e-12)
    np.testing.assert_allclose(b, wanted[1], atol=1e-12)


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
    count, rms, excess, covariance, opened = pose_fitting.assess_pose(
        residuals, weight, A, slips, 0.07
    )
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
    count, rms, excess, _, _ = pose_fitting.assess_pose(
        np.full(4, 0.5), np.full(4, 8.0), np.eye(6), 0, 0.1
    )
    assert (count, rms, excess) == (4, 0.5, 8.0)
    count, rms, excess, _, _ = pose_fitting.assess_pose(
        np.full(4, 2.0), np.full(4, 8.0), np.eye(6), 0, 0.1
    )
    assert (count, rms, excess) == (0, np.inf, 1.0)
