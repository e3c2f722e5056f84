"""What compiled functions say of a tile's pixels, as plain Python, against all triangles at all of
its pixels. Tiles are of a camera with fx != fy whose centre is far aside, of one cell or four."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import looking
from test_kernels import SAMPLES, texels

from aras_sim_bridge.rendering import (
    View,
    create_renderer,
    dense_coverage,
    edge_detection,
    edges,
    sampling,
    shading,
    shadows,
    textures,
)
from aras_sim_bridge.rendering.dense_coverage import FINE
from aras_sim_bridge.rendering.sampling import BACKGROUND, NOTHING, SEVERAL
from aras_sim_bridge.rendering.tiles import TILE, Tiles

pytestmark = pytest.mark.usefixtures("plainly")
CAMERA = np.array([[1 / 150.0, 0.0, -0.21], [0.0, 1 / 110.0, 0.13], [0.0, 0.0, 1.0]])
AXIS = np.array([0.1, -0.2, 1.0]) / np.sqrt(1.05)
SKY = np.uint32(0xFF808890)
PIXELS = np.stack(np.meshgrid(np.arange(8.0), np.arange(8.0)), axis=2).reshape(-1, 2)
ENDS = np.array([[-0.5, -0.5], [0.5, -0.5], [-0.5, 0.5], [0.5, 0.5]])  # of a pixel


def moved(x, y):
    """Return the matrix from pixels right of and below x, y to rays."""
    return CAMERA @ [[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]]


def matrices_of(tiles, columns, cells):
    size = TILE // cells
    return np.array([moved(TILE * (n % columns) + size * (c % cells),
                           TILE * (n // columns) + size * (c // cells))
                     for n in range(tiles) for c in range(cells * cells)])


def through(places, first=(0.0, 0.0)):
    """Rays (N, 3) through places (N, 2) of the tile whose first pixel that is."""
    return np.column_stack([places, np.ones(len(places))]) @ moved(*first).T


def triangles(rng, count, first=(0.0, 0.0), reach=(-6.0, 14.0), thin=1.0):
    """Places in the tile (count, 3, 2), corners, sides of triangles there; thin: part of the width
    that every second one has."""
    places = rng.uniform(*reach, (count, 3, 2))
    places[::2, :, 0] += (thin - 1.0) * (places[::2, :, 0] - places[::2, :1, 0])
    corner = through(places.reshape(-1, 2), first).reshape(count, 3, 3)
    corner *= rng.uniform(0.8, 1.6, (count, 3, 1))
    return places, corner, np.ascontiguousarray(np.linalg.inv(corner).swapaxes(1, 2))


def bits_of(there):
    """A tile's pixels (64,) bool as a word."""
    return np.uint64(sum(1 << int(n) for n in np.flatnonzero(there)))


def of_bits(word):
    return np.array([int(word) >> n & 1 for n in range(64)], bool)


@pytest.mark.parametrize(("cells", "away"), [(1, 1.0), (2, 1e5)])
def test_what_a_cover_hides_is_behind_it_at_the_tile_s_four_corners(cells, away):
    rng, columns, tiles = np.random.default_rng(5), 7, 49
    ends = np.array([[-0.5, -0.5], [7.5, -0.5], [-0.5, 7.5], [7.5, 7.5]])
    side = triangles(rng, 40, (24.0, 8.0), (-30.0, 38.0))[2] / away
    opaque = rng.random(40) < 0.8
    nodes, axis = np.zeros((tiles, 5)), np.tile(AXIS, (tiles, 1))
    cover = np.where(rng.random(tiles) < 0.6, rng.choice(np.flatnonzero(opaque), tiles), -1)
    listed = [np.sort(rng.choice(np.setdiff1d(np.arange(40), cover[n:n + 1]), n % 6, False))
              for n in range(tiles)]
    whole = rng.random(tiles) < 0.8
    start = np.cumsum([0, *map(len, listed)])
    member, full = np.concatenate(listed), rng.random(start[-1]) < 0.5
    wanted, out = [], []
    for n in range(tiles):
        first = TILE * (n % columns), TILE * (n // columns)
        nodes[n, :3] = through([[3.5, 3.5]], first)[0]
        nodes[n, 3] = 2.0 if n == 9 else 0.9
        own = slice(start[n], start[n + 1])
        here = dict(zip(member[own].tolist(), full[own].tolist(), strict=True))
        if n == 9 or not here and (whole[n] or cover[n] < 0):
            out.append(NOTHING if n == 9 else cover[n] if whole[n] else SEVERAL)
            wanted.append({})
            continue
        if cover[n] >= 0:
            here[int(cover[n])] = True
        plane = side.sum(axis=1)
        covers = [m for m in here if here[m] and opaque[m] and plane[m] @ nodes[n, :3] > 0.0]
        best = max(covers, key=lambda m: plane[m] @ nodes[n, :3], default=None)
        near = plane @ through(ends, first).T
        left = {m: here[m] for m in sorted(here)
                if best is None or m == best or (near[m] > near[best]).any()}
        wanted.append(left)
        out.append(best if list(left) == [best] and whole[n] else SEVERAL)
    matrices = matrices_of(tiles, columns, cells)
    tile, _, begin, members, fulls = sampling._cull_tiles(
        cover, start, member, full, side, opaque, matrices, axis, nodes, whole, cells)
    np.testing.assert_array_equal(tile, out)
    for n, left in enumerate(wanted):
        own = slice(begin[n], begin[n + 1])
        assert dict(zip(members[own].tolist(), fulls[own].tolist(), strict=True)) == left
    assert begin[-1] < start[-1] - 5 and sum(map(bool, wanted)) > 10


def test_what_most_tiles_show_is_told():
    one = np.zeros(0, np.int64)
    cover = np.array([4, 4, -1, 2, 4, 2, 4, 4, 2, 4])
    most = sampling._cull_tiles(
        cover, np.zeros(11, np.int64), one, one > 0, np.ones((5, 3, 3)), np.ones(5, bool),
        matrices_of(10, 5, 1), np.tile(AXIS, (10, 1)), np.full((10, 5), 0.5),
        np.ones(10, bool), 1)[1]
    assert most == 4


@pytest.mark.parametrize(("cells", "alike", "at"), [(1, True, 0.0), (1, False, -0.5),
                                                   (2, False, 0.0), (2, True, -0.5)])
def test_a_sample_shows_the_nearest_of_all_triangles(cells, alike, at):
    rng, count, columns, near, far = np.random.default_rng(9), 30, 2, 0.95, 1.3
    middle, corner, side = triangles(rng, count, (0.0, 0.0), (-5.0, 24.0), 0.05)
    cut, opaque = rng.random(count) < 0.4, rng.random(count) < 0.8
    tile = np.array([SEVERAL, BACKGROUND, SEVERAL, SEVERAL])
    listed = [np.sort(rng.choice(count, 14, False)) for _ in tile]
    member = np.concatenate(listed)
    start, full = np.arange(5) * 14, rng.random(len(member)) < 0.15
    # What is said to be all over is behind, or it would hide all else.
    full &= (side.sum(axis=1)[member] @ through(ENDS * 16 + 7.5).T < 0.95).all(axis=1)
    was = start.copy(), member.copy(), full.copy()
    matrices, axis = matrices_of(4, columns, cells), np.tile(AXIS, (4, 1))
    inverse = np.linalg.inv(matrices_of(4, columns, 1))
    pixel, touched = np.full((16, 16), 99, np.int32), np.zeros(len(member), np.uint64)
    left = sampling._sample(tile, start, member, full, corner, side, cut, opaque, matrices,
                            inverse, np.zeros(4), axis, cells, alike, columns, near, far, at, pixel,
                            touched)
    assert start[4] == left and full.any()
    various = 0
    for n in range(4):
        first = np.array([TILE * (n % columns), TILE * (n // columns)])
        own = pixel[first[1]:first[1] + 8, first[0]:first[0] + 8].ravel()
        found = slice(start[n], start[n + 1])
        if tile[n] != SEVERAL:
            assert (own == 99).all() and found.start == found.stop
            continue
        rays = through(PIXELS + at, first)
        nearest, wanted, kept = np.zeros(64), np.full(64, BACKGROUND), []
        for m, whole in zip(was[1][14 * n:14 * n + 14], was[2][14 * n:14 * n + 14], strict=True):
            shares = side[m] @ rays.T
            w = shares.sum(axis=0)
            away = rays @ AXIS / w
            there = (w > 0.0) & opaque[m] & (whole | (shares >= 0.0).all(axis=0))
            there &= ((away >= near) & (away <= far)) | ~cut[m]
            wanted = np.where(there & (w > nearest), m, wanted)
            nearest = np.where(there, np.maximum(w, nearest), nearest)
            # Its pixels are those that the box around its corners reaches into.
            place = middle[m] - first
            low, high = place.min(axis=0) - 0.5, place.max(axis=0) + 0.5
            in_box = ((low < PIXELS) & (high >= PIXELS)).all(axis=1)
            if whole or in_box.any():
                kept.append((m, whole, bits_of(in_box | whole)))
        np.testing.assert_array_equal(own, wanted)
        various += len(set(wanted))
        assert kept == list(zip(member[found], full[found], touched[found], strict=True))
    assert various > 9


def apart(one, other):
    return any(abs((int(one) >> 8 * k & 255) - (int(other) >> 8 * k & 255)) > 6 for k in range(3))


@pytest.mark.parametrize(("cells", "behind"), [(1, True), (2, False), (2, True)])
def test_what_pokes_into_a_pixel_before_what_it_shows_makes_it_an_edge(cells, behind):
    """A line, a plane is highest at one of a pixel's corners."""
    rng, count, columns, near, far = np.random.default_rng(3), 9, 3, 0.95, 1.3
    seen = {"poked": 0, "not": 0, "slit": 0}
    for turn in range(4):
        n = 4
        first = TILE * (n % columns), TILE * (n // columns)
        _, _, side = triangles(rng, count, first)
        cut = rng.random(count) < 0.4
        plain = rng.choice(np.array([0, SKY, SKY + 6, 0xFF0000FF, 0xFF0009FF], np.uint32), count)
        smooth = rng.choice([-1, 1, 2], count)
        touched = np.array([~np.uint64(0)] * 3 + [bits_of(rng.random(64) < 0.8)
                                                  for _ in range(count - 3)])
        full = np.zeros(count, bool)
        full[0] = behind
        pixel = np.full((16 + TILE, TILE * columns), 99, np.int32)
        own = rng.choice([-1, 0, 0, 1, 2], 64)
        pixel[first[1]:first[1] + 8, first[0]:first[0] + 8] = own.reshape(8, 8)
        valid = np.ones(pixel.shape, bool)
        valid[first[1] + 3, first[0] + 5] = False
        given, mixed = rng.random(64) < 0.2, rng.random(64) < 0.2
        tile = np.full(9, BACKGROUND)
        tile[n] = SEVERAL
        words = np.zeros((2, 9), np.uint64)
        words[0, n], words[1, n] = bits_of(given), bits_of(mixed)
        start = np.where(np.arange(10) > n, count, 0)
        order = rng.permutation(count)
        found = edge_detection._find_thin_edges(
            *words, tile, pixel, start, order, full[order], touched[order], plain, smooth, SKY,
            side, cut, matrices_of(9, columns, cells), np.tile(AXIS, (9, 1)), valid, cells, columns,
            near, far)
        assert not np.delete(found, n).any()
        plane, wanted = side.sum(axis=1), np.zeros(64, bool)
        name = [int(plain[m]) if plain[m] else ("of", smooth[m] if smooth[m] >= 0 else -2 - m)
                for m in range(count)] + [int(SKY)]  # the last is the sky's

        def unlike(one, other, name=name):
            one, other = name[one], name[other]
            return one != other and (isinstance(one, tuple) or isinstance(other, tuple)
                                     or apart(one, other))

        for k, place in enumerate(PIXELS):
            m = own[k]
            if given[k] or not valid[first[1] + k // 8, first[0] + k % 8]:
                continue
            if mixed[k] and m >= 0 and not behind and unlike(m, -1):
                wanted[k] = True  # a slit, with nothing but the sky behind
                seen["slit"] += 1
                continue
            rays = through(place + ENDS, first)
            along = rays @ AXIS
            for t in range(count):
                w = plane[t] @ rays.T
                pokes = of_bits(touched[t])[k] and unlike(m, t) and w.max() > 0.0
                pokes &= full[t] or (side[t] @ rays.T).max(axis=1).min() > 0.0
                if cut[t]:
                    pokes &= far * w.max() > along.min() and near * w.min() < along.max()
                if m >= 0 and not mixed[k]:
                    pokes &= (w - plane[m] @ rays.T).max() > 1e-7
                wanted[k] |= pokes
            seen["poked" if wanted[k] else "not"] += 1
        np.testing.assert_array_equal(of_bits(found[n]), wanted, err_msg=f"turn {turn}")
    assert seen["poked"] > 50 and seen["not"] > 20 and (seen["slit"] > 5) != behind


@pytest.mark.parametrize("ends", [0.3, 0.4, 0.51, 0.63])
@pytest.mark.parametrize("axis", [AXIS, [0.2, 0.1, np.sqrt(0.95)]])
def test_of_what_is_cut_off_no_pixel_is_an_edge(ends, axis):
    """A wall square to the optical axis, which is aslant to the tile's, before the sky."""
    side = np.linalg.inv(through(np.array([[-9.0, -7.0], [22.0, -8.0], [1.0, 23.0]]))).T[None]
    along = np.array([through(place + ENDS) @ axis for place in PIXELS])
    low, high = along.min(), along.max()
    one, other = low + ends * (high - low), high - ends * (high - low)
    for near, far, wanted in ((0.01, one, along.min(axis=1) < one),
                              (other, 9.0, along.max(axis=1) > other)):
        found = edge_detection._find_thin_edges(
            *np.zeros((2, 1), np.uint64), np.array([SEVERAL]), np.full((8, 8), -1, np.int32),
            np.array([0, 1]), np.array([0]), np.array([False]), np.array([~np.uint64(0)]),
            np.array([0xFF0000FF], np.uint32), np.array([-1]), SKY,
            np.ascontiguousarray(side),
            np.array([True]), matrices_of(1, 1, 1), np.array([axis]), np.ones((8, 8), bool), 1, 1,
            near, far)
        np.testing.assert_array_equal(of_bits(found[0]), wanted)
        assert 0 < wanted.sum() < 64


@pytest.mark.parametrize(("cells", "through_it"), [(1, False), (2, False), (2, True)])
def test_pixels_whose_corners_show_what_differs_are_edges(cells, through_it):
    """Of one smooth part by the light that each of its triangles has in the pixel's middle."""
    rng, count, n, columns = np.random.default_rng(4), 8, 4, 3
    first = np.array([8, 8])
    places = [[-9.0, -7.0], [22.0, -8.0], [1.0, 23.0]] + rng.uniform(-2.0, 2.0, (count, 3, 2))
    corner = through(places.reshape(-1, 2), first).reshape(-1, 3, 3)
    corner *= rng.uniform(0.8, 1.6, (count, 3, 1))
    side = np.ascontiguousarray(np.linalg.inv(corner).swapaxes(1, 2))
    light = 0.5 + rng.uniform(-0.1, 0.1, (count, 3)) * rng.choice([0.15, 1.0], (count, 1))
    smooth, part = np.array([1, 1, 1, 1, 2, 2, -1, -1]), np.array([0, 0, 0, 1, 1, 1, 2, 3])
    plain = np.array([0, 0, 0, 0, 0, 0xFF102030, 0xFF102030, 0xFF102033], np.uint32)
    opaque = np.arange(count) != 7
    tile = np.array([SEVERAL, 3, 4, BACKGROUND, SEVERAL, 1, 2, NOTHING, 0])
    kinds = {True: 0, False: 0}
    for _ in range(3):
        pixel = rng.choice([0, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, -1], (24, 24)).astype(np.int32)
        pixel[first[1] + 3:first[1] + 6, first[0] + 2:first[0] + 7] = 1
        valid = rng.random((24, 24)) < 0.95
        member = np.array([7, 0, 1] if through_it else [0, 1, 2])
        edge, mixed = edge_detection._find_corner_edges(
            tile, pixel, np.where(np.arange(10) > n, 3, 0), member, opaque, plain, smooth, part,
            SKY, side, light, matrices_of(9, columns, cells), valid, cells, columns)
        shown = np.kron(tile.reshape(3, 3), np.ones((8, 8), int))
        shown = np.where(shown == SEVERAL, pixel, shown)
        wanted, mixes = np.zeros(64, bool), np.zeros(64, bool)
        for k, (x, y) in enumerate(PIXELS.astype(int) + first):
            m, others = shown[y, x], set(shown[y:y + 2, x:x + 2].ravel().tolist())
            if not valid[y, x]:
                continue
            others.discard(m)
            ray, wanted[k] = through([[x, y]])[0], through_it
            for other in others:
                mixes[k] |= m < 0 or other < 0 or part[m] != part[other]
                if other == NOTHING:
                    wanted[k] = True
                elif m >= 0 and other >= 0 and smooth[m] == smooth[other] >= 0:
                    lit = [light[j] @ side[j] @ ray / (side[j] @ ray).sum() for j in (m, other)]
                    differs = abs(lit[0] - lit[1]) * 255.0 > 6.0
                    wanted[k] |= differs and np.ptp(light[[m, other]]) * 255.0 > 6.0
                    kinds[bool(differs)] += 1
                else:
                    one, two = (SKY if j == BACKGROUND else plain[j] for j in (m, other))
                    wanted[k] |= one == 0 or two == 0 or apart(one, two)
        np.testing.assert_array_equal(of_bits(edge[n]), wanted)
        np.testing.assert_array_equal(of_bits(mixed[n]), mixes)
    assert min(kinds.values()) > 10


def fan(corners, depths):
    """Sides (N, 3, 3) of triangles from the second place on, all around the first."""
    rays = through(corners) * np.array(depths)[:, None]
    ring = np.arange(1, len(corners))
    return np.linalg.inv(np.stack([[rays[0], rays[k], rays[n]] for k, n in zip(
        ring, np.roll(ring, -1), strict=True)])).swapaxes(1, 2), rays


def resolved_of(side, corner, cells, u, v, **given):
    """Member, share, place of the fragments of pixel u, v in the first tile."""
    count = len(side)
    said = {"opaque": np.ones(count, bool), "cut": np.zeros(count, bool),
            "hull": np.full(count, -1), "near": 0.01, "far": 50.0,
            "plain": np.zeros(count, np.uint32), **given}
    room = 3 * count
    start, member, share, at = (np.empty(2, np.int64), np.empty(room, np.int64), np.empty(room),
                                np.empty((room, 2)))
    total = edges.resolve_fragments(
        np.array([v * TILE + u]), np.array([0, count]), np.arange(count), np.zeros(count, bool),
        np.full(count, ~np.uint64(0)), corner, np.ascontiguousarray(side), said["cut"],
        said["opaque"], said["plain"], np.arange(count), said["hull"],
        matrices_of(1, 1, cells), AXIS[None], cells, 1, said["near"], said["far"], start, member,
        share, at)
    assert start.tolist() == [0, total]
    return member[:total], share[:total], at[:total]


@pytest.mark.parametrize("cells", [1, 2])
def test_of_one_convex_part_all_over_a_pixel_samples_say_which_is_where(cells):
    """A fan of seven triangles around a place in the pixel, in one of which is one sample."""
    u, v = 5, 2
    centre = np.array([0.03, -0.08])
    way = np.sort(np.arctan2(*(SAMPLES - centre).T[::-1]))
    apart_by = np.diff([way[-1] - 2.0 * np.pi, *way, way[0] + 2.0 * np.pi])
    lone = np.minimum(apart_by[:-1], apart_by[1:]).argmax()
    thin = 0.4 * min(apart_by[lone], apart_by[lone + 1])
    angle = way[lone] + np.array([-thin, thin, 0.9, 1.8, 2.9, 3.9, 5.0])
    around = centre + 40.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    places = np.vstack([centre, around]) + [u, v]
    side, rays = fan(places, [1.0] + [1.1] * 7)
    corner = np.stack([[rays[0], rays[k], rays[k % 7 + 1]] for k in range(1, 8)])
    shares = side @ through(SAMPLES + [u, v]).T
    met = (shares >= 0.0).all(axis=1)
    assert (met.sum(axis=0) == 1).all()
    many = met.sum(axis=1)
    assert (many == 1).any()
    member, share, at = resolved_of(side, corner, cells, u, v, hull=np.full(7, 3))
    np.testing.assert_array_equal(member, np.flatnonzero(many))
    np.testing.assert_allclose(share, many[member] / FINE, atol=1e-6)
    size = TILE // cells
    for m, place in zip(member, at, strict=True):
        np.testing.assert_allclose(place, [u % size, v % size] + SAMPLES[met[m]].mean(axis=0),
                                   atol=1e-6)


@pytest.mark.parametrize(("words", "alike"), [([7, 7], True), ([7, 8], False), ([0, 0], False)])
def test_what_is_of_one_colour_all_over_a_pixel_is_one_piece(words, alike):
    """A triangle before a quarter of what fills it."""
    u, v = 3, 6
    corner = np.array([
        through(np.array([[-30.0, -20.0], [35.0, -18.0], [4.0, 40.0]]) + [u, v]),
        0.8 * through(np.array([[0.25, -50.0], [90.0, 0.0], [0.25, 50.0]]) + [u, v])])
    side = np.linalg.inv(corner).swapaxes(1, 2)
    member, share, at = resolved_of(side, corner, 1, u, v, plain=np.array(words, np.uint32))
    wanted = {0: 1.0} if alike else {0: 0.75, 1: 0.25}
    assert dict(zip(member.tolist(), share.tolist(), strict=True)) == pytest.approx(wanted)
    assert not alike or at.tolist() == [[u, v]]


@pytest.mark.parametrize("cells", [1, 2])
def test_what_is_behind_all_that_fills_a_pixel_does_not_crowd_it(cells):
    """Of a tilted plane that fills it, and three strips before that, areas stay exact."""
    u, v = 6, 1
    ray = through([[u, v]])[0]
    tilt = np.array([-3.0, 2.0, 1.0])
    tilt /= tilt @ ray  # one over the distance: 1 at the pixel's middle
    dx, dy = (tilt @ CAMERA)[:2]
    half = 0.5 * (abs(dx) + abs(dy))

    def lying(plane, places):
        rays = through(np.array(places) + [u, v])
        return rays / (rays @ plane)[:, None]

    flat = np.array([0.0, 0.0, 1.0]) / ray[2]
    wide = [[-12.0, -9.0], [14.0, -7.0], [2.0, 15.0]]
    # Behind by 1.1 times what the filling plane changes by: nowhere before it, but nearly.
    corners = [lying(tilt, wide), lying((1.0 - 1.1 * half) * flat, wide)]
    for n, x in enumerate((0.31, 0.37, 0.42), 2):  # along its right side
        corners.append(lying((1.5 + 0.1 * n) * flat, [[x, -60.0], [90.0, 0.0], [x, 60.0]]))
    wanted = {4: 0.08, 3: 0.05, 2: 0.06, 0: 0.81}
    corner = np.array(corners)
    side = np.linalg.inv(corner).swapaxes(1, 2)
    member, share, _ = resolved_of(side, corner, cells, u, v)
    assert dict(zip(member.tolist(), share.tolist(), strict=True)) == pytest.approx(wanted)


def test_a_wire_that_no_sample_meets_covers_its_area_in_a_crowd():
    """It lies before all, is seen at the lower end of a cell, and comes nearer downwards."""
    u, v = 3, 7
    tilt = np.array([0.0, 6.0, 1.0])
    tilt /= tilt @ through([[u, v]])[0]

    def lying(plane, places):
        rays = through(np.array(places) + [u, v])
        return rays / (rays @ plane)[:, None]

    flat = np.array([0.0, 0.0, 1.0])
    corners = [lying(0.5 * flat, [[-40.0, -30.0], [45.0, -20.0], [2.0, 50.0]])]
    for n, x in enumerate((-0.1, -0.2, -0.3, -0.4)):
        corners.append(lying((0.6 + 0.05 * n) * flat, [[x, 60.0], [-90.0, 0.0], [x, -60.0]]))
    wide = 0.014  # at its broad end, three pixels above; it ends 97 below
    corners.append(lying(tilt, [[0.3125 - wide / 2, -3.0], [0.3125 + wide / 2, -3.0],
                                [0.3125, 97.0]]))
    assert not (np.abs(SAMPLES[:, 0] - 0.3125) < wide).any()
    corner = np.array(corners)
    member, share, _ = resolved_of(np.linalg.inv(corner).swapaxes(1, 2), corner, 1, u, v)
    assert dict(zip(member, share, strict=True))[5] == pytest.approx(0.97 * wide, rel=1e-3)
    assert share.sum() == pytest.approx(1.0)


@pytest.mark.parametrize("k", range(3))
def test_a_sample_on_a_triangle_s_side_is_met(k):
    """Sides run exactly through a column of samples."""
    line = np.tile([9.0, 0.0, 0.0], (1, 6, 1))
    line[0, k] = -1 / 64, 1.0, 0.0
    counts = np.zeros((1, 2))
    dense_coverage.sample_pixel(
        np.zeros(1, np.int64),
        line,
        np.array([3]),
        np.zeros(1, bool),
        0.0,
        0.0,
        1,
        1,
        np.empty((3, FINE), np.float32),
        counts,
    )
    assert counts[0].tolist() == [16.0, 16.0] and (SAMPLES[:, 0] == 1 / 64).any()


@pytest.mark.parametrize("x", [-0.31, 0.12, 0.4])
@pytest.mark.parametrize("turned", [1.0, -1.0])
@pytest.mark.parametrize(("leans", "away"), [(0.0, 1.0), (-0.5, 1.0), (-0.5, 1e4)])
def test_of_what_goes_through_what_fills_a_pixel_only_the_part_before_it_is_seen(
    x, turned, leans, away
):
    """What fills it is square to the view, or leans the other way, near by or far away."""
    u, v = 2, 5
    flat = np.array([0.0, 0.0, 1.0])
    line = turned * np.array([150.0, 0.0, 0.0])  # one over the distance, by pixels along x
    tilt = 0.02 * (line - line @ through([[u + x, v]])[0] * flat)
    steep, filling = 0.9 * flat + tilt, 0.9 * flat + leans * tilt

    def lying(plane, places):
        rays = through(np.array(places) + [u, v])
        assert (rays @ plane > 0.0).all()
        return rays / (rays @ plane)[:, None]

    wide = [[-12.0, -9.0], [14.0, -7.0], [2.0, 15.0]]
    corner = np.array([lying(filling, [[-40.0, -30.0], [45.0, -20.0], [2.0, 50.0]]),
                       lying(steep, wide)])
    # Neither half of it fills the pixel: it ends below its lower quarter.
    corner[1] = lying(steep, [[-12.0, 0.25], [2.0, -25.0], [12.0, 0.25]])
    corner *= away
    member, share, _ = resolved_of(np.linalg.inv(corner).swapaxes(1, 2), corner, 1, u, v,
                                   hull=np.array([3, 4]))
    before = 0.75 * (0.5 - turned * x)
    assert dict(zip(member.tolist(), share.tolist(), strict=True)) == pytest.approx(
        {0: 1.0 - before, 1: before})


@pytest.mark.parametrize(("cells", "away"), [(1, 1.0), (2, 1e4), (1, 1e-3)])
@pytest.mark.parametrize("filled", [True, False])
def test_few_triangles_that_cross_in_a_pixel_show_what_is_nearest_at_each_place(
    cells, away, filled
):
    """Steep ones, that lean every way, the first all over it where it is filled."""
    rng, (u, v) = np.random.default_rng(8), (5, 3)
    grid = (np.indices((60, 60)).reshape(2, -1).T[:, ::-1] + 0.5) / 60 - 0.5 + [u, v]
    rays, crossed = through(grid), 0
    for turn in range(16):
        places = rng.uniform(-2.0, 2.0, (2 + turn % 3, 3, 2)) + [u, v]
        if filled:
            angle = rng.uniform(0.0, 6.0) + np.arange(3) * np.pi / 1.5
            places[0] = 3.0 * np.column_stack([np.cos(angle), np.sin(angle)]) + [u, v]
        corner = through(places.reshape(-1, 2)).reshape(-1, 3, 3)
        corner *= away * rng.uniform(0.6, 1.5, (len(places), 3, 1))
        side = np.linalg.inv(corner).swapaxes(1, 2)
        shares = side @ rays.T
        near = np.where((shares >= 0.0).all(axis=1), shares.sum(axis=1), 0.0)
        wanted = {m: np.mean((near.argmax(axis=0) == m) & (near.max(axis=0) > 0.0))
                  for m in range(len(places))}
        member, share, _ = resolved_of(side, corner, cells, u, v)
        found = dict.fromkeys(wanted, 0.0) | dict(zip(member.tolist(), share.tolist(), strict=True))
        # Where nothing is behind, a piece's share is its own area.
        assert found == pytest.approx(wanted, abs=0.02), turn
        crossed += sum(0.05 < one < 0.95 for one in wanted.values())
    assert crossed > 12


@pytest.mark.parametrize("way", [(0.8, 0.6), (-0.6, 0.8), (0.28, -0.96), (-0.96, -0.28)])
def test_what_reaches_into_a_pixel_is_looked_at_between_its_border_and_the_corner(way):
    """A triangle beyond a line, at 0.2 px from the centre, before nothing."""
    u, v, (c, s) = 4, 6, way
    foot, along = 0.2 * np.array(way), np.array([-s, c])
    places = np.array([foot - 50.0 * along, foot + 50.0 * along, foot + 40.0 * np.array(way)])
    corner = through(places + [u, v])[None] * np.array([1.0, 1.2, 0.9])[:, None]
    member, share, at = resolved_of(np.linalg.inv(corner).swapaxes(1, 2), corner, 1, u, v)
    end = 0.5 * np.sign(way)  # the corner farthest beyond
    np.testing.assert_allclose(at, [(foot + end) / 2 + [u, v]], atol=1e-9)
    x, y = (np.indices((400, 400)).reshape(2, -1) + 0.5) / 400 - 0.5
    assert share[0] == pytest.approx((c * x + s * y > 0.2).mean(), abs=3e-3)


def test_rays_of_a_shadow_s_edge_are_spread_by_roberts_s_sequence():
    roots = np.roots([1.0, 0.0, 0.0, 0.0, -1.0, -1.0])  # g**5 = g + 1
    golden = roots[np.abs(roots.imag) < 1e-12].real[0]
    x, y, a, b = shadows.SPREAD.T
    turn = np.arctan2(b, a) / (2.0 * np.pi)
    for k, one in enumerate((x, y, a**2 + b**2 - 0.5, turn - 0.5), 1):
        off = one - np.arange(1, 161) / golden**k
        assert np.abs(off - np.rint(off)).max() < 1e-9
    assert np.abs([x, y]).max() <= 0.5 and np.hypot(a, b).max() <= 1.0


def test_light_lies_between_a_triangle_s_corners_though_two_are_as_bright():
    """Without a texture; each triangle fills a tile, and is darker at another corner."""
    first = [(0.0, 0.0), (8.0, 0.0), (16.0, 0.0)]
    corner = np.array([through(np.array([[-9.0, -7.0], [22.0, -8.0], [1.0, 23.0]]), at)
                       * [[1.0], [1.3], [0.8]] for at in first])
    side, light = np.ascontiguousarray(np.linalg.inv(corner).swapaxes(1, 2)), 0.9 - 0.6 * np.eye(3)
    albedo, words = np.tile([250.0, 120.0, 40.0, 1.0], (3, 1)), np.zeros((8, 24), np.uint32)
    shading._draw_samples(
        np.arange(3), np.zeros((8, 24), np.int32), 2, np.zeros(3, np.uint64),
        np.zeros(3, np.uint32), SKY, np.arange(3), side, light, albedo, np.full(3, -1),
        np.zeros((3, 3, 2)), np.zeros(1, np.uint64), matrices_of(3, 3, 1), np.ones((8, 24), bool),
        1, 3, np.zeros((0, 0, 3), np.float32), np.zeros((0, 0), np.uint32), words)
    for n in range(3):
        shares = side[n] @ through(PIXELS, first[n]).T
        lit = light[n] @ shares / shares.sum(axis=0)
        for k in range(3):
            level = (words[:, 8 * n:8 * n + 8] >> np.uint32(8 * k) & np.uint32(255)).ravel()
            assert np.abs(level - lit * albedo[0, k]).max() <= 0.5 + 1e-6
        assert np.ptp(lit) > 0.05


@pytest.mark.parametrize("at", [0.0, 0.17, 0.39])
def test_a_pixel_that_a_texture_is_repeated_in_shows_its_mean(at):
    image = np.zeros((64, 64, 3))
    image[:, :32, 0], image[:24, :, 1], image[40:, 8:, 2] = 200, 160, 128
    planes, rgb = np.diag([17.3, 19.1, 1.0]), np.full(3, 255.0)
    planes[:2, 2] = at, 2.0 * at
    textures.apply_texture(planes, 0, texels(image), 0.0, 0.0, rgb)
    assert rgb == pytest.approx([100.0, 60.0, 42.0], abs=0.6)  # each half is in whole levels


@pytest.mark.parametrize(("size", "centre"), [
    ((40, 88), (20.3, 21.7)), ((91, 38), (17.2, 20.6)),
    ((44, 44), (45.0, -2.0)), ((44, 44), (-2.0, 45.0)),  # but for one corner
])  # fmt: skip
def test_a_lens_ends_where_its_rays_do_though_most_of_the_picture_is_inside(size, centre):
    def unproject(pixels):
        way = (pixels - centre) / [30.0, 31.0]
        angle = np.hypot(*way.T)
        ray = np.column_stack([way * np.sinc(angle / np.pi)[:, None], np.cos(angle)])
        return np.where(angle[:, None] < 1.8, ray, np.nan)

    v, u = np.mgrid[:size[1], :size[0]]
    rays = unproject(np.column_stack([u.ravel(), v.ravel()]).astype(float))
    inside = np.isfinite(rays[:, 0]).reshape(size[::-1])
    assert 0.6 < inside.mean() < 0.98
    np.testing.assert_array_equal(Tiles.of_lens(*size, unproject).valid[:size[1], :size[0]], inside)


def test_a_cover_of_many_tiles_is_seen_where_it_crosses_what_covers_fewer(bench):
    """As in test_edges, in a smaller picture."""
    turn = 0.05
    wall = bench.box([0.01, 2.0, 2.0], [1.01, 0.0, 0.0])
    at = [1.0 + 0.01 * np.cos(turn), 0.1 + 0.01 * np.sin(turn), 0.0]
    plank = bench.box([0.01, 20.0, 0.25], at,
                      orientation=(0.0, 0.0, np.sin(turn / 2), np.cos(turn / 2)))
    K = np.array([[90.0, 0.0, 40.3], [0.0, 80.0, 28.2], [0.0, 0.0, 1.0]])
    view = View(75, 61, looking([0.0, 0.0, 0.0], [1.0, 0.0, 0.0]), K, 0.02)
    _, label = create_renderer("exact", bench.world).measure(view)
    v, u = np.mgrid[:61, :75]
    between = np.abs(v - K[1, 2]) < 18.0
    assert (label[between & (u < K[0, 2] - 9.0)] == plank.body_id).all()
    assert (label[between & (u > K[0, 2] - 9.0)] == wall.body_id).all()
    assert (label[np.abs(v - K[1, 2]) > 23.0] == wall.body_id).all()
