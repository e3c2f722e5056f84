"""Outline and corners of a target, compared with the drawn shape."""

import numpy as np
import pytest
from feature_cases import L_SHAPE, SQUARE, TARGET, View, grey_image, rotation

from aras_visual_servo_camera.camera_model import CameraModel, subdivide
from aras_visual_servo_camera.contour import (
    extract_outline,
    find_corners,
    fit_corners,
    match_corners,
)
from aras_visual_servo_camera.errors import SegmentationError
from aras_visual_servo_camera.intersection_accuracy import (
    FittedLine,
    compute_crossing_spread,
    compute_rms_deviation,
)
from aras_visual_servo_camera.segmentation_settings import SegmentationSettings
from aras_visual_servo_camera.segmented_target import segment

CAMERA = CameraModel(320, 240, (200.0, 0, 158.3, 0, 201.0, 121.6, 0, 0, 1))
SCALES = {"square": SQUARE, "L": L_SHAPE, "target": 3.0 * TARGET}


def picture(shape, tilt, turn, depth=0.5):
    """The shape's corners, normalised, its image and the outline found in it."""
    R = rotation([*np.radians(tilt), 0.0]) @ rotation([0.0, 0.0, np.radians(turn)])
    view = View(shape, R, np.array([0.03, -0.02, depth]))
    grey = grey_image(view.image, CAMERA.pinhole)
    return view.image, extract_outline(grey, segment(grey, SegmentationSettings()), CAMERA)


def nearest(points, others):
    return np.linalg.norm(points[:, None] - others[None], axis=2).min(axis=1)


@pytest.mark.parametrize("begin", [0, 40, 60, 95])
def test_a_sharp_corner_that_is_blunt_is_one(begin):
    """Ten degrees between two sides of 100 px that end 1.8 px apart; points a pixel apart."""
    ends = np.array([[0.0, -10.0], [100.0, -0.9], [100.0, 0.9], [0.0, 10.0]])
    sides = [a + np.linspace(0.0, 1.0, n, endpoint=False)[:, None] * (b - a) for a, b, n in zip(
        ends, np.roll(ends, -1, axis=0), (100, 2, 100, 20), strict=True)]
    corners = find_corners(np.roll(np.vstack(sides), begin, axis=0), max_bend=1e-3)
    tip = np.array([100.0 + 0.9 * 100.0 / 9.1, 0.0])
    assert len(corners) == 3
    assert nearest(np.vstack([tip, ends[[0, 3]]]), corners).max() < 0.2


@pytest.mark.parametrize(("turn", "tilt"), [(0.0, (0.0, 0.0)), (17.0, (15.0, -10.0)),
                                            (133.0, (0.0, 0.0))])  # fmt: skip
@pytest.mark.parametrize("shape", SCALES)
def test_corners_are_where_the_shape_has_them(shape, tilt, turn):
    drawn, outline = picture(SCALES[shape], tilt, turn)
    corners = find_corners(outline)
    assert corners.shape == drawn.shape
    assert nearest(corners, drawn).max() < 0.15 / 200.0  # 0.15 pixel
    x, y = corners.T
    assert np.dot(x, np.roll(y, -1)) > np.dot(y, np.roll(x, -1))  # positive turn
    # neighbours of a corner are its neighbours in the shape
    order = np.linalg.norm(corners[:, None] - drawn[None], axis=2).argmin(axis=1)
    assert set(np.abs(np.diff(np.append(order, order[0])))) <= {1, len(drawn) - 1}


STEPS = 27.0 * np.array([[-0.5, -0.7], [0.5, -0.7], [0.5, 0.3], [0.15, 0.3], [0.15, 0.55],
                         [-0.35, 0.55], [-0.35, 0.3], [-0.5, 0.3]])  # px
IRREGULAR = np.array([[-0.5, -0.4], [0.5, -0.5], [0.35, 0.45], [-0.3, 0.3]])


@pytest.mark.parametrize(("shape", "turn"), [
    *((STEPS + [0.0, row], 0.0) for row in np.arange(4) / 4.0),
    *((width * IRREGULAR, turn) for width in (12.0, 14.5, 22.0) for turn in (3.0, 45.0, 133.0))])
def test_pixels_are_no_corners_and_short_sides_lie_on_no_row(shape, turn):
    """Half of the images of four corners, 12 to 22 px apart, showed five to seven; and corners of
    steps of four pixels jumped by two where a side lay along a row."""
    turn = rotation([0.0, 0.0, np.radians(turn)])[:2, :2]
    shape = shape @ turn.T / 200.0 + ([0.0013, 0.0021] if len(shape) == 4 else 0.0)
    grey = grey_image(shape, CAMERA.pinhole)
    corners = find_corners(extract_outline(grey, segment(grey, SegmentationSettings()), CAMERA))
    assert corners.shape == shape.shape
    assert nearest(corners, shape).max() < 0.5 / 200.0  # half a pixel


def test_corners_through_a_lens():
    """The lens bends the sides in the picture; in normalised coordinates they are straight."""
    lens = CameraModel(320, 240, CAMERA.K, (-0.33, 0.117, 0.0, 0.0))
    drawn, _ = picture(1.6 * SQUARE, (8.0, 0.0), 10.0)
    u, v = lens.project(*subdivide(drawn, 60).T)
    bent = np.stack([(u - 158.3) / 200.0, (v - 121.6) / 201.0], axis=1)
    grey = grey_image(bent, CAMERA.pinhole)
    corners = find_corners(extract_outline(grey, segment(grey, SegmentationSettings()), lens))
    assert len(corners) == 4
    assert nearest(corners, drawn).max() < 0.3 / 200.0


def test_outlines_that_cannot_be_used_are_refused():
    v, u = np.mgrid[:240, :320]
    radius = np.hypot(u - CAMERA.pinhole.cx, v - CAMERA.pinhole.cy)
    for slope, refused in ((6.0, True), (50.0, False)):  # grey levels per pixel
        grey = np.clip(60.0 + slope * (radius - 60.0), 0.0, 230.0).astype(np.uint8)
        target = segment(grey, SegmentationSettings(threshold=100))
        if refused:
            with pytest.raises(SegmentationError, match="too blurred: focus the camera"):
                extract_outline(grey, target, CAMERA)
        else:
            assert len(extract_outline(grey, target, CAMERA)) > 300
    angle = np.linspace(0, 2 * np.pi, 4000, endpoint=False)
    disc = 0.2 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    with pytest.raises(SegmentationError, match="must be 3 to 32"):
        find_corners(disc, max_bend=1e-4)
    grey = np.full((240, 320), 255, np.uint8)
    grey[100:102, 100:102] = 0
    with pytest.raises(SegmentationError, match="outline"):
        extract_outline(grey, segment(grey, SegmentationSettings(min_pixels=1)), CAMERA)
    model, _ = picture(SCALES["target"], (0.0, 0.0), 0.0)
    _, outline = picture(SCALES["L"], (0.0, 0.0), 10.0)
    with pytest.raises(SegmentationError, match="does not match the 8 corners"):
        match_corners(outline, model)


@pytest.mark.parametrize("turn", [0.0, 31.0, 250.0])
@pytest.mark.parametrize("depth", [1.0, 2.6])
def test_a_small_targets_corners_are_those_of_its_model(turn, depth):
    """Fifteen pixels across, the plates show from 7 to 11 corners of their eight."""
    model, _ = picture(SCALES["target"], (0.0, 0.0), 0.0)
    drawn, outline = picture(SCALES["target"], (12.0, -8.0), turn, depth)
    for known, wanted in (
        (model, drawn), (model[::-1], drawn[::-1]), (np.roll(model, 3, 0), np.roll(drawn, 3, 0))
    ):  # fmt: skip
        corners = match_corners(outline, known)
        assert np.linalg.norm(corners - wanted, axis=1).max() < 1.2 / 200.0


# px: an acute corner, which errs most, and a short side.
UNEVEN = np.array([[0.0, 0.0], [60.0, 4.0], [14.0, 22.0], [2.0, 16.0]])


def test_each_corner_errs_as_its_own_sides_tell_and_neighbours_together():
    errors, told, random = [], [], np.random.default_rng(4)
    ways = np.roll(UNEVEN, -1, axis=0) - UNEVEN
    lengths = np.linalg.norm(ways, axis=1)
    for _ in range(400):
        outline = np.vstack([
            a + (np.arange(0.5, length)[:, None] * way
                 + 0.05 * random.normal(size=(int(length + 0.5), 1)) * [way[1], -way[0]]) / length
            for a, way, length in zip(UNEVEN, ways, lengths, strict=True)])
        corners, spread = fit_corners(outline)
        order = np.linalg.norm(corners[:, None] - UNEVEN, axis=2).argmin(axis=0)
        errors.append((corners[order] - UNEVEN).ravel())
        rows = np.column_stack([2 * order, 2 * order + 1]).ravel()
        told.append(spread[rows] @ spread[rows].T)
    np.testing.assert_array_equal(corners, find_corners(outline))
    found, told = np.cov(np.transpose(errors)), np.mean(told, axis=0)
    deviations = np.sqrt(np.diag(found))
    assert deviations.max() > 3.0 * deviations.min()  # one number for all would be none of theirs
    np.testing.assert_allclose(np.sqrt(np.diag(told)), deviations, rtol=0.2)
    correlation = found / np.outer(deviations, deviations)
    expected = told / np.sqrt(np.outer(np.diag(told), np.diag(told)))
    assert np.abs(correlation - np.eye(8)).max() > 0.8
    np.testing.assert_allclose(expected, correlation, atol=0.2)
    assert compute_rms_deviation(spread) == pytest.approx(np.sqrt(np.mean(deviations**2)), rel=0.5)


def test_spread_of_fitted_lines_and_of_their_crossing():
    spread = compute_crossing_spread([
        FittedLine(np.array([5.0, 0.0]), np.array([0.0, 1.0]), 10.0, 9.0, 0.0),
        FittedLine(np.array([0.0, 5.0]), np.array([1.0, 0.0]), 10.0, 9.0, 0.1)])
    across_each = np.linalg.norm(spread[0]), np.linalg.norm(spread[1])
    assert 0.3 * across_each[0] < across_each[1] < across_each[0]
    along = np.linspace(0.0, 20.0, 81)
    points = np.column_stack([along, 0.1 * np.sin(along)])
    every, some = (FittedLine.fit(points, np.array([0.0, 1.0]), count) for count in (81.0, 20.0))
    assert some.squares / some.count == pytest.approx(every.squares / every.count)
    assert some.length == pytest.approx(every.length * np.sqrt(20.0 / 81.0))
    lines = [FittedLine(np.array([x, 0.0]), np.array([slope, 1.0]) / np.hypot(slope, 1.0), 10.0,
                        9.0, 0.1) for x, slope in ((-10.0, 0.0), (10.0, 0.01))]  # fmt: skip
    spread = compute_crossing_spread(lines)
    assert np.isfinite(spread).all() and np.abs(spread[0::2]).max() < np.abs(spread[1::2]).max()
