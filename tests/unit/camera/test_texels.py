"""Preparation of textures: reduced sizes, and sample positions in a pixel."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from aras_sim_bridge.rendering.textures import DIRECTIONS, PLACES, SAMPLE_POINTS, TURNS, Textures


def test_textures_lie_one_after_the_other_with_all_their_halves(tmp_path):
    rng, files = np.random.default_rng(2), {}
    for name, shape, size in (("a", (30, 41), 512), ("b", (20, 700), 512), ("d", (1500, 20), 1024)):
        file = str(tmp_path / f"{name}.png")
        cv2.imwrite(file, rng.integers(0, 256, (*shape, 3)).astype(np.uint8))
        files[file] = (cv2.resize(cv2.imread(file), (size, size), interpolation=cv2.INTER_AREA))
    files[str(tmp_path / "missing.png")] = np.full((512, 512, 3), 255, np.uint8)
    made, end = Textures(set(files)), 0
    for file, bgr in files.items():
        at = made.find_layer(file)
        assert at == end and made.texels[at] == len(bgr)
        half, at = bgr[::-1, :, ::-1].astype(float), at + 1
        while True:
            one = made.texels[at:at + half.shape[0]**2].reshape(half.shape[:2])
            for k in range(3):
                assert (one >> np.uint64(21 * k) & np.uint64(2**21 - 1) == half[..., k]).all()
            at += half.shape[0]**2
            if len(half) == 1:
                break
            # The mean of two by two, to the nearest even number.
            half = np.rint((half[::2, ::2] + half[1::2, ::2] + half[::2, 1::2]
                            + half[1::2, 1::2]) / 4)
        end = at
    assert len(made.texels) == end


def test_directions_go_round_half_a_turn_nearly_evenly():
    angle = np.arctan2(DIRECTIONS[:, 1], DIRECTIONS[:, 0]) % np.pi
    order = np.sort(np.where(angle > np.pi - 1e-9, 0.0, angle))
    assert len(order) == TURNS and np.hypot(*DIRECTIONS.T) == pytest.approx(1.0)
    step = np.diff([*order, np.pi + order[0]])
    assert step.min() > 0.7 * np.pi / TURNS and step.max() < 1.4 * np.pi / TURNS


def test_places_in_a_pixel_stand_for_equal_parts_of_it():
    """Along a direction the areas between them are alike; across it they are where the golden
    section puts them between the pixel's two sides."""
    at = (np.arange(400) + 0.5) / 400 - 0.5
    pixel = np.stack(np.meshgrid(at, at), axis=2).reshape(-1, 2)
    for k, (c, s) in enumerate(DIRECTIONS):
        before = np.sort(pixel @ (c, s))
        for n in (1, 4, 7, PLACES):
            along, across = SAMPLE_POINTS[k, n, :n].T
            wanted = before[((np.arange(n) + 0.5) / n * len(before)).astype(int)]
            assert np.abs(along - wanted).max() < 4e-3
            # x = along c - across s, y = along s + across c, both within half a pixel.
            with np.errstate(divide="ignore"):
                ends = np.array([[(along * c - side) / s, (side - along * s) / c]
                                 for side in (-0.5, 0.5)])
            low, high = ends.min(axis=0).max(axis=0), ends.max(axis=0).min(axis=0)
            share = (across - low) / (high - low)
            golden = (np.arange(n) - (n - 1) / 2) * (np.sqrt(5.0) - 1.0) / 2 + 0.5
            apart = (share - golden + 0.5) % 1.0 - 0.5
            assert np.abs(apart).max() < 0.01
            assert (SAMPLE_POINTS[k, n, n:] == 0.0).all()
    assert sorted(map(tuple, SAMPLE_POINTS[0, 0, :4])) == [
        (-0.25, -0.25), (-0.25, 0.25), (0.25, -0.25), (0.25, 0.25)]
