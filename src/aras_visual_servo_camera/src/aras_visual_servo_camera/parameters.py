"""Parameters of the camera node and their defaults; they are checked once, at start."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from aras_visual_servo_base.settings import build, parameter

from .detection_pipeline import DetectionSettings
from .errors import SegmentationError, VisionParameterError
from .segmentation_settings import SegmentationSettings


def copy_parameter(settings: type, name: str) -> Any:
    """Copy the declaration of a setting to a parameter of the node with the same name.

    Args:
        settings: dataclass that contains the setting.
        name: name of the setting.

    Returns:
        Dataclass field with the default, unit and bounds of the setting.
    """
    field = settings.__dataclass_fields__[name]
    return parameter(field.default, **field.metadata)


@dataclass(frozen=True)
class VisionParameters:
    """Private parameters of the node; the package's README explains each of them.

    Attributes:
        mask_image: image file whose nonzero pixels mark the target, for the setting `component:
            mask`; '' for none.
        desired_outline: x, y of the corners of the desired outline, normalised, for the overlay.
        log_period: minimum wall time between two log lines of the same kind, s.
    """

    layout: str = copy_parameter(DetectionSettings, "layout")
    segmentation: str = copy_parameter(SegmentationSettings, "method")
    threshold: float = copy_parameter(SegmentationSettings, "threshold")
    original_threshold: float = copy_parameter(DetectionSettings, "original_threshold")
    dark_target: bool = copy_parameter(SegmentationSettings, "dark_target")
    component: str = copy_parameter(SegmentationSettings, "component")
    marker: str | Mapping[str, Any] = copy_parameter(SegmentationSettings, "marker")
    mask_image: str = ""
    min_pixels: int = copy_parameter(SegmentationSettings, "min_pixels")
    min_contrast: float = copy_parameter(SegmentationSettings, "min_contrast")
    adaptive_block: int = copy_parameter(SegmentationSettings, "adaptive_block")
    adaptive_offset: float = copy_parameter(SegmentationSettings, "adaptive_offset")
    colour_low: tuple[float, ...] = copy_parameter(SegmentationSettings, "colour_low")
    colour_high: tuple[float, ...] = copy_parameter(SegmentationSettings, "colour_high")
    near_colour: tuple[float, ...] = copy_parameter(SegmentationSettings, "near_colour")
    colour_distance: float = copy_parameter(SegmentationSettings, "colour_distance")
    label: str = copy_parameter(SegmentationSettings, "label")
    weighting: str = copy_parameter(DetectionSettings, "weighting")
    edge_band: int = copy_parameter(DetectionSettings, "edge_band")
    order: int = copy_parameter(DetectionSettings, "order")
    desired_outline: tuple[float, ...] = ()
    log_period: float = parameter(5.0, "s", least=0.1, most=3600.0)

    def __post_init__(self) -> None:
        if self.component == "mask" and not self.mask_image:
            raise VisionParameterError(
                "parameter ~component is 'mask', so ~mask_image must be the path of an image file"
            )
        if len(self.desired_outline) % 2 or 0 < len(self.desired_outline) < 6:
            raise VisionParameterError(
                "parameter ~desired_outline must be empty, or a list of x and y of at least three "
                "corners"
            )
        # Raises a VisionParameterError if the segmentation settings are invalid.
        _ = self.pipeline_settings

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, Any]) -> VisionParameters:
        """Return the parameters from a mapping.

        The value of `segmentation` is the name of a method, or a mapping of settings. The
        controller node accepts the same mapping.

        Raises:
            VisionParameterError: a parameter is unknown or invalid; the message names it.
        """
        entry = mapping.get("segmentation")
        if isinstance(entry, Mapping):
            segmentation = build(
                SegmentationSettings, entry, "parameter ~segmentation", VisionParameterError
            )
            settings = {name: getattr(segmentation, name) for name in entry}
            mapping = {**mapping, **settings, "segmentation": segmentation.method}
            mapping.pop("method", None)
        return build(cls, mapping, "parameter ~", VisionParameterError)

    @cached_property
    def pipeline_settings(self) -> DetectionSettings:
        """Settings of the pipeline; raises VisionParameterError if the segmentation is invalid."""
        try:
            segmentation = SegmentationSettings(
                method=self.segmentation, **self._select_settings(SegmentationSettings)
            )
        except SegmentationError as error:
            raise VisionParameterError(f"parameter ~{error}") from None
        return DetectionSettings(
            **{**self._select_settings(DetectionSettings), "segmentation": segmentation}
        )

    def _select_settings(self, settings: type) -> dict[str, Any]:
        """Return those parameters, by name, that are also fields of the dataclass `settings`."""
        shared = (field.name for field in fields(settings) if hasattr(self, field.name))
        return {name: getattr(self, name) for name in shared}

    @property
    def desired_corners(self) -> tuple[tuple[float, float], ...]:
        """Corners (x, y) of the desired outline, normalised; empty if there is none."""
        return tuple(zip(self.desired_outline[::2], self.desired_outline[1::2], strict=True))

    def read_mask_image(self) -> NDArray[np.uint8] | None:
        """Return the grey levels (rows, columns) of the mask image; return None if no file is set.

        Raises:
            VisionParameterError: the file cannot be read.
        """
        if not self.mask_image:
            return None
        mask = cv2.imread(self.mask_image, cv2.IMREAD_GRAYSCALE)
        if mask is None:
            raise VisionParameterError(
                f"parameter ~mask_image: cannot read an image from '{self.mask_image}'; set it to "
                "the path of an image file"
            )
        return mask
