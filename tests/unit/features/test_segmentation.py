"""Thresholds, components, borders, coverage."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from aras_visual_servo_camera.errors import SegmentationError
from aras_visual_servo_camera.pixel_coverage import compute_coverage
from aras_visual_servo_camera.segmentation_settings import SegmentationSettings
from aras_visual_servo_camera.segmented_target import segment, threshold_image


def scene(*boxes: tuple[int, int, int, int], ground: int = 255, target: int = 5) -> np.ndarray:
    """Return a white image (60, 80) with dark boxes (column, row, width, height)."""
    grey = np.full((60, 80), ground, np.uint8)
    for column, row, width, height in boxes:
        grey[row : row + height, column : column + width] = target
    return grey


BIG, SMALL = (40, 20, 20, 15), (5, 40, 8, 6)


def test_fixed_threshold_is_the_originals() -> None:
    grey = np.arange(256, dtype=np.uint8).reshape(16, 16)
    mask, level, _ = threshold_image(grey, SegmentationSettings(threshold=250))
    expected = cv2.threshold(grey, 250, 255, cv2.THRESH_BINARY_INV)[1]
    np.testing.assert_array_equal(mask, expected)
    assert level == 250 and mask[15, 10] == 255 and mask[15, 11] == 0


@pytest.mark.parametrize(
    "settings",
    [
        SegmentationSettings(),
        SegmentationSettings(method="otsu"),
        SegmentationSettings(method="adaptive"),
        SegmentationSettings(method="colour", colour_high=(179, 255, 60)),
    ],
    ids=lambda s: s.method,
)
def test_every_method_finds_the_target(settings: SegmentationSettings) -> None:
    grey = scene(BIG)
    target = segment(grey, settings, np.repeat(grey[..., None], 3, axis=2))
    assert target.reason == "" and target.box == BIG and target.pixel_count == 300
    if settings.method == "otsu":
        dim = segment(scene(BIG, ground=110, target=30), settings)
        assert dim.box == BIG and 30 <= dim.threshold < 110
    np.testing.assert_array_equal(target.mask != 0, grey < 128)
    assert target.touched_borders == ()


def test_otsu_does_not_split_an_empty_scene() -> None:
    noise = np.random.default_rng(0).normal(200, 5, (60, 80)).astype(np.uint8)
    target = segment(noise, SegmentationSettings(method="otsu"))
    assert target.pixel_count == 0 and "grey levels apart" in target.reason


def test_adaptive_ignores_a_slope_of_light() -> None:
    grey = scene(SMALL, target=0).astype(int)
    slope = np.linspace(60, 0, 80).astype(int)
    grey = np.clip(np.where(grey > 100, 200 - 2 * slope, 40), 0, 255).astype(np.uint8)
    target = segment(
        grey, SegmentationSettings(method="adaptive", adaptive_block=31, component="largest")
    )
    assert target.box == SMALL


def test_colour_range_may_run_through_red() -> None:
    rgb = np.full((60, 80, 3), 255, np.uint8)
    rgb[10:20, 10:30] = (230, 10, 25)
    rgb[40:50, 10:30] = (10, 10, 230)
    settings = SegmentationSettings("colour", colour_low=(170, 100, 50), colour_high=(10, 255, 255))
    target = segment(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), settings, rgb)
    assert target.box == (10, 10, 20, 10)
    with pytest.raises(SegmentationError, match="needs a colour image"):
        segment(rgb[..., 0], settings)


def test_bright_target_on_dark_ground() -> None:
    grey = 255 - scene(BIG)
    for method in ("fixed", "otsu", "adaptive"):
        assert segment(grey, SegmentationSettings(method, dark_target=False)).box == BIG


def test_choice_of_the_component() -> None:
    grey = scene(BIG, SMALL)
    assert segment(grey, SegmentationSettings(component="largest")).box == BIG
    nearest = SegmentationSettings(component="nearest")
    assert segment(grey, nearest, previous_centre=(10.0, 45.0)).box == SMALL
    assert segment(grey, nearest).box == BIG
    both = segment(grey, SegmentationSettings(component="all"))
    assert both.pixel_count == 348 and both.box == (5, 20, 55, 26)
    region = np.zeros_like(grey)
    region[38:50, :40] = 255
    assert segment(grey, SegmentationSettings(component="mask"), component_mask=region).box == SMALL
    region[:] = 0
    lost = segment(grey, SegmentationSettings(component="mask"), component_mask=region)
    assert lost.pixel_count == 0 and "inside the mask" in lost.reason
    with pytest.raises(SegmentationError, match="80 x 60"):
        segment(grey, SegmentationSettings(component="mask"), component_mask=region[:10])


def test_specks_do_not_steal_the_nearest_target() -> None:
    grey = scene(BIG, (11, 45, 1, 1))
    assert (
        segment(grey, SegmentationSettings(component="nearest"), previous_centre=(10.0, 45.0)).box
        == BIG
    )


def test_holes_stay_holes() -> None:
    grey = scene(BIG)
    grey[25:28, 45:50] = 255
    target = segment(grey, SegmentationSettings())
    assert target.pixel_count == 300 - 15 and target.mask[26, 46] == 0


@pytest.mark.parametrize(
    ("box", "borders"),
    [
        ((0, 10, 9, 9), ("left",)),
        ((71, 10, 9, 9), ("right",)),
        ((20, 0, 9, 9), ("top",)),
        ((20, 51, 9, 9), ("bottom",)),
        ((0, 0, 80, 9), ("left", "right", "top")),
    ],
)
def test_border_contact_is_reported(box, borders) -> None:
    target = segment(scene(box), SegmentationSettings())
    assert target.touched_borders == borders and target.reason == ""


@pytest.mark.parametrize(
    ("grey", "text"),
    [
        (scene(), "no target in view"),
        (scene((20, 20, 1, 1)), "1 pixel"),
        (scene((20, 20, 30, 1)), "a line one pixel wide"),
        (scene((20, 20, 1, 30)), "a line one pixel wide"),
        (scene(ground=0), "fills the whole image"),
    ],
    ids=["white", "one pixel", "row", "column", "black"],
)
def test_unusable_targets_say_why(grey, text: str) -> None:
    assert text in segment(grey, SegmentationSettings()).reason


def test_no_target_is_an_empty_box() -> None:
    target = segment(scene(), SegmentationSettings())
    assert (target.box, target.pixel_count, target.touched_borders) == ((0, 0, 0, 0), 0, ())
    assert cv2.countNonZero(target.mask) == 0
    region = np.zeros((60, 80), np.uint8)
    target = segment(scene(BIG), SegmentationSettings(component="mask"), component_mask=region)
    assert (target.box, target.pixel_count, target.touched_borders) == ((0, 0, 0, 0), 0, ())


def test_methods_without_one_threshold_say_minus_one() -> None:
    grey = scene(BIG)
    colour = np.repeat(grey[..., None], 3, axis=2)
    for method, level in (("fixed", 128.0), ("adaptive", -1.0), ("colour", -1.0)):
        assert segment(grey, SegmentationSettings(method), colour).threshold == level
    red = SegmentationSettings("colour", colour_low=(170, 0, 0), colour_high=(10, 255, 60))
    assert segment(grey, red, colour).threshold == -1.0


@pytest.mark.parametrize(
    ("changes", "refused"),
    [({"threshold": -0.5}, True), ({"threshold": 0}, False), ({"threshold": 255}, False),
     ({"threshold": 255.5}, True), ({"adaptive_block": 3}, False), ({"adaptive_block": 1}, True),
     ({"min_pixels": 1}, False), ({"min_pixels": 0}, True), ({"colour_low": (0, 0, 0)}, False),
     ({"colour_low": (-1, 0, 0)}, True), ({"colour_high": (179, 255, 255)}, False),
     ({"colour_high": (180, 0, 0)}, True), ({"colour_high": (0, 256, 0)}, True),
     ({"colour_high": (0, 0, 256)}, True), ({"colour_low": (0, 0, 0, 0)}, True)],
)
def test_limits_of_the_settings(changes, refused: bool) -> None:
    if refused:
        with pytest.raises(SegmentationError):
            SegmentationSettings(**changes)
    else:
        SegmentationSettings(**changes)


def test_min_pixels_is_the_smallest_target() -> None:
    assert segment(scene((20, 20, 4, 4)), SegmentationSettings(min_pixels=16)).reason == ""
    assert (
        "fewer than 17"
        in segment(scene((20, 20, 4, 4)), SegmentationSettings(min_pixels=17)).reason
    )


def test_coverage_of_a_soft_edge() -> None:
    grey = scene((20, 20, 20, 15), ground=200, target=20)
    grey[20:35, 40] = 65  # three quarters covered
    grey[20:35, 19] = 155  # one quarter
    weights, corner = compute_coverage(grey, segment(grey, SegmentationSettings()))
    assert weights.sum() == pytest.approx(15 * 21)
    assert weights[20 - corner[1], 40 - corner[0]] == pytest.approx(0.75)
    assert weights[20 - corner[1], 19 - corner[0]] == pytest.approx(0.25)


def test_noise_away_from_the_edge_has_no_say() -> None:
    random = np.random.default_rng(1)
    clean = scene(BIG, ground=220, target=30)
    noisy = np.clip(clean + random.normal(0, 5, clean.shape), 0, 255).astype(np.uint8)
    weights, _ = compute_coverage(noisy, segment(noisy, SegmentationSettings()))
    band = (weights != 0) & (weights != 1)
    assert band.sum() < 5 * 2 * (20 + 15 + 4)
    assert weights.sum() == pytest.approx(300, rel=0.003)


def test_coverage_needs_contrast() -> None:
    target = segment(scene(BIG), SegmentationSettings())
    with pytest.raises(SegmentationError, match="no contrast"):
        compute_coverage(np.full((60, 80), 90, np.uint8), target)


def test_one_grey_level_is_contrast_enough() -> None:
    grey = scene(BIG, ground=90, target=89)
    weights, _ = compute_coverage(grey, segment(grey, SegmentationSettings(threshold=89)))
    assert weights.sum() == pytest.approx(300)


SHADED = np.linspace(40, 160, 60)[:, None] * np.ones((1, 80))  # from dark above to light below


def shaded(box: tuple[int, int, int, int], times: float, ground: np.ndarray | float) -> np.ndarray:
    """Return an image (60, 80) with a shaded target at (column, row, width, height)."""
    column, row, width, height = box
    grey = np.array(ground * np.ones((60, 80)))
    grey[row : row + height, column : column + width] = (
        times * SHADED[row : row + height, column : column + width])
    return grey


def test_a_label_is_the_target_whatever_its_grey_and_however_many_its_pieces() -> None:
    grey = shaded(BIG, 1.0, 105.0).astype(np.uint8)  # in its middle as light as the ground
    labelled = np.zeros((60, 80), np.uint8)
    labelled[20:35, 40:60] = labelled[5:9, 3:9] = 255
    target = segment(grey, SegmentationSettings("label"), target_mask=labelled)
    assert (target.pixel_count, target.component, target.is_uneven) == (300 + 24, "all", True)
    assert target.box == (3, 5, 57, 30)
    with pytest.raises(SegmentationError, match="needs the simulator's label image"):
        segment(grey, SegmentationSettings("label"))
    lost = segment(grey, SegmentationSettings("label", label="box"), target_mask=0 * labelled)
    assert lost.reason == "the link 'box' (setting `label`) is not in view"


def test_a_shaded_targets_edge_pixels_are_divided_by_the_levels_around_them() -> None:
    grey = shaded((20, 20, 20, 25), 1.0, 230.0)
    for row in range(20, 45):
        inner = SHADED[row, 0]
        grey[row, 40] = 230.0 + 0.75 * (inner - 230.0)  # three quarters covered
        grey[row, 19] = 230.0 + 0.25 * (inner - 230.0)  # one quarter
    grey = np.round(grey).astype(np.uint8)
    labelled = np.zeros((60, 80), np.uint8)
    labelled[20:45, 20:41] = 255
    target = segment(grey, SegmentationSettings("label"), target_mask=labelled)
    weights, (left, top) = compute_coverage(grey, target)
    assert weights[32 - top, 40 - left] == pytest.approx(0.75, abs=0.02)
    assert weights[32 - top, 19 - left] == pytest.approx(0.25, abs=0.02)
    assert weights.sum() == pytest.approx(25 * 21, rel=2e-3)


def test_without_contrast_the_edge_is_the_masks() -> None:
    grey = np.full((60, 80), 90, np.uint8)
    labelled = np.zeros((60, 80), np.uint8)
    labelled[20:35, 40:60] = 255
    target = segment(grey, SegmentationSettings("label"), target_mask=labelled)
    weights, _ = compute_coverage(grey, target)
    assert weights.sum() == 300.0 and set(np.unique(weights)) == {0.0, 1.0}


def test_what_is_near_a_colour_is_the_target_in_light_and_in_shade() -> None:
    rgb = np.full((60, 80, 3), 200, np.uint8)
    rgb[20:35, 40:50], rgb[20:35, 50:60] = (200, 40, 30), (120, 24, 18)  # lit, and in shade
    rgb[40:46, 5:13] = (40, 60, 200)
    grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    red = SegmentationSettings("nearest_colour", near_colour=(180, 36, 27))
    assert segment(grey, red, rgb).box == BIG
    # Chroma differs by 26.4, and lightness by 18.0, which counts a quarter: by 26.8 together.
    lit = SegmentationSettings("nearest_colour", near_colour=(200, 40, 30), colour_distance=28)
    assert segment(grey, lit, rgb).box == BIG
    blue = SegmentationSettings("nearest_colour", near_colour=(40, 60, 200))
    assert segment(grey, blue, rgb).box == SMALL
    narrow = SegmentationSettings("nearest_colour", near_colour=(200, 40, 30), colour_distance=5)
    assert segment(grey, narrow, rgb).box == (40, 20, 10, 15)
    with pytest.raises(SegmentationError, match="needs a colour image"):
        segment(grey, red)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"method": "nearest_colour"}, "near_colour is .., must be red, green and blue"),
        ({"near_colour": (1, 2, 256)}, "near_colour is .1.0, 2.0, 256.0., must be red"),
        ({"method": "watershed"}, "method is .watershed.: use one of fixed"),
        ({"component": "red"}, "component is .red.: use one of all"),
        ({"threshold": 300}, "threshold is 300.0, must be <= 255"),
        ({"adaptive_block": 4}, "must be odd"),
        ({"colour_low": (200, 0, 0)}, "hue 0-179"),
    ],
)
def test_impossible_settings_are_refused(changes, text: str) -> None:
    with pytest.raises(SegmentationError, match=text):
        SegmentationSettings(**changes)
