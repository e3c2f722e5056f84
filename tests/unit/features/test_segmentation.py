"""Thresholds, components, borders, coverage."""

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


@pytest.mark.parametrize(("method", "lowest", "highest"), [
    ("fixed", 128, 128), ("otsu", 5, 254), ("adaptive", -1, -1), ("colour", -1, -1)])
def test_every_method_finds_the_target_and_leaves_its_holes(method, lowest, highest) -> None:
    grey = scene(BIG)
    grey[25:28, 45:50] = 255
    settings = SegmentationSettings(method, colour_high=(179, 255, 60))
    target = segment(grey, settings, np.repeat(grey[..., None], 3, axis=2))
    assert target.reason == "" and target.box == BIG and target.pixel_count == 300 - 15
    assert lowest <= target.threshold <= highest and target.touched_borders == ()
    np.testing.assert_array_equal(target.mask != 0, grey < 128)
    mask, level, _ = threshold_image(np.array([[250, 251]], np.uint8), SegmentationSettings(
        threshold=250))
    assert level == 250 and mask.tolist() == [[255, 0]]
    dim = segment(scene(BIG, ground=110, target=30), SegmentationSettings("otsu"))
    assert dim.box == BIG and 30 <= dim.threshold < 110


def test_otsu_does_not_split_an_empty_scene() -> None:
    noise = np.random.default_rng(0).normal(200, 5, (60, 80)).astype(np.uint8)
    target = segment(noise, SegmentationSettings(method="otsu"))
    assert target.pixel_count == 0 and "grey levels apart" in target.reason


def test_adaptive_thresholds_and_bright_targets():
    grey = scene(SMALL, target=0).astype(int)
    slope = np.linspace(60, 0, 80).astype(int)
    grey = np.clip(np.where(grey > 100, 200 - 2 * slope, 40), 0, 255).astype(np.uint8)
    target = segment(
        grey, SegmentationSettings(method="adaptive", adaptive_block=31, component="largest")
    )
    assert target.box == SMALL
    grey = 255 - scene(BIG)
    for method in ("fixed", "otsu", "adaptive"):
        assert segment(grey, SegmentationSettings(method, dark_target=False)).box == BIG


def test_choice_of_the_component() -> None:
    """A speck is none."""
    grey = scene(BIG, SMALL)
    assert segment(grey, SegmentationSettings(component="largest")).box == BIG
    nearest = SegmentationSettings(component="nearest")
    assert segment(scene(BIG, (11, 45, 1, 1)), nearest, previous_centre=(10.0, 45.0)).box == BIG
    assert segment(grey, nearest, previous_centre=(10.0, 45.0)).box == SMALL
    assert segment(grey, nearest).box == BIG
    both = segment(grey, SegmentationSettings(component="all"))
    assert both.pixel_count == 348 and both.box == (5, 20, 55, 26)
    region = np.zeros_like(grey)
    region[38:50, :40] = 255
    assert segment(grey, SegmentationSettings(component="mask"), component_mask=region).box == SMALL
    region[:] = 0
    lost = segment(grey, SegmentationSettings(component="mask"), component_mask=region)
    assert (lost.box, lost.pixel_count, lost.touched_borders) == ((0, 0, 0, 0), 0, ())
    assert "inside the mask" in lost.reason and not lost.mask.any()
    with pytest.raises(SegmentationError, match="80 x 60"):
        segment(grey, SegmentationSettings(component="mask"), component_mask=region[:10])


@pytest.mark.parametrize(("box", "borders"), [
    ((20, 51, 9, 9), ("bottom",)), ((71, 10, 9, 9), ("right",)),
    ((0, 0, 80, 9), ("left", "right", "top"))])
def test_border_contact_is_reported(box, borders) -> None:
    target = segment(scene(box), SegmentationSettings())
    assert target.touched_borders == borders and target.reason == ""


@pytest.mark.parametrize(("boxes", "least", "text"), [
    ([], 4, "no target in view"), ([(20, 20, 1, 1)], 4, "1 pixel"),
    ([(20, 20, 30, 1)], 4, "a line one pixel"), ([(20, 20, 1, 30)], 4, "a line one pixel"),
    ([(0, 0, 80, 60)], 4, "fills the whole image"), ([(20, 20, 4, 4)], 17, "fewer than 17"),
    ([(20, 20, 4, 4)], 16, "")])
def test_unusable_targets_say_why(boxes, least, text: str) -> None:
    reason = segment(scene(*boxes), SegmentationSettings(min_pixels=least)).reason
    assert text in reason and bool(text) == bool(reason)


def test_coverage_of_edges():
    grey = scene((20, 20, 20, 15), ground=200, target=20)
    grey[20:35, 40] = 65  # three quarters covered
    grey[20:35, 19] = 155  # one quarter
    weights, corner = compute_coverage(grey, segment(grey, SegmentationSettings()))
    assert weights.sum() == pytest.approx(15 * 21)
    assert weights[20 - corner[1], 40 - corner[0]] == pytest.approx(0.75)
    assert weights[20 - corner[1], 19 - corner[0]] == pytest.approx(0.25)
    target = segment(scene(BIG), SegmentationSettings())
    with pytest.raises(SegmentationError, match="no contrast"):
        compute_coverage(np.full((60, 80), 90, np.uint8), target)
    grey = scene(BIG, ground=90, target=89)  # one level is enough
    weights, _ = compute_coverage(grey, segment(grey, SegmentationSettings(threshold=89)))
    assert weights.sum() == pytest.approx(300)
    grey = np.full((60, 80), 90, np.uint8)
    labelled = np.zeros((60, 80), np.uint8)
    labelled[20:35, 40:60] = 255
    target = segment(grey, SegmentationSettings("label"), target_mask=labelled)
    weights, _ = compute_coverage(grey, target)
    assert weights.sum() == 300.0 and set(np.unique(weights)) == {0.0, 1.0}


SHADED = np.linspace(40, 160, 60)[:, None] * np.ones((1, 80))  # from dark above to light below


def shaded(box: tuple[int, int, int, int], times: float, ground: np.ndarray | float) -> np.ndarray:
    """Return an image (60, 80) with a shaded target at (column, row, width, height)."""
    column, row, width, height = box
    grey = np.array(ground * np.ones((60, 80)))
    grey[row : row + height, column : column + width] = (
        times * SHADED[row : row + height, column : column + width])
    return grey


def test_a_label_or_a_colour_is_the_target():
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
    rgb = np.full((60, 80, 3), 255, np.uint8)
    rgb[10:20, 10:30] = (230, 10, 25)
    rgb[40:50, 10:30] = (10, 10, 230)
    settings = SegmentationSettings("colour", colour_low=(170, 100, 50), colour_high=(10, 255, 255))
    target = segment(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), settings, rgb)
    assert target.box == (10, 10, 20, 10) and target.threshold == -1.0
    with pytest.raises(SegmentationError, match="needs a colour image"):
        segment(rgb[..., 0], settings)


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
