"""Scheme with its own corner detector, without the segmentation of the camera package.

    roslaunch ... scheme:=own_corners:OwnCorners
"""

import cv2
import numpy as np

from aras_visual_servo_controller import MeasurementError, Need, PointFeature


class OwnCorners(PointFeature):
    """Corners of the largest dark shape, from threshold, polygon fit and subpixel refinement."""

    name = "own_corners"
    needs = frozenset((Need.IMAGE,))  # only the image
    directions = (True, True, True, False, False, True)  # the tilt is not controlled
    is_ordered = False  # no first corner: find the rotation that matches the goal

    def points(self, observation):
        image = observation.image
        grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        dark = cv2.threshold(grey, 128, 255, cv2.THRESH_BINARY_INV)[1]
        found, _ = cv2.findContours(dark, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        if not found:
            raise MeasurementError("own_corners: no dark shape in the image")
        shape = max(found, key=cv2.contourArea)
        u, v, width, height = cv2.boundingRect(shape)
        rows, columns = grey.shape
        if u == 0 or v == 0 or u + width == columns or v + height == rows:
            raise MeasurementError("own_corners: the shape touches the border of the image")
        rough = cv2.approxPolyDP(shape, 0.015 * cv2.arcLength(shape, True), True)
        criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 30, 0.005)
        fine = cv2.cornerSubPix(grey, rough.astype(np.float32), (2, 2), (-1, -1), criteria)[:, 0]
        x, y, is_visible = observation.camera.normalise(fine[:, 0], fine[:, 1])
        if not is_visible.all():
            raise MeasurementError("own_corners: a corner is outside the field of view of the lens")
        return np.stack([x, y], axis=1)
