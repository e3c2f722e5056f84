"""Image in, measurement out: what the camera node does, without ROS."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from aras_visual_servo_base.settings import parameter

from .coverage import compute_coverage
from .degeneracy import gyration_radius
from .edge_pixels import locate_covered_parts
from .errors import CalibrationError, SegmentationError, VisionError
from .images import Image
from .kernel import compute_kernel_features, compute_original_moments
from .moments import MAX_ORDER, Moments
from .segmentation import BY_COLOUR, Segmentation
from .segmented_target import SegmentedTarget, segment
from .undistortion import CameraModel

LAYOUTS = ("moments", "kernel")
WEIGHTINGS = ("coverage", "binary")


@dataclass(frozen=True)
class PipelineSettings:
    """What the pipeline does; the node's README lists the same as parameters."""

    segmentation: Segmentation = field(default_factory=Segmentation)
    weighting: str = parameter("coverage", choices=WEIGHTINGS)
    edge_band: int = parameter(2, least=1, most=20)
    order: int = parameter(MAX_ORDER, least=3, most=MAX_ORDER)
    layout: str = parameter("moments", choices=LAYOUTS)
    original_threshold: float = parameter(250.0, least=0.0, most=255.0)


Settings = PipelineSettings  # its documented name


@dataclass(frozen=True, eq=False)
class TargetDetection:
    """The target in one image.

    Attributes:
        valid: True if the moments are fit to servo on.
        reason: why not, in words; empty when valid.
        target: its pixels, box, borders and threshold.
        moments: None where there is nothing to measure. A target that is cut by the border has
            moments, of the part in view, but is not valid.
        camera: the intrinsics that were used, or None.
    """

    valid: bool
    reason: str
    target: SegmentedTarget
    moments: Moments | None
    camera: CameraModel | None


class Pipeline:
    """Measures image after image; remembers the camera and where the target was last."""

    def __init__(
        self, settings: PipelineSettings, component_mask: NDArray[np.uint8] | None = None
    ) -> None:
        """`region`: mask image (rows, columns) for the component choice 'mask'."""
        self.settings = settings
        self.component_mask = component_mask
        self.camera: CameraModel | None = None
        self.camera_fault = "no camera_info has arrived yet"
        self.reset()

    def reset(self) -> None:
        """Forget where the target was, as after the clock went back."""
        self._previous_centre: tuple[float, float] | None = None

    def set_camera(self, camera: CameraModel) -> None:
        """Use these intrinsics from the next image on."""
        if camera != self.camera:
            if camera.is_distorted:
                _ = camera.tables  # worked out here, once, and not inside the next image's time
            self.camera, self.camera_fault = camera, ""

    def drop_camera(self, fault: str) -> None:
        """There are no usable intrinsics, and why."""
        self.camera, self.camera_fault = None, fault

    def measure(self, image: Image) -> TargetDetection:
        """Segment the image and take the target's moments. Raises SegmentationError."""
        camera = self.camera
        colour = None
        if self.settings.segmentation.method in BY_COLOUR:
            colour = image.rgb if image.has_colour else None
        seen = self._mask_blind_pixels(image.grey)
        options = (self.settings.segmentation, colour, self._previous_centre, self.component_mask,
                   image.target_mask)  # fmt: skip
        target = segment(seen, *options)
        if target.reason and seen is not image.grey:
            target = segment(image.grey, *options)  # to say what is wrong with what is there
        reason = target.reason
        if not reason and camera is None:
            reason = self.camera_fault
        if not reason and (camera.height, camera.width) != image.shape:
            reason = (
                f"the image is {image.shape[1]} x {image.shape[0]} but camera_info says "
                f"{camera.width} x {camera.height}"
            )
        if reason:
            self._previous_centre = None if target.pixel_count == 0 else self._previous_centre
            return TargetDetection(False, reason, target, None, camera)
        self._previous_centre = _compute_box_centre(target)
        try:
            moments = self._compute_moments(image.grey, target, camera)
        except VisionError as error:
            return TargetDetection(False, str(error), target, None, camera)
        reason = _explain_invalid(target, moments)
        return TargetDetection(not reason, reason, target, moments, camera)

    def _mask_blind_pixels(self, grey: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The image with ground where the lens gives no normalised coordinates.

        At the rim of a fisheye's picture stand things that no pinhole can see; the largest dark
        one of them must not pass for the target. A target that reaches there is still refused:
        its moments are taken from the image as it is.
        """
        camera = self.camera
        if camera is None or camera.blind_mask is None or camera.blind_mask.shape != grey.shape:
            return grey
        ground = 255 if self.settings.segmentation.dark_target else 0
        return np.where(camera.blind_mask, np.uint8(ground), grey)

    def compute_original_data(self, image: Image) -> list[float]:
        """The numbers of camera/data, from the fixed threshold of the original.

        Raises:
            DegenerateFeatureError: no target. CalibrationError: 'moments' without camera_info.
        """
        if self.settings.layout == "kernel":
            return self.compute_kernel_data(image)
        if self.camera is None:
            raise CalibrationError(self.camera_fault)
        return compute_original_moments(self.make_original_mask(image), self.camera.pinhole)

    def compute_kernel_data(self, image: Image) -> list[float]:
        """The 20 numbers of the kernel layout. Raises DegenerateFeatureError: no target."""
        return compute_kernel_features(self.make_original_mask(image)).to_message_data()

    def make_original_mask(self, image: Image) -> NDArray[np.uint8]:
        """Inverse binary image (0, 255) at the original's threshold.

        That is of pictures whose white is 255: it is lowered where the bright level that most
        pixels have is less, as in pictures that are not clipped.
        """
        bright = np.bincount(image.grey.ravel(), minlength=256)[128:]
        white = 128 + int(bright.argmax()) if bright.any() else 255
        level = self.settings.original_threshold * white / 255.0
        return cv2.threshold(image.grey, level, 255, cv2.THRESH_BINARY_INV)[1]

    def _compute_moments(
        self, grey: NDArray[np.uint8], target: SegmentedTarget, camera: CameraModel
    ) -> Moments:
        settings = self.settings
        weights, corner, full_scale = _crop_mask(target)
        smooth = settings.weighting == "coverage"
        if smooth:
            weights, corner, _, _ = compute_coverage(grey, target, settings.edge_band)
            full_scale = 1.0
        if not camera.is_distorted:
            return Moments.from_image(
                weights, camera.pinhole, settings.order, full_scale, corner, smooth
            )
        rows, columns = weights.shape
        crop = slice(corner[1], corner[1] + rows), slice(corner[0], corner[0] + columns)
        tables = camera.tables
        if weights[tables.area[crop] == 0.0].any():
            raise SegmentationError(
                "the target reaches beyond the part of the image that has normalised coordinates"
            )
        if smooth:
            x, y, weight = locate_covered_parts(*tables, weights, *corner)
            column, row, width, height = target.box
            extent = tables.compute_pixel_variance(column + width // 2, row + height // 2)
            return Moments.from_samples(x, y, weight, settings.order, extent=extent)
        x, y, area = (table[crop].ravel() for table in tables)
        return Moments.from_samples(x, y, weights.ravel() * area / full_scale, settings.order)


def _crop_mask(target: SegmentedTarget) -> tuple[NDArray[np.uint8], tuple[int, int], float]:
    column, row, width, height = target.box
    return target.mask[row : row + height, column : column + width], (column, row), 255.0


def _compute_box_centre(target: SegmentedTarget) -> tuple[float, float]:
    column, row, width, height = target.box
    return column + 0.5 * (width - 1), row + 0.5 * (height - 1)


def _explain_invalid(target: SegmentedTarget, moments: Moments) -> str:
    if target.touched_borders:
        return (
            f"the target touches the {' and '.join(target.touched_borders)} border of the image "
            f"({target.describe()})"
        )
    mu20, mu11, mu02 = moments.second
    if mu20 * mu02 - mu11**2 <= 1e-9 * moments.m00**2 * gyration_radius(moments) ** 4:
        return "the target is a line without width"
    return ""
