"""Photometric features: the grey levels of the whole image, and linear functions of them.

The interaction matrix L_I has one row for each pixel and depends on the depth of the pixel:

    dI/dt = -(dI/dx, dI/dy) (dx/dt, dy/dt) = L_I v

References: C. Collewet and E. Marchand, Photometric visual servoing, IEEE Transactions on
Robotics 27(4), 2011; E. Marchand, Subspace-based direct visual servoing, IEEE RA-L 4(3), 2019
(principal components); E. Marchand, Direct visual servoing in the frequency domain, IEEE RA-L
5(2), 2020 (cosine transform); M. Bakthavatchalam, O. Tahri and F. Chaumette, A direct dense visual
servoing approach using photometric moments, IEEE Transactions on Robotics 34(5), 2018.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping
from typing import Any, ClassVar

import cv2
import numpy as np

from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_camera.interaction import Plane

from ..errors import ConfigurationError, MeasurementError
from ..goals.goal import Goal
from ..observation.observation import Need, Observation
from .base import FEATURES, Feature, FeatureMeasurement, compare_cameras, get_plane

# Root mean square difference of two images of the same view, in grey levels, due to rounding and
# rendering.
GREY_NOISE = 0.2
# Factor on the error of the features relative to that of single pixels. Smoothing makes the errors
# of neighbouring pixels nearly equal, so they do not average out over the image.
NEIGHBOUR_FACTOR = 3.5
SYMMETRY_ORDERS = (8, 7, 6, 5, 4, 3, 2)  # orders of the image's rotational symmetry that are tested
MAX_DEPTH = 500.0  # depths of the plane are limited to this, in units of the goal's distance
# Smallest part of the image that stays inside the image when it is rotated to test a symmetry.
MIN_OVERLAP = 0.3
BORDER = 10  # border of the image that is ignored, px, because new parts of the scene enter there
# The image has too little texture if an eigenvalue of L^T L is below this fraction of the largest.
EIGENVALUE_TOLERANCE = 1e-12


class _PixelRays:
    """Rays of one camera's pixels inside the border, and their derivatives.

    Attributes:
        x, y: (rows, columns) float32, normalised coordinates of each pixel.
        ux, uy, vx, vy: derivatives of the pixel coordinates (u, v) with respect to x and y.
    """

    def __init__(self, camera: CameraModel) -> None:
        self.camera = camera
        x, y = camera.tables.x, camera.tables.y
        by_row_x, by_column_x = np.gradient(x)
        by_row_y, by_column_y = np.gradient(y)
        scale = by_column_x * by_row_y - by_row_x * by_column_y
        inside = (slice(BORDER, -BORDER),) * 2
        if min(camera.width, camera.height) < 4 * BORDER:
            raise MeasurementError(
                "the image is too small for photometric servoing: use a camera with more pixels"
            )

        def crop(values: np.ndarray) -> np.ndarray:
            return np.ascontiguousarray(values[inside], np.float32)

        self.inside = inside
        self.x, self.y = crop(x), crop(y)
        self.ux, self.uy = crop(by_row_y / scale), crop(-by_row_x / scale)
        self.vx, self.vy = crop(-by_column_y / scale), crop(by_column_x / scale)

    def compute_interaction(self, grey: np.ndarray, plane: Plane) -> np.ndarray:
        """Compute L_I (6, pixels) float32, transposed, for the image `grey` of a plane.

        The image is an array (rows, columns) float32.
        """
        by_u = cv2.Sobel(grey, cv2.CV_32F, 1, 0, ksize=1, scale=0.5)[self.inside]
        by_v = cv2.Sobel(grey, cv2.CV_32F, 0, 1, ksize=1, scale=0.5)[self.inside]
        x, y = self.x, self.y
        gx, gy = by_u * self.ux + by_v * self.vx, by_u * self.uy + by_v * self.vy
        w = np.float32(plane.A) * x + np.float32(plane.B) * y + np.float32(plane.C)
        radial = x * gx + y * gy
        L = np.empty((6, *x.shape), np.float32)
        np.multiply(gx, w, out=L[0])
        np.multiply(gy, w, out=L[1])
        np.multiply(radial, -w, out=L[2])
        np.negative(y * radial + gy, out=L[3])
        np.add(x * radial, gx, out=L[4])
        np.subtract(x * gy, y * gx, out=L[5])
        return L.reshape(6, -1)


@FEATURES.register("luminance")
class Luminance(Feature):
    """s = the grey levels of all pixels, reduced to six numbers by the normal equations.

    Let e be the difference of the grey levels, H = L_I^T L_I = R^T R and g = L_I^T e. The six
    numbers R^-T g, with the interaction matrix R, give the same least-squares solution v = -gain
    H^-1 g as all pixels (Gauss-Newton). The root mean square of e is compared with the tolerance.

    Attributes:
        blur: standard deviation of the Gaussian smoothing of both images, px; a larger one enlarges
            the convergence domain.
        damping: factor mu of the Levenberg-Marquardt method, which replaces H by H + mu diag(H).
    """

    needs = frozenset((Need.IMAGE,))
    names, tolerances, units = ("rms",), (1.5,), ("grey level",)
    is_stackable = False
    blur: ClassVar[float] = 1.0
    damping: ClassVar[float] = 0.0

    def __init__(self) -> None:
        self._goal: Goal | None = None
        self._ambiguity = ""
        self._rays: _PixelRays | None = None
        self.reset()

    def reset(self) -> None:
        """Forget earlier images."""
        self._last_error: tuple[np.ndarray, np.ndarray] | None = None

    def teach(self, observation: Observation) -> Mapping[str, Any]:
        """Return the grey image itself, PNG-encoded, for the goal file."""
        png = cv2.imencode(".png", get_grey_image(observation))[1]
        return {"png": base64.b64encode(png).decode()}

    def check(self, goal: Goal) -> None:
        """Refuse a goal that this feature cannot servo to."""
        goal.check_depth(plane_suffices=True)
        try:
            data = base64.b64decode(goal.features[self.name]["png"])
            grey = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
        except (KeyError, TypeError, ValueError, cv2.error) as error:
            raise ConfigurationError(
                f"{goal.name} holds no image of {self.name}: teach it (rosrun "
                f"aras_visual_servo_controller teach --scheme {self.name})"
            ) from error
        if grey is None:
            raise ConfigurationError(
                f"{goal.name}: the image that was taught for the feature {self.name} cannot be "
                f"decoded: teach it again (rosrun aras_visual_servo_controller teach --scheme "
                f"{self.name})"
            )
        self._goal, self._goal_image, self._desired = goal, grey, self._smooth(grey)
        self._rays = None

    def measure(self, observation: Observation, goal: Goal) -> FeatureMeasurement:
        """Measure s, s*, the error and L in one image."""
        if self._goal is not goal:
            self.check(goal)
        now = self._smooth(get_grey_image(observation))
        if now.shape != self._desired.shape:
            raise MeasurementError(
                f"the image has {now.shape[1]} x {now.shape[0]} pixels, but the goal's image has "
                f"{self._desired.shape[1]} x {self._desired.shape[0]}: teach the goal with this "
                "camera"
            )
        if self._rays is None or self._rays.camera != observation.camera:
            self._check_camera(observation.camera, goal)
            self._rays = _PixelRays(observation.camera)
            self._ambiguity = self._find_symmetry(goal.plane or Plane.fronto_parallel(goal.depth))
        plane = get_plane(observation)
        inside = self._rays.inside
        error = np.subtract(now[inside], self._desired[inside]).ravel()
        rms = float(np.sqrt(np.dot(error, error) / error.size))
        rows = self._rays.compute_interaction(now, plane)
        self._last_error = error, rows
        s, L = self._reduce(error, rows)
        return FeatureMeasurement(
            s, np.zeros_like(s), s, L, error_summary=np.array([rms]), ambiguity=self._ambiguity
        )

    def _find_symmetry(self, plane: Plane) -> str:
        """Find the smallest rotation of the target that does not change its image at the goal.

        The target lies in `plane` at the goal. Return the angle as text, such as '90°', or '' if
        there is no such rotation.
        """
        rays, camera = self._rays, self._rays.camera
        goal_image = self._desired[rays.inside]
        normal = np.array(plane) / np.linalg.norm(plane)
        directions = np.stack([rays.x.ravel(), rays.y.ravel(), np.ones(rays.x.size)])
        depth = 1.0 / np.maximum(np.array(plane) @ directions, plane.C / MAX_DEPTH)
        # Each pixel is weighted by the area of the plane that it covers, which increases with the
        # cube of the depth.
        weight = np.abs(goal_image - np.median(goal_image)).ravel() * depth**3
        centre = directions @ (weight * depth) / max(weight.sum(), np.finfo(float).tiny)
        for folds in SYMMETRY_ORDERS:
            # A rotation of the plane's points X about their centre gives X' = R (X - centre) +
            # centre. As plane . X = 1, this is the homography R + (centre - R centre) plane^T.
            turn = cv2.Rodrigues(2.0 * np.pi / folds * normal)[0]
            X, Y, Z = (turn + np.outer(centre - turn @ centre, plane)) @ directions
            u, v = (
                np.asarray(part, np.float32).reshape(goal_image.shape)
                for part in camera.project(X / Z, Y / Z)
            )
            turned = cv2.remap(self._desired, u, v, cv2.INTER_LINEAR, borderValue=np.nan)
            inside = np.isfinite(turned)
            difference = np.square(turned - goal_image)[inside]
            if inside.mean() > MIN_OVERLAP and np.sqrt(difference.mean()) < self.tolerances[0]:
                return f"{360 / folds:.0f}°"
        return ""

    def accuracy(self, observation: Observation, goal: Goal) -> np.ndarray | None:
        """Return the accuracy of s, estimated from pixels of the latest image with large gradients.
        """
        error, rows = self._last_error
        slope = np.square(rows[0]) + np.square(rows[1])
        residual = np.sqrt(slope @ np.square(error) / slope.sum())
        return float(np.hypot(GREY_NOISE, NEIGHBOUR_FACTOR * residual)) * np.eye(6)

    @staticmethod
    def _check_camera(camera: CameraModel, goal: Goal) -> None:
        """Check that the goal was taught with this camera, as images are compared pixel by pixel.
        """
        taught = goal.camera
        if taught is None:
            return
        difference = compare_cameras(
            taught.width, taught.height, np.reshape(taught.K, (3, 3)), camera
        ) or _compare_lenses(taught, camera)
        if difference:
            raise MeasurementError(
                f"the image of {goal.name} was taught with another camera ({difference}): teach "
                "it again (rosrun aras_visual_servo_controller teach)"
            )

    def _reduce(self, error: np.ndarray, L: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Reduce the errors e (n,) of n pixels and L (6, n) to an error (6,) and its L (6, 6)."""
        H = (L @ L.T).astype(float)
        g = (L @ error).astype(float)
        return square_root(H + self.damping * np.diag(np.diag(H)), g)

    def _smooth(self, grey: np.ndarray) -> np.ndarray:
        return cv2.GaussianBlur(grey.astype(np.float32), (0, 0), self.blur)


@FEATURES.register("luminance_lm")
class LuminanceDamped(Luminance):
    """Levenberg-Marquardt control on the grey levels, with the damping of Collewet and Marchand."""

    damping: ClassVar[float] = 0.01


class LinearLuminanceFeature(Luminance):
    """Base class of linear functions s = B I of the image I, with the interaction matrix B L_I.

    Attributes:
        count: number of components of s.
    """

    count: ClassVar[int] = 10

    def __init__(self) -> None:
        super().__init__()
        self._basis: np.ndarray | None = None
        # pixel rays for which the stored basis was computed
        self._basis_rays: _PixelRays | None = None

    def make_basis(self, rays: _PixelRays) -> np.ndarray:
        """Return the basis B (count, pixels) for the pixels inside the border."""
        raise NotImplementedError

    def accuracy(self, observation: Observation, goal: Goal) -> np.ndarray | None:
        """Return the accuracy of s: that of one grey level, because the rows of B have length 1."""
        return GREY_NOISE * np.eye(len(self._basis))

    def _reduce(self, error: np.ndarray, L: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if self._basis_rays is not self._rays:
            basis = self.make_basis(self._rays)
            size = np.linalg.norm(basis, axis=1, keepdims=True)
            self._basis_rays = self._rays
            self._basis = np.ascontiguousarray(basis / size, np.float32)
        return (self._basis @ error).astype(float), (self._basis @ L.T).astype(float)


@FEATURES.register("luminance_dct")
class LuminanceDCT(LinearLuminanceFeature):
    """s = the lowest coefficients of the image's discrete cosine transform, without the mean."""

    count: ClassVar[int] = 20

    def make_basis(self, rays: _PixelRays) -> np.ndarray:
        """Return the basis B (count, pixels)."""
        rows, columns = rays.x.shape
        orders = sorted(
            ((p, q) for p in range(8) for q in range(8) if p + q), key=lambda o: (sum(o), o)
        )[: self.count]
        down = np.cos(np.pi * np.outer(np.arange(8), np.arange(rows) + 0.5) / rows)
        across = np.cos(np.pi * np.outer(np.arange(8), np.arange(columns) + 0.5) / columns)
        return np.array([np.outer(down[p], across[q]).ravel() for p, q in orders])


@FEATURES.register("luminance_pca")
class LuminancePCA(LinearLuminanceFeature):
    """s = principal components of images that are generated by transforming the goal image.

    The images are generated by random shifts, rotations and scalings with a fixed seed.
    """

    count: ClassVar[int] = 20
    views: ClassVar[int] = 80
    # Largest shift (fraction of the image's width), rotation (rad) and relative change of scale of
    # the image.
    spread: ClassVar[tuple[float, float, float]] = (0.1, 0.2, 0.1)

    def make_basis(self, rays: _PixelRays) -> np.ndarray:
        """Return the basis B (count, pixels)."""
        random = np.random.default_rng(0)
        rows, columns = self._desired.shape
        shift, turn, size = self.spread
        views = []
        for _ in range(self.views):
            angle = np.degrees(random.uniform(-turn, turn))
            moved = cv2.getRotationMatrix2D(
                (0.5 * columns, 0.5 * rows), angle, 1.0 + random.uniform(-size, size)
            )
            moved[:, 2] += random.uniform(-shift, shift, 2) * columns
            view = cv2.warpAffine(
                self._desired, moved, (columns, rows), borderMode=cv2.BORDER_REFLECT
            )
            views.append(view[rays.inside].ravel() - self._desired[rays.inside].ravel())
        # V has few but long rows, so its principal components are computed from the small matrix V
        # V^T.
        V = np.array(views)
        values, vectors = np.linalg.eigh((V @ V.T).astype(float))
        chosen = np.argsort(values)[::-1][: self.count]
        return vectors[:, chosen].T @ V


@FEATURES.register("photometric_moments")
class PhotometricMoments(LinearLuminanceFeature):
    """s = moments of the grey levels up to third order, with weights that decrease to the border.
    """

    order: ClassVar[int] = 3

    def make_basis(self, rays: _PixelRays) -> np.ndarray:
        """Return the basis B (count, pixels)."""
        x, y = rays.x.astype(float), rays.y.astype(float)
        reach = min(np.abs(x).max(), np.abs(y).max())
        weight = np.exp(-4.0 * ((x**2 + y**2) / reach**2) ** 2)
        return np.array([
            (weight * x**p * y ** (n - p)).ravel()
            for n in range(self.order + 1) for p in range(n + 1)
        ])  # fmt: skip


def square_root(H: np.ndarray, g: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute s (6,) and R (6, 6) with R^T R = H and R^T s = g.

    Raises:
        MeasurementError: the image has too little texture to show all camera motions.
    """
    values, vectors = np.linalg.eigh(H)
    if not values[0] > EIGENVALUE_TOLERANCE * values[-1]:
        raise MeasurementError(
            "the image has too little texture for photometric servoing: use a textured target"
        )
    roots = np.sqrt(values)
    return vectors.T @ g / roots, roots[:, None] * vectors.T


def _compare_lenses(goal_camera: CameraModel, camera: CameraModel) -> str:
    """Describe how the distortions of two cameras differ; '' if they are equal."""
    goal_lens, lens = (
        (one.model if any(one.D) else "", np.trim_zeros(one.D, "b"))
        for one in (goal_camera, camera)
    )
    if goal_lens[0] == lens[0] and len(goal_lens[1]) == len(lens[1]) and (
        np.allclose(goal_lens[1], lens[1])
    ):
        return ""
    return (
            f"lens {goal_camera.model} {list(goal_camera.D)}; "
            f"this camera's lens is {camera.model} {list(camera.D)}"
        )


def get_grey_image(observation: Observation) -> np.ndarray:
    """Return the grey image (rows, columns) uint8 of an observation.

    Raises:
        MeasurementError: the observation has no image.
    """
    image = observation.image
    if image is None:
        raise MeasurementError(
            "this observation has no image, because its features are exact: set features to images"
        )
    return image if image.ndim == 2 else cv2.cvtColor(np.asarray(image), cv2.COLOR_RGB2GRAY)
