"""Settings that define how the target is segmented: by grey level, colour or label."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from aras_visual_servo_base.settings import check, parameter

from .errors import SegmentationError, VisionError

METHODS = ("fixed", "otsu", "adaptive", "colour", "nearest_colour", "label")
BY_COLOUR = ("colour", "nearest_colour")
COMPONENTS = ("all", "largest", "nearest", "mask")
MAX_HSV = (179, 255, 255)  # largest hue, saturation and value in OpenCV's HSV images


@dataclass(frozen=True)
class SegmentationSettings:
    """Settings that define which pixels of an image can belong to the target, and which do.

    Attributes:
        method: 'fixed' (threshold), 'otsu' (Otsu's threshold), 'adaptive' (threshold relative to
            the local mean), 'colour' (range of colours in HSV), 'nearest_colour' (all pixels close
            to one colour), or 'label' (pixels of the target in a label image).
        threshold: threshold of 'fixed', 0 to 255; pixels at this grey level and below are target.
        dark_target: whether the target is darker than the background. False reverses the
            comparisons with the threshold and with the mean.
        adaptive_block: for 'adaptive', side of the square over which the mean is computed, odd, px.
        adaptive_offset: for 'adaptive', grey levels by which the target is darker than the mean.
        colour_low, colour_high: for 'colour', lowest and highest hue (0-179), saturation (0-255)
            and value (0-255). If the lowest hue is above the highest hue, the range contains the
            hues from the lowest to 179 and from 0 to the highest, so it includes red.
        near_colour: for 'nearest_colour', red, green and blue (0-255) of the target.
        colour_distance: for 'nearest_colour', largest distance of a target pixel from
            `near_colour`, in CIELAB, where lightness has a weight of a quarter.
        label: for 'label', name of the target: 'model' or 'model::link'.
        component: which of the connected components of these pixels is the target: 'all' together,
            the 'largest', the one 'nearest' to the last position of the target, or the one that
            shares most pixels with a mask image ('mask').
        marker: ArUco or AprilTag marker, or board of markers, whose pixels are the target; '' for
            none. It overrides `component`. The docstring of the module `markers` explains its
            forms.
        min_pixels: smallest number of pixels of a target.
        min_contrast: for 'otsu', smallest difference of target and background, grey levels.
    """

    method: str = parameter("fixed", choices=METHODS)
    threshold: float = parameter(128.0, least=0.0, most=255.0)
    dark_target: bool = True
    adaptive_block: int = parameter(51, least=3, most=9999)
    adaptive_offset: float = parameter(20.0, least=0.0, most=255.0)
    colour_low: tuple[float, ...] = (0.0, 0.0, 0.0)
    colour_high: tuple[float, ...] = (179.0, 255.0, 60.0)
    near_colour: tuple[float, ...] = ()
    colour_distance: float = parameter(25.0, above=0.0, most=255.0)
    label: str = "target"
    component: str = parameter("largest", choices=COMPONENTS)
    marker: str | Mapping[str, Any] = parameter("", name=True)
    min_pixels: int = parameter(16, least=1, most=10**9)
    min_contrast: float = parameter(40.0, least=0.0, most=255.0)

    def __post_init__(self) -> None:
        check(self, SegmentationError)
        if self.marker and self.method == "label":
            raise SegmentationError("both marker and method 'label' define the pixels of the "
                                    "target: remove one of them")  # fmt: skip
        # Not `if self.marker`, because the invalid setting {} must be rejected and not ignored.
        if self.marker != "":
            from .markers import MarkerChoice

            try:
                MarkerChoice.read(self.marker)
            except VisionError as error:
                raise SegmentationError(str(error)) from None
        if self.adaptive_block % 2 == 0:
            raise SegmentationError(f"adaptive_block is {self.adaptive_block} px, must be odd")
        for name in ("colour_low", "colour_high"):
            colour = getattr(self, name)
            within = [0 <= value <= most for value, most in zip(colour, MAX_HSV, strict=False)]
            if len(colour) != 3 or not all(within):
                raise SegmentationError(
                    f"{name} is {tuple(colour)}, must be hue 0-179, saturation 0-255, value 0-255"
                )
        given = len(self.near_colour) == 3 and all(0 <= level <= 255 for level in self.near_colour)
        if not given and (self.near_colour or self.method == "nearest_colour"):
            raise SegmentationError(
                f"near_colour is {list(self.near_colour)}, must be red, green and blue, each from "
                "0 to 255, for method 'nearest_colour'"
            )

    @property
    def image_kinds(self) -> tuple[str, ...]:
        """Kinds of images that the segmentation needs for each measurement: 'image', 'labels'."""
        return ("image", "labels") if self.method == "label" else ("image",)
