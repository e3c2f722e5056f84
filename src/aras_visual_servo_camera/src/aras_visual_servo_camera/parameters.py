"""Parameters of the camera node: checked once at start, each with a default."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from aras_visual_servo_base.settings import build, defaults, parameter

from .errors import ParameterError, SegmentationError
from .moments import MAX_ORDER
from .pipeline import LAYOUTS, WEIGHTINGS, PipelineSettings
from .segmentation import COMPONENTS, METHODS, Segmentation

_OF_SEGMENTATION = (
    "threshold", "dark_target", "adaptive_block", "adaptive_offset", "component", "min_pixels",
    "min_contrast", "colour_low", "colour_high",
)  # fmt: skip


@dataclass(frozen=True)
class VisionParameters:
    """Private parameters of the node; the README's table says what each one does.

    mask_image: file of the mask for the component 'mask', or ''.
    desired_outline: x, y of the desired target's corners, normalised, for the overlay.
    log_period: least seconds of wall time between two equal log lines.
    """

    layout: str = parameter("moments", choices=LAYOUTS)
    segmentation: str = parameter("fixed", choices=METHODS)
    threshold: float = parameter(128.0, least=0.0, most=255.0)
    original_threshold: float = parameter(250.0, least=0.0, most=255.0)
    dark_target: bool = True
    component: str = parameter("largest", choices=COMPONENTS)
    mask_image: str = ""
    min_pixels: int = parameter(16, least=1, most=10**9)
    min_contrast: float = parameter(40.0, least=0.0, most=255.0)
    adaptive_block: int = parameter(51, least=3, most=9999)
    adaptive_offset: float = parameter(20.0, least=0.0, most=255.0)
    colour_low: tuple[float, ...] = (0.0, 0.0, 0.0)
    colour_high: tuple[float, ...] = (179.0, 255.0, 60.0)
    weighting: str = parameter("coverage", choices=WEIGHTINGS)
    edge_band: int = parameter(2, least=1, most=20)
    order: int = parameter(MAX_ORDER, least=3, most=MAX_ORDER)
    desired_outline: tuple[float, ...] = ()
    log_period: float = parameter(5.0, "s", least=0.1, most=3600.0)

    def __post_init__(self) -> None:
        if self.component == "mask" and not self.mask_image:
            raise ParameterError("~component is 'mask', so ~mask_image must name an image file")
        if len(self.desired_outline) % 2 or 0 < len(self.desired_outline) < 6:
            raise ParameterError("~desired_outline needs x, y of at least three corners")
        _ = self.settings  # which refuses what does not go together

    @classmethod
    def from_mapping(cls, given: Mapping[str, Any]) -> VisionParameters:
        """Check a mapping of parameters. Raises ParameterError naming the one at fault."""
        return build(cls, given, "parameter ~", ParameterError)

    @cached_property
    def settings(self) -> PipelineSettings:
        """Of the pipeline; ParameterError where they do not go together."""
        try:
            segmentation = Segmentation(
                method=self.segmentation, **{name: getattr(self, name) for name in _OF_SEGMENTATION}
            )
        except SegmentationError as error:
            raise ParameterError(str(error)) from None
        return PipelineSettings(
            segmentation,
            self.weighting,
            self.edge_band,
            self.order,
            self.layout,
            self.original_threshold,
        )

    @property
    def desired_corners(self) -> tuple[tuple[float, float], ...]:
        """x, y of each corner of the desired outline."""
        return tuple(zip(self.desired_outline[::2], self.desired_outline[1::2], strict=True))

    def region(self) -> NDArray[np.uint8] | None:
        """The mask image, grey (rows, columns); None where there is none.

        Raises:
            ParameterError: it is named, and cannot be read.
        """
        if not self.mask_image:
            return None
        mask = cv2.imread(self.mask_image, cv2.IMREAD_GRAYSCALE)
        if mask is None:
            raise ParameterError(
                f"parameter ~mask_image: cannot read an image from '{self.mask_image}'"
            )
        return mask


DEFAULTS: dict[str, Any] = defaults(VisionParameters)
