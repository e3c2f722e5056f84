"""Segmentation of the target's pixels in an image by grey level, colour or label.

Pixels in a hole of the target do not belong to the target. The centre of the first pixel has the
column 0 and the row 0. A box is (column, row, width, height).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import compress
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from .errors import SegmentationError, VisionError
from .markers import MarkerChoice
from .segmentation_settings import BY_COLOUR, SegmentationSettings

Mask = NDArray[np.uint8]
Box = tuple[int, int, int, int]
NO_BOX: Box = (0, 0, 0, 0)

# segmentation methods whose target can have several grey levels
UNEVEN_METHODS = (*BY_COLOUR, "label")
# Weight of lightness in the distance of two colours. It is low, because shading changes the
# lightness, but not the hue.
LIGHTNESS = 0.25
COMPONENT_DESCRIPTIONS = {
    "largest": "the largest is the target",
    "nearest": "the one nearest to the target's last position is the target",
    "mask": "the one with most pixels in the mask image is the target",
    "marker": "the objects inside the marker are the target",
}


@dataclass(eq=False)
class SegmentedTarget:
    """The target's pixels in one image.

    Attributes:
        mask: (rows, columns) 255 on the target, 0 elsewhere; it has the size of the image.
        box: bounding box (column, row, width, height); (0, 0, 0, 0) if there is no target.
        pixel_count: number of pixels of the target.
        threshold: threshold as a grey level; -1 if the method has no single threshold.
        touched_borders: borders of the image that the target touches: 'left', 'right', 'top',
            'bottom'.
        reason: explanation why there is no usable target, otherwise empty. A target that touches a
            border is usable.
        component_count: number of connected components of target colour in the image.
        component: rule by which the target was chosen among the components, as in Segmentation, or
            'marker'.
        is_uneven: True if the segmentation method allows several grey levels on the target.
        coverage: image, band and result of the last call of `compute_coverage`; None before it.
    """

    mask: Mask
    box: Box
    pixel_count: int
    threshold: float
    touched_borders: tuple[str, ...] = ()
    reason: str = ""
    component_count: int = 1
    component: str = "all"
    is_uneven: bool = False
    coverage: tuple[Mask, int, Any] | None = field(default=None, repr=False)

    def describe(self) -> str:
        """Return a text that describes which object was chosen as the target, and by which rule."""
        column, row, width, height = self.box
        place = (
            f"{self.pixel_count} pixels around column {column + width // 2}, "
            f"row {row + height // 2}"
        )
        if self.component == "all":
            return f"all pixels of target colour together are the target: {place}"
        if self.component_count == 1:
            return f"the only object of target colour is the target: {place}"
        chosen = COMPONENT_DESCRIPTIONS[self.component]
        return f"of {self.component_count} objects of target colour, {chosen}: {place}"


def threshold_image(
    grey: Mask, settings: SegmentationSettings, colour: NDArray[np.uint8] | None = None,
    target_mask: Mask | None = None,
) -> tuple[Mask, float, str]:
    """Find all pixels that may belong to the target, by the method of the settings.

    Args:
        grey: (rows, columns) uint8 image.
        settings: method and its parameters.
        colour: (rows, columns, 3) RGB image, for the methods 'colour' and 'nearest_colour'.
        target_mask: (rows, columns) 255 on the target, 0 elsewhere, for the method 'label'.

    Returns:
        The mask (rows, columns), 255 for these pixels; the threshold, or -1 if there is no single
        threshold; and the reason why there is no target, or '' if there is one.

    Raises:
        SegmentationError: the image that the method needs is missing.
    """
    if settings.method == "label":
        if target_mask is None:
            raise SegmentationError(
                "segmentation 'label' needs the simulator's label image; set `segmentation: true` "
                "in the settings of the simulated camera"
            )
        hidden = f"the link '{settings.label}' (setting `label`) is not in view"
        return target_mask, -1.0, "" if target_mask.any() else hidden
    kind = cv2.THRESH_BINARY_INV if settings.dark_target else cv2.THRESH_BINARY
    if settings.method == "fixed":
        return cv2.threshold(grey, settings.threshold, 255, kind)[1], settings.threshold, ""
    if settings.method == "otsu":
        level, mask = cv2.threshold(grey, 0, 255, kind | cv2.THRESH_OTSU)
        contrast = _compute_contrast(grey, mask, settings.dark_target)
        if contrast >= settings.min_contrast:
            return mask, level, ""
        reason = (
            f"no target: dark and bright pixels are {contrast:.0f} grey levels apart, must be at "
            f"least {settings.min_contrast:.0f} apart (setting min_contrast)"
        )
        return np.zeros_like(mask), level, reason
    if settings.method == "adaptive":
        offset = settings.adaptive_offset if settings.dark_target else -settings.adaptive_offset
        mask = cv2.adaptiveThreshold(
            grey, 255, cv2.ADAPTIVE_THRESH_MEAN_C, kind, settings.adaptive_block, offset
        )
        return mask, -1.0, ""
    if colour is None:
        raise SegmentationError(
            f"segmentation '{settings.method}' needs a colour image, but the image is grey; use a "
            "colour camera or method 'otsu'"
        )
    if settings.method == "nearest_colour":
        return _threshold_colour_distance(colour, settings), -1.0, ""
    hsv = cv2.cvtColor(colour, cv2.COLOR_RGB2HSV)
    low, high = settings.colour_low, settings.colour_high
    if low[0] <= high[0]:
        return cv2.inRange(hsv, low, high), -1.0, ""
    upper = cv2.inRange(hsv, low, (179, *high[1:]))
    return upper | cv2.inRange(hsv, (0, *low[1:]), high), -1.0, ""


def _threshold_colour_distance(colour: NDArray[np.uint8], settings: SegmentationSettings) -> Mask:
    """Return the mask (rows, columns) of the pixels close to one colour.

    A pixel is 255 if its distance from `settings.near_colour` is at most
    `settings.colour_distance`, otherwise 0.

    colour: (rows, columns, 3) RGB image.
    """
    near_colour = np.array(settings.near_colour, np.uint8).reshape(1, 1, 3)
    difference = cv2.cvtColor(colour, cv2.COLOR_RGB2LAB).astype(np.float32)
    difference -= cv2.cvtColor(near_colour, cv2.COLOR_RGB2LAB).astype(np.float32)
    # The lightness is 0 to 255 in OpenCV, 0 to 100 in CIELAB.
    difference[..., 0] *= LIGHTNESS * 100.0 / 255.0
    return ((difference**2).sum(axis=2) <= settings.colour_distance**2).view(np.uint8) * 255


def _compute_contrast(grey: Mask, mask: Mask, dark_target: bool) -> float:
    count = cv2.countNonZero(mask)
    if count in (0, mask.size):
        return 0.0
    target = cv2.mean(grey, mask)[0]
    rest = (float(cv2.sumElems(grey)[0]) - target * count) / (mask.size - count)
    return rest - target if dark_target else target - rest


def segment(
    grey: Mask, settings: SegmentationSettings, colour: NDArray[np.uint8] | None = None,
    previous_centre: tuple[float, float] | None = None, component_mask: Mask | None = None,
    target_mask: Mask | None = None,
) -> SegmentedTarget:  # fmt: skip
    """Segment an image and choose the connected component that is the target.

    With the method 'label', the target is all components together.

    Args:
        grey: (rows, columns) uint8 image.
        settings: method, rule for the component, and their parameters.
        colour: (rows, columns, 3) RGB image, for the methods 'colour' and 'nearest_colour'.
        previous_centre: (column, row) of the target in the last image, for the rule 'nearest'.
        component_mask: (rows, columns) image whose nonzero pixels mark the target, for the rule
            'mask'.
        target_mask: (rows, columns) 255 on the target, 0 elsewhere, for the method 'label'.

    Raises:
        SegmentationError: the image that the method needs is missing, or the mask image has another
            size.
    """
    mask, level, reason = threshold_image(grey, settings, colour, target_mask)
    box = cv2.boundingRect(mask)
    component_count, component = 1, settings.component
    if box[2] == 0:
        reason = reason or "no target in view"
    elif settings.method == "label":
        component = "all"
    elif settings.marker:
        component = "marker"
        reason = "no pixel of the marker has the target colour; check the threshold or the colours"
        try:
            component_mask = MarkerChoice.read(settings.marker).make_mask(grey)
            mask, box, component_count = _find_components_in(mask, component_mask)
        except VisionError as error:
            mask, box, reason = np.zeros_like(mask), NO_BOX, str(error)
    elif component != "all":
        reason = "no pixel of target colour is inside the mask image"
        mask, box, component_count = _choose_component(
            mask, box, settings, previous_centre, component_mask
        )
    if box[2] == 0:
        return SegmentedTarget(mask, NO_BOX, 0, level, (), reason)
    column, row, width, height = box
    count = cv2.countNonZero(mask[row : row + height, column : column + width])
    unusable = _explain_unusable(count, box, mask, settings)
    return SegmentedTarget(
        mask, box, count, level, find_touched_borders(box, mask.shape), unusable, component_count,
        component, settings.method in UNEVEN_METHODS,
    )  # fmt: skip


def _find_components_in(mask: Mask, component_mask: Mask) -> tuple[Mask, Box, int]:
    """Find the connected components of `mask` of which more than half is in `component_mask`.

    Returns:
        The mask of these components, their bounding box, and the number of all components.
    """
    count, labels = cv2.connectedComponents(mask, connectivity=8)
    inside = np.bincount(labels[component_mask > 0], minlength=count)
    is_inside = 2 * inside > np.bincount(labels.ravel(), minlength=count)
    is_inside[0] = False
    selected = is_inside[labels].view(np.uint8) * 255
    return selected, cv2.boundingRect(selected), count - 1


def _explain_unusable(count: int, box: Box, mask: Mask, settings: SegmentationSettings) -> str:
    if count == mask.size:
        return "the target fills the whole image; check the threshold, or move the camera away"
    if count < settings.min_pixels:
        return (
            f"the target has {count} pixel(s), fewer than {settings.min_pixels} (setting "
            "min_pixels); move the camera closer"
        )
    if min(box[2], box[3]) == 1:
        return "the target is a line one pixel wide; move the camera closer"
    return ""


def _make_slices(box: Box) -> tuple[slice, slice]:
    column, row, width, height = box
    return slice(row, row + height), slice(column, column + width)


def find_touched_borders(box: Box, shape: tuple[int, ...]) -> tuple[str, ...]:
    """Return the borders that a box touches in an image with the shape (rows, columns)."""
    column, row, width, height = box
    touching = column == 0, column + width == shape[1], row == 0, row + height == shape[0]
    return tuple(compress(("left", "right", "top", "bottom"), touching))


def _count_components(mask: Mask) -> int:
    """Return the number of connected components of a mask.

    Counting the outer contours takes a tenth of the time that labelling of the pixels would take.
    """
    _, hierarchy = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    # count the outer contours, which have no parent (-1), unlike the contours of holes
    return hierarchy[0, :, 3].tolist().count(-1)


def _choose_component(
    mask: Mask, box: Box, settings: SegmentationSettings,
    previous_centre: tuple[float, float] | None, component_mask: Mask | None,
) -> tuple[Mask, Box, int]:  # fmt: skip
    """Choose one connected component of a mask by the rule of the settings.

    Pixels are connected to their 8 neighbours.

    Args:
        mask: (rows, columns) 255 for the pixels of target colour.
        box: bounding box of these pixels.
        settings: rule for the component and its parameters.
        previous_centre: (column, row) of the target in the last image, for the rule 'nearest'.
        component_mask: (rows, columns) image whose nonzero pixels mark the target, for the rule
            'mask'.

    Returns:
        The mask of the component, its bounding box, and the number of all components.
    """
    column, row, width, height = box
    crop = mask[row : row + height, column : column + width]
    if settings.component != "mask" and _count_components(crop) == 1:
        return mask, box, 1
    count, labels, stats, centres = cv2.connectedComponentsWithStats(crop, connectivity=8)
    if settings.component == "mask":
        if component_mask is None or component_mask.shape != mask.shape:
            raise SegmentationError(
                "component 'mask' needs a mask image with the size of the camera image, "
                f"{mask.shape[1]} x {mask.shape[0]} pixels"
            )
        inside = np.bincount(labels[component_mask[_make_slices(box)] > 0], minlength=count)
        inside[0] = 0
        chosen = int(inside.argmax())
        if inside[chosen] == 0:
            return np.zeros_like(mask), NO_BOX, count - 1
    elif settings.component == "nearest" and previous_centre is not None:
        offset = centres - (previous_centre[0] - box[0], previous_centre[1] - box[1])
        distance = np.hypot(offset[:, 0], offset[:, 1])
        distance[0] = np.inf
        is_large = stats[:, cv2.CC_STAT_AREA] >= settings.min_pixels
        is_large[0] = False
        if is_large.any():  # ignore components with fewer than min_pixels
            distance[~is_large] = np.inf
        chosen = int(distance.argmin())
    else:
        chosen = 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax())
    # Besides the background, `mask` has only one component, so no pixels are removed.
    if count == 2:
        return mask, box, 1
    left, top, width, height = (int(k) for k in stats[chosen, :4])
    new_box = (box[0] + left, box[1] + top, width, height)
    selected = np.zeros_like(mask)
    component = labels[top : top + height, left : left + width] == chosen
    selected[_make_slices(new_box)] = component.view(np.uint8) * 255
    return selected, new_box, count - 1
