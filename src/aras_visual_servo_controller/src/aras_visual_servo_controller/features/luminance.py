"""Photometric features: the grey levels of the whole picture, and linear maps of them.

    dI/dt = -(dI/dx, dI/dy) (dx/dt, dy/dt) = L_I v,   a row for each pixel, with its depth.

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

from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.undistortion import CameraModel

from ..errors import ConfigurationError, MeasurementError
from ..goals.goal import Goal
from ..observation.observation import Need, Observation
from .base import FEATURES, Feature, FeatureMeasurement, compare_cameras, get_plane

# grey levels: what rounding and drawing amount to in a fit of two pictures of one view
GREY_NOISE = 0.2
# a smoothed pixel's error counts so much in a fit: its neighbours have it as well
NEIGHBOUR_FACTOR = 3.5
SYMMETRY_ORDERS = (8, 7, 6, 5, 4, 3, 2)  # of the symmetries that are looked for
MAX_DEPTH = 500.0  # goal's depths: of the plane is not looked at what is farther
MIN_OVERLAP = 0.3  # part of the picture that has to be in view before and after the turn
BORDER = 10  # pixels at the picture's rim that are left out: what comes in there was not seen
# part of the greatest eigenvalue of L^T L below which the picture tells nothing
EIGENVALUE_TOLERANCE = 1e-12


class _PixelRays:
    """Of each pixel inside the border, for one camera: its ray, and pixels per ray's length.

    x, y: (rows, columns) float32. ux, uy, vx, vy: derivatives of the pixel by the ray.
    """

    def __init__(self, camera: CameraModel) -> None:
        self.camera = camera
        x, y = camera.tables.x, camera.tables.y
        by_row_x, by_column_x = np.gradient(x)
        by_row_y, by_column_y = np.gradient(y)
        scale = by_column_x * by_row_y - by_row_x * by_column_y
        inside = (slice(BORDER, -BORDER),) * 2
        if min(camera.width, camera.height) < 4 * BORDER:
            raise MeasurementError("the picture is too small for photometric servoing")

        def crop(values: np.ndarray) -> np.ndarray:
            return np.ascontiguousarray(values[inside], np.float32)

        self.inside = inside
        self.x, self.y = crop(x), crop(y)
        self.ux, self.uy = crop(by_row_y / scale), crop(-by_row_x / scale)
        self.vx, self.vy = crop(-by_column_y / scale), crop(by_column_x / scale)

    def compute_interaction(self, grey: np.ndarray, plane: Plane) -> np.ndarray:
        """L_I (6, pixels) float32 of a picture (rows, columns) float32 of a plane."""
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
    """s = the grey level of every pixel; what goes to the law is its normal equations.

    With H = L_I^T L_I = R^T R and g = L_I^T e, six numbers R^-T g with the interaction matrix R
    have the same least squares: v = -gain H^-1 g, Gauss-Newton. Judged is the root of the mean
    squared difference of grey levels.

    Attributes:
        blur: standard deviation of the smoothing of both pictures, px: the wider, the wider the
            way that it converges from. damping: mu of Levenberg-Marquardt, H + mu diag(H).
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
        """See Feature.teach: the picture itself."""
        png = cv2.imencode(".png", get_grey_image(observation))[1]
        return {"png": base64.b64encode(png).decode()}

    def check(self, goal: Goal) -> None:
        """Refuse a goal that this feature cannot servo to."""
        if goal.depth is None and goal.plane is None:
            raise ConfigurationError(f"{goal.name} does not say the target's depth (m)")
        try:
            data = base64.b64decode(goal.features[self.name]["png"])
            grey = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
        except (KeyError, TypeError, ValueError, cv2.error) as error:
            raise ConfigurationError(
                f"{goal.name} holds no picture of {self.name}: teach it (rosrun "
                f"aras_visual_servo_controller teach --scheme {self.name})"
            ) from error
        if grey is None:
            raise ConfigurationError(f"{goal.name}: the picture of {self.name} is damaged")
        self._goal, self._goal_image, self._desired = goal, grey, self._smooth(grey)
        self._rays = None

    def measure(self, observation: Observation, goal: Goal) -> FeatureMeasurement:
        """Measure s, s*, the error and L in one image."""
        if self._goal is not goal:
            self.check(goal)
        now = self._smooth(get_grey_image(observation))
        if now.shape != self._desired.shape:
            raise MeasurementError(
                f"the picture has {now.shape[1]} x {now.shape[0]} pixels, the goal's "
                f"{self._desired.shape[1]} x {self._desired.shape[0]}"
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
        """The turn of the target, lying in a plane at the goal, after which its picture counts as
        the goal's: '90°'; empty where there is none."""
        rays, camera = self._rays, self._rays.camera
        wanted = self._desired[rays.inside]
        normal = np.array(plane) / np.linalg.norm(plane)
        directions = np.stack([rays.x.ravel(), rays.y.ravel(), np.ones(rays.x.size)])
        depth = 1.0 / np.maximum(np.array(plane) @ directions, plane.C / MAX_DEPTH)
        # A pixel covers an area of the plane that grows with the cube of the depth.
        weight = np.abs(wanted - np.median(wanted)).ravel() * depth**3
        middle = directions @ (weight * depth) / max(weight.sum(), np.finfo(float).tiny)
        for folds in SYMMETRY_ORDERS:
            # X' = R (X - middle) + middle of the points of the plane, whose rays a homography maps.
            turn = cv2.Rodrigues(2.0 * np.pi / folds * normal)[0]
            X, Y, Z = (turn + np.outer(middle - turn @ middle, plane)) @ directions
            u, v = (
                np.asarray(part, np.float32).reshape(wanted.shape)
                for part in camera.project(X / Z, Y / Z)
            )
            turned = cv2.remap(self._desired, u, v, cv2.INTER_LINEAR, borderValue=np.nan)
            inside = np.isfinite(turned)
            apart = np.square(turned - wanted)[inside]
            if inside.mean() > MIN_OVERLAP and np.sqrt(apart.mean()) < self.tolerances[0]:
                return f"{360 / folds:.0f}°"
        return ""

    def accuracy(self, observation: Observation, goal: Goal) -> np.ndarray | None:
        """See Feature.accuracy: by the grey levels that the last image left, where edges are."""
        error, rows = self._last_error
        slope = np.square(rows[0]) + np.square(rows[1])
        left = np.sqrt(slope @ np.square(error) / slope.sum())
        return float(np.hypot(GREY_NOISE, NEIGHBOUR_FACTOR * left)) * np.eye(6)

    @staticmethod
    def _check_camera(camera: CameraModel, goal: Goal) -> None:
        """Grey levels are compared pixel by pixel: another lens sees other places with them."""
        taught = goal.camera
        if taught is None:
            return
        told = compare_cameras(
            taught.width, taught.height, np.reshape(taught.K, (3, 3)), camera
        ) or _compare_lenses(taught, camera)
        if told:
            raise MeasurementError(
                f"the picture of {goal.name} was taught with another camera ({told}): teach it "
                "anew (rosrun aras_visual_servo_controller teach)"
            )

    def _reduce(self, error: np.ndarray, L: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What the law gets of e (n,) and L (6, n): an error and its interaction matrix."""
        H = (L @ L.T).astype(float)
        g = (L @ error).astype(float)
        return square_root(H + self.damping * np.diag(np.diag(H)), g)

    def _smooth(self, grey: np.ndarray) -> np.ndarray:
        return cv2.GaussianBlur(grey.astype(np.float32), (0, 0), self.blur)


@FEATURES.register("luminance_lm")
class LuminanceDamped(Luminance):
    """Levenberg-Marquardt on the grey levels, with the damping of Collewet and Marchand."""

    damping: ClassVar[float] = 0.01


class LuminanceMap(Luminance):
    """Base of s = B I: a few numbers of the picture, with the rows B L_I.

    Attributes:
        count: of the numbers.
    """

    count: ClassVar[int] = 10

    def __init__(self) -> None:
        super().__init__()
        self._basis: np.ndarray | None = None
        self._basis_rays: _PixelRays | None = None  # which are new with each goal and each camera

    def make_basis(self, rays: _PixelRays) -> np.ndarray:
        """B (count, pixels), of pixels inside the border."""
        raise NotImplementedError

    def accuracy(self, observation: Observation, goal: Goal) -> np.ndarray | None:
        """See Feature.accuracy; the rows of the basis have length 1."""
        return GREY_NOISE * np.eye(len(self._basis))

    def _reduce(self, error: np.ndarray, L: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if self._basis_rays is not self._rays:
            basis = self.make_basis(self._rays)
            size = np.linalg.norm(basis, axis=1, keepdims=True)
            self._basis_rays = self._rays
            self._basis = np.ascontiguousarray(basis / size, np.float32)
        return (self._basis @ error).astype(float), (self._basis @ L.T).astype(float)


@FEATURES.register("luminance_dct")
class LuminanceDCT(LuminanceMap):
    """s = the lowest coefficients of the picture's cosine transform, but the mean."""

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
class LuminancePCA(LuminanceMap):
    """s = principal components of pictures that the goal's own picture gives when it is moved.

    The views are made from it: shifts, turns and scales, drawn by a fixed seed.
    """

    count: ClassVar[int] = 20
    views: ClassVar[int] = 80
    spread: ClassVar[tuple[float, float, float]] = (0.1, 0.2, 0.1)  # of width, rad, of size

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
        # The components of few long vectors, by the products of the vectors with each other.
        V = np.array(views)
        values, vectors = np.linalg.eigh((V @ V.T).astype(float))
        chosen = np.argsort(values)[::-1][: self.count]
        return vectors[:, chosen].T @ V


@FEATURES.register("photometric_moments")
class PhotometricMoments(LuminanceMap):
    """s = moments up to the third order of the grey levels, weighted to fade towards the rim."""

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
    """s (6,) and R (6, 6) with R^T R = H and R^T s = g.

    Raises:
        MeasurementError: the picture tells nothing of some motion: it is of one colour.
    """
    values, vectors = np.linalg.eigh(H)
    if not values[0] > EIGENVALUE_TOLERANCE * values[-1]:
        raise MeasurementError("the picture has too little texture for photometric servoing")
    roots = np.sqrt(values)
    return vectors.T @ g / roots, roots[:, None] * vectors.T


def _compare_lenses(goal_camera: CameraModel, camera: CameraModel) -> str:
    """How the distortion differs, in words; empty where it does not."""
    there, here = (
        (one.model if any(one.D) else "", np.trim_zeros(one.D, "b"))
        for one in (goal_camera, camera)
    )
    if there[0] == here[0] and len(there[1]) == len(here[1]) and np.allclose(there[1], here[1]):
        return ""
    return (
            f"lens {goal_camera.model} {list(goal_camera.D)}; "
            f"this one's is {camera.model} {list(camera.D)}"
        )


def get_grey_image(observation: Observation) -> np.ndarray:
    """The picture (rows, columns) uint8.

    Raises:
        MeasurementError: there is none.
    """
    image = observation.image
    if image is None:
        raise MeasurementError("no picture in this observation: exact features have none")
    return image if image.ndim == 2 else cv2.cvtColor(np.asarray(image), cv2.COLOR_RGB2GRAY)
