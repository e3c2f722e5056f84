"""Reader of images: measures moments, contour, corners, kernel features, pixels and plane."""

from __future__ import annotations

from math import hypot
from typing import TYPE_CHECKING

import numpy as np

from aras_visual_servo_camera.contour import CORNER_ACCURACY, extract_outline, fit_corners
from aras_visual_servo_camera.detection_pipeline import DetectionPipeline, DetectionSettings
from aras_visual_servo_camera.errors import VisionError
from aras_visual_servo_camera.images import Image
from aras_visual_servo_camera.intersection_accuracy import compute_rms_deviation

from ..kinematics.joint_sample import make_read_only_copy
from .observation import SEGMENTED, Need

if TYPE_CHECKING:
    from aras_visual_servo_camera.camera_model import CameraModel
    from aras_visual_servo_camera.interaction import Plane
    from aras_visual_servo_camera.segmentation_settings import SegmentationSettings
    from aras_visual_servo_camera.trackers import Tracker

    from .frame import Frame

# Measured values, by the name of the field of Observation that they fill.
MeasuredFields = dict[str, object]


class FeatureExtractor:
    """Measurement of the images of one camera, with the camera package's pipeline and a tracker."""

    def __init__(
        self, needs: frozenset[Need], segmentation: SegmentationSettings, tracker: Tracker | None
    ) -> None:
        """Create the reader.

        Args:
            needs: quantities to measure.
            segmentation: method that selects the target's pixels.
            tracker: tracker of the points that are used as corners; None to use the corners of the
                outline.
        """
        self.needs, self.tracker = needs, tracker
        self.pipeline = DetectionPipeline(DetectionSettings(segmentation))

    @staticmethod
    def decode_image(frame: Frame) -> Image:
        """Return the image of a frame with its encoding, in the camera package's format."""
        return Image(frame.image, frame.encoding, frame.target_mask)

    def read(
        self,
        image: Image | np.ndarray,
        camera: CameraModel,
        pose: np.ndarray | None,
        depth: np.ndarray | None,
        plane: Plane | None,
    ) -> tuple[bool, str, Plane | None, MeasuredFields]:
        """Measure the needed quantities in an image.

        Args:
            image: `Image`, or (rows, columns) grey or (rows, columns, 3) RGB, uint8.
            camera: intrinsics of the camera.
            pose: world_T_camera (4, 4); None if it is unknown.
            depth: (rows, columns) depth image, m.
            plane: plane of the target, if it is known more accurately than from the image.

        Returns:
            Whether the target was found; why it was not found; its plane, or None if it is unknown;
            the other fields of the observation.
        """
        if not isinstance(image, Image):
            image = Image(np.asarray(image), "mono8" if np.ndim(image) == 2 else "rgb8")
        fields: MeasuredFields = {}
        valid, reason = True, ""
        is_tracked = self.tracker is not None and Need.CORNERS in self.needs
        needs = self.needs - {Need.CORNERS} if is_tracked else self.needs
        if needs & SEGMENTED:
            valid, reason, fields = self._measure_target(image, camera, needs)
        if valid and is_tracked:
            try:
                pixels = image.rgb if self.tracker.has_colour else image.grey
                found = self.tracker.track(pixels, camera, pose, depth)
                fields["corners"] = make_read_only_copy(found.points)
                fields["corner_accuracy"] = found.accuracy
                fields["corner_repeatability"] = found.repeatability
                fields["corner_spread"] = (
                    None if found.spread is None else make_read_only_copy(found.spread)
                )
                fields["is_numbered"] = self.tracker.is_numbered
                fields["marker"] = found.marker
                plane = found.plane if plane is None else plane
            except VisionError as error:
                valid, reason = False, str(error)
        if Need.IMAGE in self.needs:
            pixels = image.rgb if image.has_colour else image.grey
            fields["image"] = _make_read_only(pixels)
        if Need.DEPTH in self.needs and depth is not None:
            fields["depth"] = _make_read_only(np.asarray(depth, np.float32))
            if plane is None and valid:
                from .plane_from_depth import fit_plane

                outline = fields.get("corners", fields.get("contour"))
                plane = fit_plane(fields["depth"], camera, outline)
        return valid, reason, plane, fields

    def _measure_target(
        self, image: Image, camera: CameraModel, needs: frozenset[Need]
    ) -> tuple[bool, str, MeasuredFields]:
        """Measure the target with the pipeline of the camera package."""
        self.pipeline.set_camera(camera)
        try:
            measured = self.pipeline.measure(image)
        except VisionError as error:
            return False, str(error), {}
        target = measured.target
        fields: MeasuredFields = {
            "pixel_count": target.pixel_count,
            "touched_borders": target.touched_borders,
        }
        if not measured.valid:
            return False, measured.reason, fields
        fields["moments"] = measured.moments
        try:
            if needs & {Need.CONTOUR, Need.CORNERS, Need.DEPTH}:
                contour = extract_outline(image.grey, target, camera)
                fields["contour"] = make_read_only_copy(contour)
                if Need.CORNERS in needs:
                    corners, spread = fit_corners(contour)
                    fields["corners"], fields["corner_spread"] = (
                        make_read_only_copy(corners),
                        make_read_only_copy(spread),
                    )
                    fields["corner_accuracy"] = hypot(
                        CORNER_ACCURACY / camera.K[0], compute_rms_deviation(spread)
                    )
                    fields["is_numbered"] = False
            if Need.KERNEL in needs:
                from aras_visual_servo_camera.kernel import compute_kernel_features

                mask = self.pipeline.make_original_mask(image)
                fields["kernel"] = make_read_only_copy(
                    compute_kernel_features(mask).to_message_data()
                )
        except VisionError as error:
            return False, str(error), fields
        return True, "", fields


def _make_read_only(array: np.ndarray) -> np.ndarray:
    """Return a read-only view of an image without copying it."""
    view = array.view()
    view.setflags(write=False)
    return view
