"""Photometric visual servoing: the features are the grey levels of the whole image.

Reference: C. Collewet and E. Marchand, Photometric visual servoing, IEEE T-RO 27(4), 2011."""

import base64

import cv2
import numpy as np

from aras_visual_servo_controller import (
    ConfigurationError,
    Feature,
    FeatureMeasurement,
    MeasurementError,
    Need,
    point_interaction,
)

BLUR, STEP = 6.0, 2  # px; a wider blur gives a larger convergence domain


class Photometric(Feature):
    """Grey levels s = I of every other pixel, with dI/dt = -grad I . (dx/dt)."""

    name, needs = "photometric", frozenset((Need.IMAGE,))
    names, tolerances, units = ("rms",), (1.5,), ("grey level",)
    directions = (True, True, True, False, False, True)  # tilt hardly changes a flat target

    def teach(self, observation):
        png = cv2.imencode(".png", self._grey(observation.image))[1]
        return {"png": base64.b64encode(png).decode()}

    def check(self, goal):
        if "png" not in goal.features.get(self.name, {}) or goal.depth is None:
            raise ConfigurationError(f"{goal.name} has no image for photometric: teach it again")
        data = np.frombuffer(base64.b64decode(goal.features[self.name]["png"]), np.uint8)
        self.desired = self._blur(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE))

    def measure(self, observation, goal):
        now, camera = self._blur(self._grey(observation.image)), observation.camera
        if now.shape != self.desired.shape:
            raise MeasurementError("the size of the image differs from that of the goal")
        rows, columns = (np.arange(4, n - 4, STEP) for n in now.shape)
        u, v = (grid.ravel() for grid in np.meshgrid(columns, rows))
        x, y, _ = camera.normalise(u.astype(float), v.astype(float))
        gx = cv2.Sobel(now, cv2.CV_64F, 1, 0)[v, u] / 8.0 * camera.pinhole.fx
        gy = cv2.Sobel(now, cv2.CV_64F, 0, 1)[v, u] / 8.0 * camera.pinhole.fy
        points = point_interaction(np.stack([x, y], axis=1), np.full(len(x), 1.0 / goal.depth))
        L = -(gx[:, None] * points[0::2] + gy[:, None] * points[1::2])
        s, desired = now[v, u], self.desired[v, u]
        rms = np.sqrt(np.mean((s - desired) ** 2))
        return FeatureMeasurement(s, desired, s - desired, L, error_summary=np.array([rms]))

    @staticmethod
    def _grey(image):
        return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)

    @staticmethod
    def _blur(grey):
        return cv2.GaussianBlur(grey.astype(float), (0, 0), BLUR)
