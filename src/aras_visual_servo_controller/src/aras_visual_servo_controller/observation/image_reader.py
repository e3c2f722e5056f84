"""From an image to what a scheme needs of it: moments, contour, corners, kernel, pixels, plane."""

from __future__ import annotations

from math import hypot
from typing import TYPE_CHECKING

import numpy as np

from aras_visual_servo_camera.contour import CORNER_ACCURACY, extract_outline, fit_corners
from aras_visual_servo_camera.errors import VisionError
from aras_visual_servo_camera.images import Image
from aras_visual_servo_camera.line_fits import compute_rms_deviation
from aras_visual_servo_camera.pipeline import Pipeline, PipelineSettings

from ..kinematics.joint_sample import make_read_only_copy
from .observation import SEGMENTED, Need

if TYPE_CHECKING:
    from aras_visual_servo_camera.interaction import Plane
    from aras_visual_servo_camera.segmentation import Segmentation
    from aras_visual_servo_camera.trackers import Tracker
    from aras_visual_servo_camera.undistortion import CameraModel

    from .frame import Frame

MeasuredFields = dict[str, object]  # by field of Observation


class ImageReader:
    """Reads the images of one camera with the camera package's own pipeline and a tracker."""

    def __init__(
        self, needs: frozenset[Need], segmentation: Segmentation, tracker: Tracker | None
    ) -> None:
        """`needs`: nothing else is measured. `tracker`: of the points that count as corners; None:
        those of the outline."""
        self.needs, self.tracker = needs, tracker
        self.pipeline = Pipeline(PipelineSettings(segmentation))

    @staticmethod
    def decode_image(frame: Frame) -> Image:
        """The image of a frame with its encoding, as the camera package reads it."""
        return Image(frame.image, frame.encoding, frame.target_mask)

    def read(
        self,
        image: Image | np.ndarray,
        camera: CameraModel,
        pose: np.ndarray | None,
        depth: np.ndarray | None,
        plane: Plane | None,
    ) -> tuple[bool, str, Plane | None, MeasuredFields]:
        """Measure what is needed.

        Args:
            image: `Image`, or (rows, columns) grey or (rows, columns, 3) RGB, uint8.
            camera: its intrinsics.
            pose: world_T_camera (4, 4), where it is known.
            depth: (rows, columns), m.
            plane: of the target, where it is known better than by the image.

        Returns:
            Whether the target was found, why not, its plane where that is known, and the rest.
        """
        if not isinstance(image, Image):
            image = Image(np.asarray(image), "mono8" if np.ndim(image) == 2 else "rgb8")
        seen: MeasuredFields = {}
        valid, reason = True, ""
        tracked = self.tracker is not None and Need.CORNERS in self.needs
        needs = self.needs - {Need.CORNERS} if tracked else self.needs
        if needs & SEGMENTED:
            valid, reason, seen = self._measure_target(image, camera, needs)
        if valid and tracked:
            try:
                found = self.tracker.track(image.grey, camera, pose, depth)
                seen["corners"] = make_read_only_copy(found.points)
                seen["corner_accuracy"] = found.accuracy
                seen["corner_repeatability"] = found.repeatability
                seen["corner_spread"] = (
                    None if found.spread is None else make_read_only_copy(found.spread)
                )
                seen["is_numbered"] = self.tracker.is_numbered
                seen["marker"] = found.marker
                plane = found.plane if plane is None else plane
            except VisionError as error:
                valid, reason = False, str(error)
        if Need.IMAGE in self.needs:
            pixels = image.rgb if image.has_colour else image.grey
            seen["image"] = _make_read_only(pixels)
        if Need.DEPTH in self.needs and depth is not None:
            seen["depth"] = _make_read_only(np.asarray(depth, np.float32))
            if plane is None and valid:
                from .depth_image import fit_plane

                plane = fit_plane(seen["depth"], camera, seen.get("corners", seen.get("contour")))
        return valid, reason, plane, seen

    def _measure_target(
        self, image: Image, camera: CameraModel, needs: frozenset[Need]
    ) -> tuple[bool, str, MeasuredFields]:
        """What the pipeline finds of the target."""
        self.pipeline.set_camera(camera)
        try:
            measured = self.pipeline.measure(image)
        except VisionError as error:
            return False, str(error), {}
        target = measured.target
        seen: MeasuredFields = {
            "pixel_count": target.pixel_count,
            "touched_borders": target.touched_borders,
        }
        if not measured.valid:
            return False, measured.reason, seen
        seen["moments"] = measured.moments
        try:
            if needs & {Need.CONTOUR, Need.CORNERS, Need.DEPTH}:
                contour = extract_outline(image.grey, target, camera)
                seen["contour"] = make_read_only_copy(contour)
                if Need.CORNERS in needs:
                    corners, spread = fit_corners(contour)
                    seen["corners"], seen["corner_spread"] = (
                        make_read_only_copy(corners),
                        make_read_only_copy(spread),
                    )
                    seen["corner_accuracy"] = hypot(
                        CORNER_ACCURACY / camera.K[0], compute_rms_deviation(spread)
                    )
                    seen["is_numbered"] = False
            if Need.KERNEL in needs:
                from aras_visual_servo_camera.kernel import compute_kernel_features

                mask = self.pipeline.make_original_mask(image)
                seen["kernel"] = make_read_only_copy(
                    compute_kernel_features(mask).to_message_data()
                )
        except VisionError as error:
            return False, str(error), seen
        return True, "", seen


def _make_read_only(array: np.ndarray) -> np.ndarray:
    """A read-only view: pictures are not copied."""
    view = array.view()
    view.setflags(write=False)
    return view
