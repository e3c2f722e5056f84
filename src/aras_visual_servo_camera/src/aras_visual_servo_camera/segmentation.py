"""Settings of the segmentation: which pixels are the target, by grey, by colour, or by a label."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from aras_visual_servo_base.settings import check, parameter

from .errors import SegmentationError, VisionError

METHODS = ("fixed", "otsu", "adaptive", "colour", "nearest_colour", "label")
BY_COLOUR = ("colour", "nearest_colour")
COMPONENTS = ("all", "largest", "nearest", "mask")
MAX_HSV = (179, 255, 255)  # hue, saturation and value, as OpenCV has them


@dataclass(frozen=True)
class Segmentation:
    """Settings: what is target and which connected piece of it.

    Attributes:
        method: 'fixed' threshold, 'otsu', 'adaptive' (local mean), 'colour' (range in HSV),
            'nearest_colour' (all that is near one colour), or 'label' (a label image's).
        threshold: grey level of 'fixed', 0 to 255: darker or equal is target (inverse binary).
        dark_target: False turns the comparison round, for a bright target on a dark ground.
        adaptive_block: side of the neighbourhood of 'adaptive', odd, pixels.
        adaptive_offset: how much darker than its neighbourhood the target is, grey levels.
        colour_low, colour_high: range of hue (0-179), saturation, value (0-255). A hue whose
            low is above its high runs through red.
        near_colour: red, green, blue (0-255) of 'nearest_colour'.
        colour_distance: from it, in CIELAB with lightness weighted by a quarter, up to which a
            pixel is target.
        label: of 'label', the model, or 'model::link', that is the target.
        component: 'all' pixels as one target, the 'largest' connected piece, the one 'nearest'
            to where the target was last, or the one with most pixels inside a 'mask' image.
        marker: ArUco or AprilTag marker, or board of them, whose pixels are the target, whatever
            `component` says; see markers. '' for none.
        min_pixels: fewer pixels than this are no target.
        min_contrast: 'otsu' needs this many grey levels between target and background.
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
            raise SegmentationError("marker and method 'label' both say which pixels are the "
                                    "target: leave one out")  # fmt: skip
        if self.marker != "":  # {} is a board without its keys
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
        """Of the images of one exposure that it takes."""
        return ("image", "labels") if self.method == "label" else ("image",)


def _is_within(level: float, largest: float) -> bool:
    return 0 <= level <= largest
