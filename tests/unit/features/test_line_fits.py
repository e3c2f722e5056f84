"""Estimated errors of corners from the scatter of edge points, compared with noisy outlines."""

import numpy as np
import pytest

from aras_visual_servo_camera.contour import find_corners, fit_corners
from aras_visual_servo_camera.line_fits import (
    FittedLine,
    compute_crossing_spread,
    compute_rms_deviation,
)

# px: an acute corner, which errs most, and a short side.
UNEVEN = np.array([[0.0, 0.0], [60.0, 4.0], [14.0, 22.0], [2.0, 16.0]])
SIGMA = 0.05


def outlines(count, corners=UNEVEN, sigma=SIGMA):
    random = np.random.default_rng(4)
    ways = np.roll(corners, -1, axis=0) - corners
    lengths = np.linalg.norm(ways, axis=1)
    sides = [a + np.arange(0.5, length)[:, None] / length * way
             for a, way, length in zip(corners, ways, lengths, strict=True)]
    for _ in range(count):
        yield np.vstack([
            side + sigma * random.normal(size=(len(side), 1)) * [way[1], -way[0]] / length
            for side, way, length in zip(sides, ways, lengths, strict=True)
        ])  # fmt: skip


def test_each_corner_errs_as_its_own_sides_tell_and_neighbours_together():
    errors, told = [], []
    for outline in outlines(400):
        corners, spread = fit_corners(outline)
        order = np.linalg.norm(corners[:, None] - UNEVEN, axis=2).argmin(axis=0)
        errors.append((corners[order] - UNEVEN).ravel())
        rows = np.column_stack([2 * order, 2 * order + 1]).ravel()
        told.append(spread[rows] @ spread[rows].T)
    found, told = np.cov(np.transpose(errors)), np.mean(told, axis=0)
    deviations = np.sqrt(np.diag(found))
    assert deviations.max() > 3.0 * deviations.min()  # one number for all would be none of theirs
    np.testing.assert_allclose(np.sqrt(np.diag(told)), deviations, rtol=0.2)
    correlation = found / np.outer(deviations, deviations)
    expected = told / np.sqrt(np.outer(np.diag(told), np.diag(told)))
    assert np.abs(correlation - np.eye(8)).max() > 0.8
    np.testing.assert_allclose(expected, correlation, atol=0.2)
    assert compute_rms_deviation(spread) == pytest.approx(np.sqrt(np.mean(deviations**2)), rel=0.5)


def test_a_side_along_a_row_of_pixels_is_not_exact_because_its_points_scatter_little():
    lines = [
        FittedLine(np.array([5.0, 0.0]), np.array([0.0, 1.0]), 10.0, 9.0, 0.0),
        FittedLine(np.array([0.0, 5.0]), np.array([1.0, 0.0]), 10.0, 9.0, 0.1),
    ]
    spread = compute_crossing_spread(lines)
    across_each = np.linalg.norm(spread[0]), np.linalg.norm(spread[1])
    assert 0.3 * across_each[0] < across_each[1] < across_each[0]


def test_points_less_than_a_pixel_apart_count_as_so_many_as_are_independent():
    along = np.linspace(0.0, 20.0, 81)
    points = np.column_stack([along, 0.1 * np.sin(along)])
    all_of_them, independent = (
        FittedLine.fit(points, np.array([0.0, 1.0]), count) for count in (81.0, 20.0)
    )
    assert independent.squares / independent.count == pytest.approx(
        all_of_them.squares / all_of_them.count
    )
    assert independent.length == pytest.approx(all_of_them.length * np.sqrt(20.0 / 81.0))


def test_lines_that_hardly_meet_leave_the_corner_open_only_across_them():
    lines = [FittedLine(np.array([x, 0.0]), np.array([slope, 1.0]) / np.hypot(slope, 1.0), 10.0,
                        9.0, 0.1) for x, slope in ((-10.0, 0.0), (10.0, 0.01))]  # fmt: skip
    spread = compute_crossing_spread(lines)
    assert np.isfinite(spread).all() and np.abs(spread[0::2]).max() < np.abs(spread[1::2]).max()


def test_corners_are_the_same_with_and_without_their_spread():
    outline = next(outlines(1))
    np.testing.assert_array_equal(fit_corners(outline)[0], find_corners(outline))
