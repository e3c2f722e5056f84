"""From an image to what a scheme needs of it: moments, contour, corners, kernel, pixels, plane."""

from __future__ import annotations

from math import hypot
from typing import TYPE_CHECKING

import numpy as np

from aras_visual_servo_camera.contour import CORNER_ACCURACY, fit_corners, outline_of
from aras_visual_servo_camera.errors import VisionError
from aras_visual_servo_camera.images import Image
from aras_visual_servo_camera.line_fits import deviation_of
from aras_visual_servo_camera.pipeline import Pipeline, PipelineSettings

from ..arm.joint_sample import frozen
from .observation import SEGMENTED, Need

if TYPE_CHECKING:
    from aras_visual_servo_camera.interaction import Plane
    from aras_visual_servo_camera.segmentation import Segmentation
    from aras_visual_servo_camera.trackers import Tracker
    from aras_visual_servo_camera.undistortion import CameraModel

    from .frame import Frame

Seen = dict[str, object]  # by field of Observation


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
    def image_of(frame: Frame) -> Image:
        """The image of a frame with its encoding, as the camera package reads it."""
        return Image(frame.image, frame.encoding, frame.labelled)

    def read(
        self,
        image: Image | np.ndarray,
        camera: CameraModel,
        pose: np.ndarray | None,
        depth: np.ndarray | None,
        plane: Plane | None,
    ) -> tuple[bool, str, Plane | None, Seen]:
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
        seen: Seen = {}
        valid, reason = True, ""
        tracked = self.tracker is not None and Need.CORNERS in self.needs
        needs = self.needs - {Need.CORNERS} if tracked else self.needs
        if needs & SEGMENTED:
            valid, reason, seen = self._segmented(image, camera, needs)
        if valid and tracked:
            try:
                found = self.tracker.look(image.grey, camera, pose, depth)
                seen["corners"] = frozen(found.points)
                seen["corner_accuracy"] = found.accuracy
                seen["corner_unshared"] = found.unshared
                seen["corner_spread"] = None if found.spread is None else frozen(found.spread)
                seen["numbered"] = self.tracker.numbered
                seen["marker"] = found.marker
                plane = found.plane if plane is None else plane
            except VisionError as error:
                valid, reason = False, str(error)
        if Need.IMAGE in self.needs:
            pixels = image.rgb if image.has_colour else image.grey
            seen["image"] = _read_only(pixels)
        if Need.DEPTH in self.needs and depth is not None:
            seen["depth"] = _read_only(np.asarray(depth, np.float32))
            if plane is None and valid:
                from .depth_image import plane_of

                plane = plane_of(seen["depth"], camera, seen.get("corners", seen.get("contour")))
        return valid, reason, plane, seen

    def _segmented(
        self, image: Image, camera: CameraModel, needs: frozenset[Need]
    ) -> tuple[bool, str, Seen]:
        """What the pipeline finds of the target."""
        self.pipeline.set_camera(camera)
        try:
            measured = self.pipeline.measure(image)
        except VisionError as error:
            return False, str(error), {}
        target = measured.target
        seen: Seen = {"pixel_count": target.pixel_count, "touches": target.borders}
        if not measured.valid:
            return False, measured.reason, seen
        seen["moments"] = measured.moments
        try:
            if needs & {Need.CONTOUR, Need.CORNERS, Need.DEPTH}:
                contour = outline_of(image.grey, target, camera)
                seen["contour"] = frozen(contour)
                if Need.CORNERS in needs:
                    corners, spread = fit_corners(contour)
                    seen["corners"], seen["corner_spread"] = frozen(corners), frozen(spread)
                    seen["corner_accuracy"] = hypot(
                        CORNER_ACCURACY / camera.K[0], deviation_of(spread)
                    )
                    seen["numbered"] = False
            if Need.KERNEL in needs:
                from aras_visual_servo_camera.kernel import kernel_features

                mask = self.pipeline.original_mask(image)
                seen["kernel"] = frozen(kernel_features(mask).layout())
        except VisionError as error:
            return False, str(error), seen
        return True, "", seen


def _read_only(array: np.ndarray) -> np.ndarray:
    """A read-only view: pictures are not copied."""
    view = array.view()
    view.setflags(write=False)
    return view
