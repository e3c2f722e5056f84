"""A user's scheme: corners found by its own image processing, no segmentation asked for.

    roslaunch ... scheme:=own_corners:OwnCorners
"""

import cv2
import numpy as np

from aras_visual_servo_controller import MeasurementError, Need, PointFeature


class OwnCorners(PointFeature):
    """Corners of the largest dark shape: threshold, polygon, refined where the edges meet."""

    name = "own_corners"
    needs = frozenset((Need.IMAGE,))  # the picture alone
    directions = (True, True, True, False, False, True)  # the camera is kept level
    is_ordered = False  # a shape has no first corner: matched to the goal's by turning round

    def points(self, observation):
        image = observation.image
        grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        dark = cv2.threshold(grey, 128, 255, cv2.THRESH_BINARY_INV)[1]
        found, _ = cv2.findContours(dark, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        if not found:
            raise MeasurementError("own_corners: nothing dark in the picture")
        shape = max(found, key=cv2.contourArea)
        u, v, width, height = cv2.boundingRect(shape)
        rows, columns = grey.shape
        if u == 0 or v == 0 or u + width == columns or v + height == rows:
            raise MeasurementError("own_corners: the shape touches the border of the picture")
        rough = cv2.approxPolyDP(shape, 0.015 * cv2.arcLength(shape, True), True)
        criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 30, 0.005)
        fine = cv2.cornerSubPix(grey, rough.astype(np.float32), (2, 2), (-1, -1), criteria)[:, 0]
        x, y, seen = observation.camera.normalise(fine[:, 0], fine[:, 1])
        if not seen.all():
            raise MeasurementError("own_corners: a corner lies outside the lens")
        return np.stack([x, y], axis=1)
