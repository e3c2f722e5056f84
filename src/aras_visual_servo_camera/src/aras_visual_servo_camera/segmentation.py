"""Settings of the segmentation of the target by grey level, colour or label."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from aras_visual_servo_base.settings import check, parameter

from .errors import SegmentationError, VisionError

METHODS = ("fixed", "otsu", "adaptive", "colour", "nearest_colour", "label")
BY_COLOUR = ("colour", "nearest_colour")
COMPONENTS = ("all", "largest", "nearest", "mask")
MAX_HSV = (179, 255, 255)  # ranges of hue, saturation and value in OpenCV


@dataclass(frozen=True)
class Segmentation:
    """Settings that define the pixels of the target and its connected component.

    Attributes:
        method: 'fixed' threshold, 'otsu', 'adaptive' (local mean), 'colour' (range in HSV),
            'nearest_colour' (all pixels close to one colour), or 'label' (pixels of a label image).
        threshold: grey level of 'fixed', 0 to 255; pixels of this level or darker are target.
        dark_target: False reverses the comparison, for a bright target on a dark background.
        adaptive_block: side of the neighbourhood of 'adaptive', odd, px.
        adaptive_offset: grey levels by which the target is darker than its neighbourhood.
        colour_low, colour_high: range of hue (0-179), saturation, value (0-255). If the low hue is
            above the high hue, the range includes red (179 to 0).
        near_colour: red, green, blue (0-255) of 'nearest_colour'.
        colour_distance: largest distance of a target pixel from `near_colour`, in CIELAB with a
            weight of a quarter for lightness.
        label: model, or 'model::link', that is the target of 'label'.
        component: 'all' pixels as one target, the 'largest' connected component, the one 'nearest'
            to the last position of the target, or the one with most pixels inside a 'mask' image.
        marker: ArUco or AprilTag marker, or board of markers, whose pixels are the target. It
            overrides `component`. '' for no marker; the module `markers` explains the forms.
        min_pixels: smallest number of pixels of a target.
        min_contrast: smallest difference of target and background for 'otsu', grey levels.
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
            raise SegmentationError("marker and method 'label' both define the pixels of the "
                                    "target: remove one of them")  # fmt: skip
        if self.marker != "":  # also check {}, a board without keys
            from .markers import MarkerChoice

            try:
                MarkerChoice.read(self.marker)
            except VisionError as error:
                raise SegmentationError(str(error)) from None
        if self.adaptive_block % 2 == 0:
            raise SegmentationError(f"adaptive_block is {self.adaptive_block}, must be odd")
        for name in ("colour_low", "colour_high"):
            colour = getattr(self, name)
            if len(colour) != 3 or not all(map(_is_within, colour, MAX_HSV)):
                raise SegmentationError(
                    f"{name} {tuple(colour)} must be hue 0-179, saturation 0-255, value 0-255"
                )
        given = len(self.near_colour) == 3 and all(0 <= level <= 255 for level in self.near_colour)
        if not given and (self.near_colour or self.method == "nearest_colour"):
            raise SegmentationError(
                f"near_colour is {list(self.near_colour)}, must be red, green, blue, 0-255, for "
                "method 'nearest_colour'"
            )

    @property
    def image_kinds(self) -> tuple[str, ...]:
        """Kinds of images of one exposure that the segmentation needs."""
        return ("image", "labels") if self.method == "label" else ("image",)


def _is_within(level: float, largest: float) -> bool:
    return 0 <= level <= largest
