"""Compiled functions of the renderer, run as plain Python on random numbers."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aras_sim_bridge.rendering import (
    areas,
    binning,
    cones,
    dense_coverage,
    depth_and_labels,
    edge_detection,
    edges,
    sampling,
    shadows,
    textures,
)
from aras_sim_bridge.rendering.areas import LINES, PLANE
from aras_sim_bridge.rendering.dense_coverage import FINE
from aras_sim_bridge.rendering.lamps import (
    COLOUR,
    FADE,
    KIND,
    PLACE,
    RADIUS,
    WIDTH,
    direction_to_lamp,
)
from aras_sim_bridge.rendering.shading import pack_colour

ROUND = np.arange(FINE)
# Hammersley's points: rows by the bits of the column turned round.
SAMPLES = np.column_stack([(ROUND + 0.5) / FINE,
                           [(int(f"{n:05b}"[::-1], 2) + 0.5) / FINE for n in ROUND]]) - 0.5
SIGNS = np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, -1).T


@pytest.fixture
def rng():
    before = np.seterr(all="ignore")
    yield np.random.default_rng(11)
    np.seterr(**before)


def unit(rng, count=None):
    v = rng.normal(size=(count, 3) if count else 3)
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def posed(rng, reach=1.0):
    T = np.eye(4)
    T[:3, :3] = Rotation.random(random_state=int(rng.integers(1 << 30))).as_matrix()
    T[:3, 3] = reach * rng.normal(size=3)
    return T


def cone(axis, angle):
    return np.array([[*axis, np.cos(angle), np.sin(angle)]])


# -- boxes, triangles and cones --------------------------------------------------------------------


def test_a_box_is_off_a_cone_where_its_corners_are_behind_it_or_beyond_its_side(rng):
    off = cones.is_box_outside.py_func
    found = []
    for _ in range(400):
        T, axis, angle = posed(rng), unit(rng), rng.uniform(0.05, 1.4)
        centre, half = rng.normal(size=(1, 3)), rng.uniform(0.01, 0.5, (1, 3))
        corners = (centre + SIGNS * half) @ T[:3, :3].T + T[:3, 3]
        middle = T[:3, :3] @ centre[0] + T[:3, 3]
        aside = middle - (middle @ axis) * axis
        side = np.cos(angle) * aside / np.linalg.norm(aside) - np.sin(angle) * axis
        wanted = (corners @ axis).max() <= 0.0 or (corners @ side).min() > 0.0
        assert off(T[None], 0, centre, half, 0, cone(axis, angle), 0) == wanted
        found.append(wanted)
    assert 100 < sum(found) < 350
    assert not off(T[None], 0, centre, half, 0, cone(axis, np.pi / 2 + 1e-9), 0)


def test_cones_are_beside_each_other_where_the_angle_between_them_is_larger_than_both(rng):
    beside = cones.is_cone_disjoint.py_func
    for _ in range(200):
        (one, other), (a, b) = unit(rng, 2), rng.uniform(0.05, 2.0, 2)
        apart = np.arccos(one @ other)
        assert beside(*one, np.cos(a), np.sin(a), cone(other, b), 0) == (apart > a + b)
    assert beside(*one, 1.0, 0.0, np.array([[*one, 2.0, 0.0]]), 0)  # that shows nothing


def sided(corners):
    """side (1, 3, 3) and its squared lengths of a triangle with these corners (3, 3)."""
    side = np.linalg.inv(corners).T[None]
    return side, (side**2).sum(axis=2)


def test_a_cone_is_beyond_or_within_the_sides_of_a_triangle(rng):
    seen = set()
    for _ in range(300):
        side, length2 = sided(rng.normal(size=(3, 3)) + [0.0, 0.0, 2.0])
        axis, angle = unit(rng), 10 ** rng.uniform(-2.5, -0.3)
        # How far its axis is from the plane of each side, above it.
        above = np.arcsin(side[0] @ axis / np.sqrt(length2[0]))
        nodes = cone(axis, angle)
        beyond, inside = (above < -angle).any(), (above[1:] >= angle).all()
        assert cones.is_outside.py_func(side, length2, 0, nodes, 0) == beyond
        assert bool(cones.is_within.py_func(side, length2, 0, nodes, 0)) == inside
        seen.add((beyond, inside))
    assert len(seen) == 4
    wide = cone(axis, 1.7)
    assert not cones.is_outside.py_func(side, length2, 0, wide, 0)
    assert not cones.is_within.py_func(side, length2, 0, wide, 0)


def test_of_a_cluster_s_triangles_those_that_touch_a_cone_are_bits(rng):
    touching = cones.find_touching.py_func
    for count in (1, 8, 9, 21):
        work, there, through = np.zeros((12, 4, 8)), 0, 0
        axis, angle = unit(rng), 0.2
        for k in range(count):
            side, length2 = sided(rng.normal(size=(3, 3)) + 2.0 * axis)
            work[:9, k // 8, k % 8], work[9:, k // 8, k % 8] = side.reshape(-1), length2[0]
            above = np.arcsin(side[0] @ axis / np.sqrt(length2[0]))
            there |= int((above >= -angle).all()) << k
            through |= int((np.abs(above) <= angle).any()) << k
        found = touching(work, count, cone(axis, angle), 0)
        mask = (1 << count) - 1
        assert (found[0] & mask, found[1] & mask) == (there, through)
        assert touching(work, count, cone(axis, 1.7), 0)[0] & mask == mask


def test_of_two_triangles_one_is_nearer_in_all_of_a_cone_or_neither_is(rng):
    seen = []
    for _ in range(200):
        planes, axis = rng.normal(size=(2, 3)) * [1.0, 0.3, 0.3], unit(rng)
        angle = rng.uniform(0.05, 1.0)
        difference = planes[0] - planes[1]
        above = np.arcsin(difference @ axis / np.linalg.norm(difference))
        wanted = 0 if abs(above) <= angle else int(np.sign(above))
        assert cones.compare_depth.py_func(planes, 0, 1, cone(axis, angle), 0) == wanted
        seen.append(wanted)
    assert set(seen) == {-1, 0, 1}
    ahead = np.array([2.0 * axis, axis])
    assert cones.compare_depth.py_func(ahead, 0, 1, cone(axis, 1.5), 0) == 1
    # it sees backwards too
    assert cones.compare_depth.py_func(ahead, 0, 1, cone(axis, 1.6), 0) == 0
    same = np.array([axis, axis])  # one on the other
    assert cones.compare_depth.py_func(same, 0, 1, cone(axis, 0.3), 0) == 0


def test_a_point_in_a_pixel_stands_before_its_triangle_by_more_the_farther_it_is(rng):
    matrices = np.array([[[2.0, 0.1, 0.2], [-0.1, 1.5, 0.3], [0.05, 0.2, 1.0]]])
    x, y = 0.3, -0.2
    ray = matrices[0] @ (x, y, 1.0)
    for distance in (0.02, 3.0, 80.0):
        normal, there = unit(rng), distance * ray / np.linalg.norm(ray)
        normal *= np.sign(normal @ ray)
        corners = there + np.cross(normal, rng.normal(size=(3, 3)))
        side, p, g = np.linalg.inv(corners.T)[None], np.empty(3), np.empty(3)
        assert shadows._find_surface_point.py_func(matrices, 0, side, 0, x, y, p, g)
        off = shadows.OFF + shadows.OFF_FAR * np.abs(there).sum()
        assert g == pytest.approx(-normal)
        assert (p - there) @ g == pytest.approx(off, rel=1e-3)
        assert not shadows._find_surface_point.py_func(matrices, 0, -side, 0, x, y, p, g)


def test_pairs_are_sorted_by_tile_and_by_number_in_each(rng):
    tile = rng.integers(0, 7, 60)
    tile[tile == 3] = 5
    member, full = rng.permutation(60), rng.random(60) < 0.5
    start, members, fulls = binning._sort_by_tile.py_func(tile, member, full, 50, 8)
    order = np.lexsort([member[:50], tile[:50]])
    np.testing.assert_array_equal(members, member[order])
    np.testing.assert_array_equal(fulls, full[order])
    np.testing.assert_array_equal(start, np.searchsorted(tile[order], np.arange(9)))


def test_a_triangle_s_box_is_around_its_corners_in_the_tile(rng):
    inverse = rng.normal(size=(2, 3, 3))
    for _ in range(50):
        corner = rng.normal(size=(2, 3, 3))
        u, v, w = inverse[1] @ corner[1].T
        if (w > 0.0).all():
            wanted = (u / w).min(), (u / w).max(), (v / w).min(), (v / w).max()
        else:
            wanted = -np.inf, np.inf, -np.inf, np.inf
        assert sampling._find_box.py_func(corner, 1, inverse, 1) == pytest.approx(wanted)
    for u, v, beside in ((-1.0, 0.0, True), (0.0, -1.0, True), (0.05, 0.0, False)):
        corner = np.tile([u, v, 1e-7], (1, 3, 1))  # it is seen a million pixels aside
        left = sampling._find_box.py_func(corner, 0, np.eye(3)[None], 0)[0]
        assert (left == -np.inf) == beside


def test_a_triangle_is_before_the_plane_of_another_or_through_it(rng):
    found = []
    for _ in range(100):
        corner = rng.normal(size=(2, 3, 3)) * 0.7 + [0.0, 0.0, 2.0]
        side = np.linalg.inv(corner).swapaxes(1, 2)
        normal = np.cross(corner[1, 1] - corner[1, 0], corner[1, 2] - corner[1, 0])
        eye, own = -corner[1, 0] @ normal, (corner[0] - corner[1, 0]) @ normal
        wanted = (own * eye >= 0.0).all()
        assert edges._is_before.py_func(corner, side, 0, 1) == wanted
        assert edges._is_before.py_func(corner, side, 1, 1)  # its own, to the last digits
        found.append(wanted)
    assert 10 < sum(found) < 90


# -- areas in a pixel ------------------------------------------------------------------------------


def pieces(rng, count):
    """line (count, LINES + 1, 3) of triangles around a pixel, all of them nearer or farther by how
    they tilt; lines (count,)."""
    line, lines = np.zeros((count, LINES + 1, 3)), np.full(count, 3)
    for k in range(count):
        turn = rng.uniform(0, 2 * np.pi) + np.array([0.0, 2.1, 4.2])
        line[k, :3] = np.column_stack([rng.uniform(0.05, 0.6, 3), np.cos(turn), np.sin(turn)])
        line[k, PLANE] = rng.uniform(1.0, 2.0), *rng.normal(size=2)
    cut = rng.integers(count)
    lines[cut] = 5
    line[cut, 3:5] = [[0.2, 0.9, 0.1], [0.3, -0.2, -0.7]]
    return line, lines


def above(line, lines, k, points):
    """(N,) whether points (N, 2) are in triangle k, and one over its distance there."""
    at = np.column_stack([np.ones(len(points)), points])
    return (at @ line[k, :lines[k]].T >= 0.0).all(axis=1), at @ line[k, PLANE]


def test_samples_count_what_each_triangle_covers_and_shows(rng):
    for left, solid in ((7, 7), (7, 5), (6, 1)):
        line, lines = pieces(rng, 9)
        here = rng.permutation(9)[:left]
        sliver = np.zeros(9, bool)
        sliver[here[1]] = True
        x0, y0 = 0.3, -0.2
        work, counts = np.empty((3, FINE), np.float32), np.full((left, 2), np.nan)
        farthest = dense_coverage.sample_pixel.py_func(
            here, line, lines, sliver, x0, y0, left, solid, work, counts)
        depth, shows, points = np.zeros(FINE), np.full(FINE, -1), SAMPLES + (x0, y0)
        for n, k in enumerate(here):
            there, w = above(line, lines, k, points)
            ahead = there & (w > depth)
            if n == 1:
                assert counts[n, 0] == -1.0
                continue
            assert counts[n, 0] == there.sum()
            if n < solid:
                depth, shows = np.where(ahead, w, depth), np.where(ahead, n, shows)
            else:
                assert counts[n, 1] == ahead.sum()
        np.testing.assert_array_equal(counts[:solid, 1], [(shows == n).sum() for n in range(solid)])
        assert farthest == pytest.approx(depth.min(), rel=1e-6)
        n = int(np.argmax(counts[:solid, 1]))
        middle = np.zeros((left, 2))
        dense_coverage.compute_sample_mean.py_func(work, n, (shows == n).sum(), middle)
        assert middle[n] == pytest.approx(SAMPLES[shows == n].mean(axis=0))


def test_rows_say_the_area_above_lines_and_its_middle(rng):
    at = (np.arange(300) + 0.5) / 300 - 0.5
    points = np.array(np.meshgrid(at, at)).reshape(2, -1).T
    for _ in range(12):
        line, lines = pieces(rng, 1)
        lines[0] = 3
        there, _ = above(line, lines, 0, points)
        middle = np.full((2, 2), np.nan)
        area = dense_coverage.integrate_rows.py_func(
            line, 3, np.empty((3, FINE), np.float32), middle, 1
        )
        assert area == pytest.approx(there.mean(), abs=4e-3)
        if area > 0.05:
            assert middle[1] == pytest.approx(points[there].mean(axis=0), abs=6e-3)


def test_a_point_is_hidden_by_what_lies_before_it_there(rng):
    found = []
    for _ in range(100):
        line, lines = pieces(rng, 5)
        here, counts = np.array([3, 0, 4, 1, 2]), np.ones((5, 2))
        counts[1, 0] = -1.0  # a sliver hides nothing
        point = rng.uniform(-0.4, 0.4, (1, 2))
        own = above(line, lines, here[4], point)[1]
        wanted = any(there[0] and w[0] > own[0] for there, w in (
            above(line, lines, here[n], point) for n in (0, 2)))
        assert (
            dense_coverage.is_hidden.py_func(here, line, lines, counts, 4, 3, *point[0]) == wanted
        )
        found.append(wanted)
    assert 20 < sum(found) < 90


def test_a_line_cuts_a_pixel_by_its_area(rng):
    at = (np.arange(400) + 0.5) / 400 - 0.5
    x, y = np.meshgrid(at, at)
    for a, b, c in [*rng.normal(size=(20, 3)) * [0.3, 1.0, 1.0], (0.1, 1.0, 0.0), (0.2, 0.0, -1.0),
                    (2.0, 1.0, 0.5), (-2.0, 1.0, 0.5)]:
        assert areas.half_plane_area.py_func(a, b, c) == pytest.approx(
            (a + b * x + c * y > 0.0).mean(), abs=3e-3)


# -- light -----------------------------------------------------------------------------------------


def test_two_ways_square_to_one_are_of_length_one(rng):
    for d in [*unit(rng, 20), np.array([1.0, 0, 0]), np.array([0.0, 0.6, 0.8])]:
        e = np.empty((2, 3))
        shadows._make_basis.py_func(d, e)
        frame = np.stack([*e, d])
        np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(frame) == pytest.approx(1.0)


def test_a_ray_is_aimed_at_a_place_on_its_lamp_s_disc(rng):
    d, far, p = unit(rng), 2.5, rng.normal(size=3)
    e, ray = np.empty((2, 3)), np.empty(3)
    shadows._make_basis.py_func(d, e)
    lamps = rng.normal(size=(3, WIDTH))
    lamps[:, KIND], lamps[:, RADIUS] = (1, 0, 2), (0.1, 0.2, 0.3)
    for n, (length, reach) in enumerate(((far, 1.0), (1.0, np.inf), (far, 1.0))):
        end = shadows._aim_ray.py_func(lamps, n, p, d, far, e, 0.3, -0.7, ray)
        assert end == reach
        np.testing.assert_allclose(ray, length * d + lamps[n, RADIUS] * (0.3 * e[0] - 0.7 * e[1]))


def test_a_beam_meets_the_boxes_that_its_axis_meets_once_they_are_as_much_larger(rng):
    found = []
    for _ in range(300):
        T, point = posed(rng), rng.normal(size=3)
        far = rng.choice([1.0, 3.0, np.inf])
        centre, half = rng.normal(size=(2, 3)), rng.uniform(0.02, 0.4, (2, 3))
        d = T[:3, :3] @ centre[1] + T[:3, 3] - point + 0.4 * rng.normal(size=3)
        d /= np.linalg.norm(d)
        radius, growth = rng.uniform(0.0, 0.2), rng.choice([0.0, 0.1])
        ahead = (T[:3, :3] @ centre[1] + T[:3, 3] - point) @ d + np.linalg.norm(half[1])
        room = half[1] + radius + growth * np.clip(ahead, 0.0, far)
        o, s = T[:3, :3].T @ (point - T[:3, 3]) - centre[1], T[:3, :3].T @ d
        ends = np.sort([(-room - o) / s, (room - o) / s], axis=0)
        wanted = max(ends[0].max(), 0.0) <= min(ends[1].min(), far)
        assert shadows._is_beam_in_box.py_func(
            T[None], 0, centre, half, 1, point, radius, d, far, growth) == wanted
        found.append(wanted)
    assert 50 < sum(found) < 250
    along, square = np.array([1.0, 0, 0]), np.eye(4)[None]
    for height, wanted in ((0.29, True), (0.31, False)):  # beside which the beam runs
        assert shadows._is_beam_in_box.py_func(square, 0, np.zeros((1, 3)), np.full((1, 3), 0.2), 0,
                                           np.array([-1.0, height, 0.0]), 0.1, along, 9.0, 0.0) \
            == wanted


def test_what_is_in_a_ray_s_way_is_a_triangle_of_another_part(rng):
    count, each = 6, 3
    centres = rng.normal(size=(count, 1, 1, 3))
    corners = (centres + 0.5 * rng.normal(size=(count, each, 3, 3))).reshape(-1, 3, 3)
    boxes = corners.reshape(count, -1, 3)
    low, high = boxes.min(axis=1), boxes.max(axis=1)
    T = np.stack([posed(rng, 0.3), posed(rng, 0.3)])
    part, row = np.array([0, 1, 2, 2, 1, 3]), np.array([0, 1, 0, 1, 1, 0])
    first, counts = np.arange(count) * each, np.full(count, each)
    world = np.stack([c @ T[row[n // each], :3, :3].T + T[row[n // each], :3, 3]
                      for n, c in enumerate(corners)])
    found = []
    for _ in range(300):
        p = 2.0 * rng.normal(size=3)
        d = (world[rng.integers(len(world))].mean(axis=0) - p) * rng.choice([0.5, 1.5])
        far, skip, own, beside = rng.choice([1.0, np.inf]), rng.choice([-1, 0, 2]), 1, 1.5
        shares = np.linalg.solve(np.concatenate([
            world[:, 1:] - world[:, :1], np.broadcast_to(-d, (len(world), 1, 3))], axis=1,
        ).swapaxes(1, 2), (p - world[:, 0])[..., None])[..., 0]
        u, v, at = shares.T
        of = np.repeat(part, each)
        begin = np.where(of == own, beside / np.linalg.norm(d), 0.0)
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (at > begin) & (at < far) & (of != skip)
        candidates = np.arange(count)
        blocked = shadows._is_blocked.py_func(
            p, d, far, skip, own, beside, candidates, count, T, part, row, first, counts,
            (low + high) / 2, (high - low) / 2, corners)
        assert blocked == hit.any()
        assert not blocked or hit[candidates[0] * each:][:each].any()  # it comes first then
        assert sorted(candidates) == list(range(count))
        found.append(blocked)
    assert 30 < sum(found) < 270


def test_light_falls_off_with_the_distance():
    lamps = np.zeros((2, WIDTH))
    lamps[1, KIND], lamps[1, PLACE:PLACE + 3] = 1, (0.3, -0.2, 1.0)
    lamps[1, FADE:FADE + 3], lamps[1, FADE + 3] = (0.5, 0.4, 0.3), 3.0
    lamps[0, PLACE:PLACE + 3] = 0.0, 0.6, 0.8
    d = np.empty(3)
    assert direction_to_lamp.py_func(lamps, 0, np.ones(3), d) == (np.inf, 1.0)
    assert d.tolist() == [0.0, 0.6, 0.8]
    for p, beyond in (((0.3, -0.2, -0.5), False), ((0.3, 1.0, -2.0), True)):
        way = lamps[1, PLACE:PLACE + 3] - p
        far = np.linalg.norm(way)
        left = 0.0 if beyond else 1.0 / max(0.5 + 0.4 * far + 0.3 * far**2, 1.0)
        assert direction_to_lamp.py_func(lamps, 1, np.array(p), d) == pytest.approx((far, left))
        assert d == pytest.approx(way / far)
    assert COLOUR + 3 == FADE


# -- colours ---------------------------------------------------------------------------------------


def test_colours_are_apart_where_one_part_differs_by_more_than_six(rng):
    for one in rng.integers(0, 256, (200, 3)):
        other = np.clip(one + rng.integers(-7, 8, 3) * (rng.random(3) < 0.5), 0, 255)
        words = [pack_colour.py_func(*map(float, colour)) for colour in (one, other)]
        assert edge_detection._has_contrast.py_func(*words) == (np.abs(one - other) > 6).any()
        assert words[0] == sum(int(v) << 8 * k for k, v in enumerate((*one, 255)))
    assert pack_colour.py_func(-3.0, 300.0, 99.5) == pack_colour.py_func(0.0, 255.0, 100.0)


def lying(longer, size):
    """planes of a texture square to the view, a pixel `longer` texels long along x, one wide."""
    planes = np.zeros((3, 3))
    planes[0, 0], planes[1, 1], planes[2, 2] = longer / size, 1.0 / size, 1.0
    planes[0, 2], planes[1, 2] = 0.31, 0.4
    return planes


def texels(image):
    """Return the texels of an image with all its reduced sizes."""
    parts, lanes = [np.array([len(image)], np.uint64)], np.array([0, 21, 42], np.uint64)
    while True:
        parts.append((image.astype(np.uint64) << lanes).sum(axis=2).ravel())
        if len(image) == 1:
            return np.concatenate(parts)
        image = image.reshape(len(image) // 2, 2, len(image) // 2, 2, 3).mean(axis=(1, 3))


def test_a_white_texture_is_white_however_aslant_it_is(rng):
    white = texels(np.full((64, 64, 3), 255))
    for longer in np.linspace(0.3, 40.0, 80):
        rgb = np.array([200.0, 100.0, 50.0])
        textures.apply_texture.py_func(lying(longer, 64), 0, white, 3.0, 1.0, rgb)
        assert rgb == pytest.approx([200.0, 100.0, 50.0], rel=2e-3), longer


def test_what_is_brighter_than_white_is_white_before_it_is_mixed(rng):
    half = np.zeros((64, 64, 3))
    half[:, 32:] = 255  # a pixel four texels wide on their border
    planes = lying(2.0, 64)
    planes[0, 2] = 0.5
    for rgb, wanted in (((300.0, 100.0, 50.0), (127.5, 50.0, 25.0)),
                        ((250.0, 100.0, 50.0), (125.0, 50.0, 25.0)),
                        ((50.0, 100.0, 400.0), (25.0, 50.0, 127.5))):  # fmt: skip
        found = np.array(rgb)
        textures.apply_texture.py_func(planes, 0, texels(half), 0.0, 0.0, found)
        assert found == pytest.approx(wanted, abs=0.5)


def test_a_texture_seen_aslant_is_the_mean_of_what_a_pixel_covers(rng):
    """Waves along one direction; a pixel up to fifteen texels long, turned every way."""
    at = 2.0 * np.pi * (np.arange(64) + 0.5) / 64
    waves = np.rint(127.5 + 100.0 * np.cos(4.0 * at[None, :] + 2.0 * at[:, None]))
    image = texels(np.repeat(waves[..., None], 3, axis=2))
    x, y = (np.array(np.meshgrid(*[(np.arange(32) + 0.5) / 32 - 0.5] * 2))).reshape(2, -1)
    for longer, turn, tilt in zip(rng.uniform(4.0, 15.0, 25), rng.uniform(0.0, np.pi, 25),
                                  rng.uniform(0.0, np.pi, 25), strict=True):
        turns = [np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]) for a in (turn, tilt)]
        sides = turns[0] @ np.diag([longer, 1.0]) @ turns[1] / 64  # by a pixel along x, along y
        planes = np.array([[*sides[0], 0.4], [*sides[1], 0.3], [0.0, 0.0, 1.0]])
        u, v = sides @ [x, y] + [[0.4], [0.3]]
        wanted = (127.5 + 100.0 * np.cos(2.0 * np.pi * (4.0 * u + 2.0 * v))).mean()
        rgb = np.full(3, 200.0)
        textures.apply_texture.py_func(planes, 0, image, 0.0, 0.0, rgb)
        assert rgb == pytest.approx([200.0 * wanted / 255.0] * 3, abs=1.5)


@pytest.mark.parametrize("shift", [19, 20, 21, 22])
def test_a_texel_counts_by_how_near_its_middle_is(rng, shift):
    """All four together as much as one; to less than a unit, and a half of it for each of three."""
    size, part = 4, 2 ** (30 - shift)
    for x, y in rng.integers(-(2**17), 2**17, (40, 2)):
        column, row = x / 2**15, y / 2**15
        told = []
        for at in range(size * size):
            one = np.zeros(3 + size * size, np.uint64)
            one[3 + at] = 1
            told.append(int(textures._sum_texels.py_func(one, np.int64(3), np.int64(size), x, y,
                                                  np.int64(1), np.int64(shift))))
        weight = [[max(1.0 - min(abs(k - place) % size, size - abs(k - place) % size), 0.0)
                   for k in range(size)] for place in (row % size, column % size)]
        wanted = part * np.outer(*weight).ravel()
        assert sum(told) == part and np.abs(told - wanted).max() <= 1.5
        assert np.sum(np.abs(told - wanted) > 0.5 + 1e-9) <= 3


def test_a_texture_is_read_at_its_places_in_the_pixel_of_the_level_it_asks_for(rng, monkeypatch):
    """Against the pixel's own axes, by singular values, in perspective; a level's blur is taken off
    across."""
    read, kinds = [], set()
    monkeypatch.setattr(textures, "_sum_texels", lambda texels, at, size, x, y, one, shift: (
        read.append((at, size, x, y, shift)), np.uint64(0))[1])
    for turn in range(60):
        sides = rng.normal(size=(2, 2)) * 2.0 ** rng.uniform(-9.0, -1.0) * [1.0, rng.uniform(0, 1)]
        planes = np.array([[*sides[0], 0.4], [*sides[1], 0.3], [0.02, -0.03, 1.0]])
        x, y = rng.uniform(0.0, 7.0, 2)
        rgb, texels = np.array([90.0, 300.0 * (turn % 2), 50.0]), np.array([0, 256, 0], np.uint64)
        read.clear()
        textures.apply_texture.py_func(planes, 1, texels, x, y, rgb)
        U, V, W = planes @ [x, y, 1.0]
        uv = np.array([U, V]) / W
        J = 256.0 * (planes[:2, :2] - np.outer(uv, planes[2, :2])) / W
        size, at, level = 256, 2, 1.0
        long, wide = np.linalg.svd(J)[1]
        while size > 1 and (wide > np.sqrt(8.0) or 0.8 * long * max(wide, 1.0) > 20):
            at, size = at + size * size, size // 2
            long, wide, level = 0.5 * long, 0.5 * wide, 0.5 * level
        J, count, spots, more = J * level, 4, textures.SAMPLE_POINTS[0, 0], 0
        if long > np.sqrt(8.0):
            count = min(max(int(np.ceil(0.8 * long * max(wide, 1.0))), 4), 20)
            more = sum(count > limit for limit in (4, 8, 16))
            # The direction in the pixel along which most texels lie, to the nearest sixteenth.
            way = np.linalg.svd(J)[2][0]
            nearest = np.abs(textures.DIRECTIONS @ way)
            turn = nearest.argmax()
            if np.sort(nearest)[-2] > nearest[turn] - 4e-3:
                continue  # which is numbered by a square around 0 instead of a circle
            spots = textures.SAMPLE_POINTS[turn, count]
            c, s = textures.DIRECTIONS[turn]
            narrow = np.sqrt(max(1.0 - 3.0 * (1.0 - level**2) / wide**2, 0.0))
            J = J @ [[c, -s * narrow], [s, c * narrow]]
            kinds.add((count, level < 1.0, 0.0 < narrow < 1.0))
        wanted = 32768.0 * (size * uv - 0.5 + spots[:count] @ J.T)
        assert [one[:2] for one in read] == [(at, size)] * count
        assert {one[4] for one in read} == {19 + more}
        np.testing.assert_allclose([one[2:4] for one in read], wanted, atol=1.01)
    assert len(kinds) > 6


def test_a_pixel_is_as_far_as_its_ray_goes_whatever_that_ray_s_length(rng):
    side = np.linalg.inv(rng.uniform(0.5, 2.0, (2, 3, 3)) * np.eye(3) + 0.1)
    rays = rng.uniform(0.5, 3.0, (8, 8, 3)) * rng.choice([1.0, 2.0], (8, 8, 1))
    pixel, valid = rng.integers(-2, 2, (8, 8)).astype(np.int32), rng.random((8, 8)) < 0.9
    for forward in (True, False):
        depth, label = np.empty((8, 8), np.float32), np.empty((8, 8), np.int32)
        depth_and_labels._measure.py_func(
            np.array([sampling.SEVERAL]), pixel, valid, side, np.array([7, 9], np.int32),
            np.zeros((1, 3, 3)), rays, 1, 1, forward, depth, label)
        plane = side.sum(axis=1)[np.maximum(pixel, 0)]
        place = rays / (plane * rays).sum(axis=2)[..., None]
        there = valid & (pixel >= 0)
        away = place[..., 2] if forward else np.linalg.norm(place, axis=2)
        np.testing.assert_allclose(depth, np.where(there, away, np.inf), rtol=1e-6)
        np.testing.assert_array_equal(label, np.where(there, np.array([7, 9])[pixel], -1))
