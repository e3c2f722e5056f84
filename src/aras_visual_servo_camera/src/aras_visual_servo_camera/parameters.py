"""Parameters of the camera node: checked once at start, each with a default."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from .errors import ParameterError, SegmentationError
from .moments import MAX_ORDER
from .pipeline import LAYOUTS, WEIGHTINGS, Settings
from .segmentation import COMPONENTS, METHODS, Segmentation

# name -> (default, choices or (lowest, highest) or None)
_TABLE: dict[str, tuple[Any, tuple | None]] = {
    "layout": ("moments", LAYOUTS),
    "segmentation": ("fixed", METHODS),
    "threshold": (128.0, (0.0, 255.0)),
    "original_threshold": (250.0, (0.0, 255.0)),
    "dark_target": (True, None),
    "component": ("largest", COMPONENTS),
    "mask_image": ("", None),
    "min_pixels": (16, (1, 10**9)),
    "min_contrast": (40.0, (0.0, 255.0)),
    "adaptive_block": (51, (3, 9999)),
    "adaptive_offset": (20.0, (0.0, 255.0)),
    "colour_low": ([0, 0, 0], None),
    "colour_high": ([179, 255, 60], None),
    "weighting": ("coverage", WEIGHTINGS),
    "edge_band": (2, (1, 20)),
    "order": (MAX_ORDER, (3, MAX_ORDER)),
    "desired_outline": ([], None),
    "log_period": (5.0, (0.1, 3600.0)),
}
_OF_SEGMENTATION = (
    "threshold", "dark_target", "adaptive_block", "adaptive_offset", "component", "min_pixels",
    "min_contrast",
)  # fmt: skip
DEFAULTS: dict[str, Any] = {name: default for name, (default, _) in _TABLE.items()}


@dataclass(frozen=True)
class NodeParameters:
    """Checked parameters.

    Attributes:
        settings: of the pipeline.
        mask_image: file of the mask for the component 'mask', or ''.
        desired_outline: x, y of the desired target's corners, normalised, for the overlay.
        log_period: least seconds of wall time between two equal log lines.
    """

    settings: Settings
    mask_image: str
    desired_outline: tuple[tuple[float, float], ...]
    log_period: float

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

    @classmethod
    def from_mapping(cls, given: Mapping[str, Any]) -> NodeParameters:
        """Check a mapping of parameters. Raises ParameterError naming the one at fault."""
        for name in given:
            if name not in _TABLE:
                near = get_close_matches(name, _TABLE, 1)
                hint = f"; did you mean '{near[0]}'?" if near else ""
                raise ParameterError(f"unknown parameter ~{name}{hint} (README lists them)")
        value = {name: _checked(name, given.get(name, d)) for name, d in DEFAULTS.items()}
        if value["component"] == "mask" and not value["mask_image"]:
            raise ParameterError("~component is 'mask', so ~mask_image must name an image file")
        outline = value["desired_outline"]
        if len(outline) % 2 or 0 < len(outline) < 6:
            raise ParameterError("~desired_outline needs x, y of at least three corners")
        try:
            segmentation = Segmentation(
                method=value["segmentation"],
                **{name: value[name] for name in _OF_SEGMENTATION},
                colour_low=tuple(value["colour_low"]),
                colour_high=tuple(value["colour_high"]),
            )
        except SegmentationError as error:
            raise ParameterError(str(error)) from None
        settings = Settings(
            segmentation,
            value["weighting"],
            value["edge_band"],
            value["order"],
            value["layout"],
            value["original_threshold"],
        )
        corners = tuple(zip(outline[::2], outline[1::2], strict=True))
        return cls(settings, value["mask_image"], corners, value["log_period"])


def _checked(name: str, value: Any) -> Any:
    default, allowed = _TABLE[name]
    if isinstance(default, bool):
        good = isinstance(value, bool)
    elif isinstance(default, float):
        good = isinstance(value, (int, float)) and not isinstance(value, bool)
        value = float(value) if good else value
    elif isinstance(default, int):
        good = isinstance(value, int) and not isinstance(value, bool)
    elif isinstance(default, list):
        good = isinstance(value, (list, tuple)) and all(
            isinstance(v, (int, float)) and not isinstance(v, bool) for v in value
        )
    else:
        good = isinstance(value, str)
    if not good:
        kind = {list: "a list of numbers", float: "a number", int: "a whole number"}.get(
            type(default), "true or false" if isinstance(default, bool) else "a text"
        )
        raise ParameterError(f"parameter ~{name} must be {kind}, got {value!r}")
    if allowed is None:
        return value
    if isinstance(default, str):
        if value not in allowed:
            raise ParameterError(f"parameter ~{name} is '{value}', must be one of {allowed}")
    elif not allowed[0] <= value <= allowed[1]:
        raise ParameterError(
            f"parameter ~{name} = {value} is outside {allowed[0]} ... {allowed[1]}"
        )
    return value
