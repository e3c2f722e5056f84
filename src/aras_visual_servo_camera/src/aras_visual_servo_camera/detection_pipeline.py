"""Measurement of the target in each image of a camera, without ROS."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from aras_visual_servo_base.settings import parameter

from .camera_model import CameraModel
from .degeneracy import gyration_radius
from .edge_pixels import locate_covered_parts
from .errors import InvalidIntrinsicsError, SegmentationError, VisionError
from .images import Image
from .kernel import compute_kernel_features, compute_original_moments
from .moments import MAX_ORDER, Moments
from .pixel_coverage import compute_coverage
from .segmentation_settings import BY_COLOUR, SegmentationSettings
from .segmented_target import SegmentedTarget, segment

LAYOUTS = ("moments", "kernel")
WEIGHTINGS = ("coverage", "binary")


@dataclass(frozen=True)
class DetectionSettings:
    """Settings of the pipeline; the package's README describes them as parameters of the node."""

    segmentation: SegmentationSettings = field(default_factory=SegmentationSettings)
    weighting: str = parameter("coverage", choices=WEIGHTINGS)
    edge_band: int = parameter(2, least=1, most=20)
    order: int = parameter(MAX_ORDER, least=3, most=MAX_ORDER)
    layout: str = parameter("moments", choices=LAYOUTS)
    original_threshold: float = parameter(250.0, least=0.0, most=255.0)


@dataclass(eq=False)
class TargetDetection:
    """Result of the measurement of one image.

    Attributes:
        valid: True if the moments can be used for servoing.
        reason: explanation why they cannot be used, otherwise empty.
        target: pixels, bounding box, touched borders and threshold of the target.
        moments: moments of the target; None if they cannot be computed. If the border of the image
            cuts off a part of the target, they are the moments of the visible part, and the
            detection is not valid.
        camera: intrinsics with which the moments were computed; None if they are unknown.
    """

    valid: bool
    reason: str
    target: SegmentedTarget
    moments: Moments | None
    camera: CameraModel | None


class DetectionPipeline:
    """Measures the target in one image after another.

    It stores the intrinsics of the camera and the last position of the target.
    """

    def __init__(
        self, settings: DetectionSettings, component_mask: NDArray[np.uint8] | None = None
    ) -> None:
        """Create a pipeline without a camera.

        Args:
            settings: settings of segmentation and moments.
            component_mask: (rows, columns) image whose nonzero pixels mark the target. It is needed
                if the setting `component` is 'mask'.
        """
        self.settings = settings
        self.component_mask = component_mask
        self.camera: CameraModel | None = None
        self.camera_fault = "no camera_info has arrived yet"
        self.reset()

    def reset(self) -> None:
        """Forget the last position of the target, for example after time has jumped back."""
        self._previous_centre: tuple[float, float] | None = None

    def set_camera(self, camera: CameraModel) -> None:
        """Use the given intrinsics from the next image on."""
        if camera is not self.camera and camera != self.camera:
            if camera.is_distorted:
                # compute the lens tables now, so that the next image is not delayed
                _ = camera.tables
            self.camera, self.camera_fault = camera, ""

    def drop_camera(self, fault: str) -> None:
        """Remove the intrinsics; later detections are invalid with `fault` as the reason."""
        self.camera, self.camera_fault = None, fault

    def measure(self, image: Image) -> TargetDetection:
        """Segment the image and compute the moments of the target.

        Raises:
            SegmentationError: the settings need colours or labels that the image does not have, or
                the image and the mask image differ in size.
        """
        camera = self.camera
        colour = None
        if self.settings.segmentation.method in BY_COLOUR:
            colour = image.rgb if image.has_colour else None
        grey = self._mask_blind_pixels(image.grey)
        options = (self.settings.segmentation, colour, self._previous_centre, self.component_mask,
                   image.target_mask)  # fmt: skip
        target = segment(grey, *options)
        if target.reason and grey is not image.grey:
            # No target was found in the image without the pixels that the lens model excludes.
            # Segment the original image, so that the reported reason applies to it.
            target = segment(image.grey, *options)
        reason = target.reason
        if not reason and camera is None:
            reason = self.camera_fault
        if not reason and (camera.height, camera.width) != image.pixels.shape[:2]:
            reason = (
                f"the image is {image.shape[1]} x {image.shape[0]} but camera_info says "
                f"{camera.width} x {camera.height}; publish a camera_info of the image's size"
            )
        if reason:
            self._previous_centre = None if target.pixel_count == 0 else self._previous_centre
            return TargetDetection(False, reason, target, None, camera)
        column, row, width, height = target.box
        self._previous_centre = column + 0.5 * (width - 1), row + 0.5 * (height - 1)
        try:
            moments = self._compute_moments(image.grey, target, camera)
        except VisionError as error:
            return TargetDetection(False, str(error), target, None, camera)
        reason = _explain_invalid(target, moments)
        return TargetDetection(not reason, reason, target, moments, camera)

    def _mask_blind_pixels(self, grey: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return the image with the background's grey level in pixels that the lens model excludes.

        Otherwise, a dark object at the rim of a fisheye image could be taken for the target. A
        target that extends into these pixels is still rejected, because its moments are computed
        from the original image.
        """
        camera = self.camera
        if camera is None or camera.blind_mask is None or camera.blind_mask.shape != grey.shape:
            return grey
        ground = 255 if self.settings.segmentation.dark_target else 0
        return np.where(camera.blind_mask, np.uint8(ground), grey)

    def compute_original_data(self, image: Image) -> list[float]:
        """Compute the numbers that the original ARAS simulator published on camera/data.

        The setting `layout` chooses between image moments (4 numbers) and kernel features (20).
        The target is found with a fixed threshold, as in the original simulator.

        Raises:
            DegenerateFeatureError: there is no target.
            InvalidIntrinsicsError: the layout is 'moments', and the intrinsics are unknown.
        """
        if self.settings.layout == "kernel":
            return self.compute_kernel_data(image)
        if self.camera is None:
            raise InvalidIntrinsicsError(self.camera_fault)
        return compute_original_moments(self.make_original_mask(image), self.camera.pinhole)

    def compute_kernel_data(self, image: Image) -> list[float]:
        """Compute the inverse Jacobian (16 numbers) and the kernel features (4) of the target.

        Raises:
            DegenerateFeatureError: there is no target.
        """
        return compute_kernel_features(self.make_original_mask(image)).to_message_data()

    def make_original_mask(self, image: Image) -> NDArray[np.uint8]:
        """Return the mask of the target as the original simulator computed it.

        A pixel is 255 if its grey level is at most the threshold, otherwise 0. The setting
        `original_threshold` is the threshold of an image whose white background has the level 255.
        In other images, it is multiplied by W / 255, where W is the level of the background, i.e.
        the most frequent level above 127.
        """
        bright = np.bincount(image.grey.ravel(), minlength=256)[128:]
        white = 128 + int(bright.argmax()) if bright.any() else 255
        level = self.settings.original_threshold * white / 255.0
        return cv2.threshold(image.grey, level, 255, cv2.THRESH_BINARY_INV)[1]

    def _compute_moments(
        self, grey: NDArray[np.uint8], target: SegmentedTarget, camera: CameraModel
    ) -> Moments:
        settings = self.settings
        column, row, width, height = target.box
        is_coverage = settings.weighting == "coverage"
        if is_coverage:
            weights, offset = compute_coverage(grey, target, settings.edge_band)
            full_scale = 1.0
        else:
            weights = target.mask[row : row + height, column : column + width]
            offset, full_scale = (column, row), 255.0
        if not camera.is_distorted:
            return Moments.from_image(
                weights, camera.pinhole, settings.order, full_scale, offset, is_coverage
            )
        tables = camera.tables
        beyond = (
            "the target extends beyond the range of the lens model; move it towards the middle of "
            "the image"
        )
        if is_coverage:
            parts = np.empty((3, weights.size))
            count = locate_covered_parts(*tables, weights, *offset, parts)
            if count < 0:
                raise SegmentationError(beyond)
            x, y, weight = parts[:, :count]
            extent = tables.compute_pixel_variance(column + width // 2, row + height // 2)
            return Moments.from_samples(x, y, weight, settings.order, extent=extent)
        rows, columns = weights.shape
        crop = slice(offset[1], offset[1] + rows), slice(offset[0], offset[0] + columns)
        if weights[tables.area[crop] == 0.0].any():
            raise SegmentationError(beyond)
        x, y, area = (table[crop].ravel() for table in tables)
        return Moments.from_samples(x, y, weights.ravel() * area / full_scale, settings.order)


def _explain_invalid(target: SegmentedTarget, moments: Moments) -> str:
    if target.touched_borders:
        return (
            f"the target touches the {' and '.join(target.touched_borders)} border of the image "
            f"({target.describe()}); move it completely into view"
        )
    mu20, mu11, mu02 = moments.second
    if mu20 * mu02 - mu11**2 <= 1e-9 * moments.m00**2 * gyration_radius(moments) ** 4:
        return "the target is a line without width; move the camera closer or out of its plane"
    return ""
