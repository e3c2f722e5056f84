"""Interaction matrices of all features, compared with finite differences of images."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scenes import looking
from scipy.spatial.transform import Rotation

from aras_visual_servo_base.poses import adjoint, relative_pose
from aras_visual_servo_bench.targets.geometry import PolygonTarget, Target
from aras_visual_servo_bench.targets.rendering import render_target
from aras_visual_servo_bench.targets.target_factory import make_target
from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_controller.features import FEATURES, Feature, FeatureMeasurement
from aras_visual_servo_controller.features.luminance import LinearLuminanceFeature, Luminance
from aras_visual_servo_controller.features.matches import Matches
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.observation.feature_observer import FeatureObserver
from aras_visual_servo_controller.observation.observation import Need, Observation
from aras_visual_servo_controller.schemes import FeatureScheme

from .check import Row, check

_SIZE, _K = (320, 240), (290.0, 0.0, 165.3, 0.0, 297.0, 116.8, 0.0, 0.0, 1.0)
_CAMERAS = {
    "pinhole": CameraModel(*_SIZE, _K),
    "plumb_bob": CameraModel(*_SIZE, _K, (-0.25, 0.09, 0.001, -0.002, 0.0), "plumb_bob"),
}
# target_T_camera with tilts of 21 and 25 degrees and a rotation about the optical axis.
_VIEWS = {
    "pinhole": looking((0.10, -0.05, 0.28), (0.004, 0.003, 0.0), (0.3, 1.0, 0.0)),
    "plumb_bob": looking((-0.07, 0.11, 0.27), (-0.003, 0.004, 0.0), (-0.8, 1.0, 0.0)),
}
_GOAL = looking((0.03, 0.02, 0.31), (0.0, 0.0, 0.0), (-0.1, 1.0, 0.0))
_LEVEL = looking((0.01, 0.013, 0.3), (0.01, 0.013, 0.0), (0.3, 1.0, 0.0))
_SECOND = np.array([[0.995, 0.0, -0.0998, 0.06], [0.0, 1.0, 0.0, 0.005],
                    [0.0998, 0.0, 0.995, 0.004], [0.0, 0.0, 0.0, 1.0]])  # first_T_second
_CORNERS = np.array([(-0.03, -0.036), (0.0, -0.036), (0.004, 0.012), (0.034, 0.01), (0.03, 0.036),
                     (-0.034, 0.034)])  # fmt: skip
_WITHOUT_SYMMETRY = PolygonTarget(tuple(map(tuple, _CORNERS)))
_LARGE = PolygonTarget(tuple(map(tuple, 1.4 * _CORNERS)))
_PARALLELOGRAM = PolygonTarget(((-0.08, -0.05), (0.045, -0.055), (0.08, 0.05), (-0.045, 0.055)))


@dataclass(frozen=True)
class _Kind:
    """Test conditions of a group of features.

    names: names of the features. target: visible target. needs: inputs from the image.
    reach: largest camera motion in each direction, m and rad. count: number of images.
    degree: degree of the fitted polynomials. bound: largest relative error of a row of L.
    at_goal: True if the goal is at the tested pose. level: True for a perpendicular view.
    """

    names: frozenset[str]
    target: Target
    needs: frozenset[Need]
    bound: float
    reach: float = 0.03
    count: int = 41
    degree: int = 5
    at_goal: bool = False
    level: bool = False


def _named(*words: str) -> frozenset[str]:
    return frozenset(n for n in FEATURES if n.startswith(words))


def _kinds() -> list[_Kind]:
    photometric = _named("luminance", "photometric")
    sums = frozenset(n for n in photometric if issubclass(FEATURES[n], LinearLuminanceFeature))
    grey, kernel = photometric - sums, frozenset(("kernel",))
    matched, stereo = _named("matches"), _named("stereo")
    cornered = frozenset(
        n for n, f in FEATURES.items() if Need.CORNERS in f.needs and n not in stereo | matched)
    moments = frozenset(FEATURES) - photometric - matched - stereo - cornered - kernel
    poster = make_target("poster", (0.5, 0.4))
    return [
        _Kind(moments, _WITHOUT_SYMMETRY, frozenset((Need.MOMENTS,)), 0.005),
        _Kind(cornered, _PARALLELOGRAM, frozenset((Need.CORNERS,)), 0.02),
        _Kind(stereo, _PARALLELOGRAM, frozenset((Need.CORNERS,)), 0.03),
        # This feature uses whole pixels and supports only a perpendicular pinhole camera.
        _Kind(kernel, _LARGE, frozenset((Need.KERNEL,)), 0.1, 0.03, 201, 3, level=True),
        # Grey levels change linearly over one pixel, their sums over several.
        _Kind(grey, poster, frozenset((Need.IMAGE,)), 0.1, 1e-3, 9, 3, True),
        _Kind(sums, poster, frozenset((Need.IMAGE,)), 0.15, 4e-3, at_goal=True),
        _Kind(matched, poster, frozenset((Need.IMAGE,)), 0.1, 0.04, degree=3),
    ]


def _moved(step: float, axis: int) -> np.ndarray:
    """Return the displacement (4, 4) by step (m or rad) along or about a camera axis."""
    T = np.eye(4)
    if axis < 3:
        T[axis, 3] = step
    else:
        T[:3, :3] = Rotation.from_rotvec(step * np.eye(3)[axis - 3]).as_matrix()
    return T


class _Look:
    """Rendered images of a target, and their observations."""

    def __init__(self, kind: _Kind, camera: CameraModel) -> None:
        self._kind, self._camera = kind, camera
        self._observers = [
            FeatureObserver(None, kind.needs, name=name) for name in ("first", "second")
        ]
        self._stereo = any(FEATURES[name].reads > 1 for name in kind.names)

    def at(self, pose: np.ndarray) -> Observation:
        first = self._one(self._observers[0], pose)
        if not self._stereo:
            return first
        second = self._one(self._observers[1], pose @ _SECOND)
        across = adjoint(relative_pose(second.world_T_camera, first.world_T_camera))
        return replace(first, other_cameras={"second": replace(second, twist_from_control=across)})

    def _one(self, observer: FeatureObserver, pose: np.ndarray) -> Observation:
        target = self._kind.target
        observer.reset()
        observation = observer.observe_image(
            0.0, render_target(target, self._camera, pose), self._camera,
            plane=_plane(target, pose),
            world_T_camera=pose)  # fmt: skip
        if not observation.valid:
            raise RuntimeError(f"{', '.join(self._kind.names)}: {observation.reason}")
        return observation


def _plane(target: Target, pose: np.ndarray) -> Plane:
    return Plane(*(-pose[2, :3] / (pose[2, 3] - target.height)).tolist())


def _feature(name: str) -> Feature:
    feature = FEATURES.create(name)
    if feature.reads > 1:
        feature.cameras = ("first", "second")
    return feature


def _slopes(values: Callable[[np.ndarray], np.ndarray], kind: _Kind, pose: np.ndarray
            ) -> np.ndarray:
    """Return slopes (k, 6) at zero of polynomials through s (k,) of displaced cameras."""
    steps = np.linspace(-1.0, 1.0, kind.count)
    columns = []
    for axis in range(6):
        s = np.array([values(pose @ _moved(kind.reach * step, axis)) for step in steps])
        column = np.full(s.shape[1], np.nan)
        for i, one in enumerate(s.T):
            known = np.isfinite(one)
            if known.sum() > kind.degree + 3:
                column[i] = np.polynomial.polynomial.polyfit(
                    steps[known], one[known], kind.degree)[1] / kind.reach  # fmt: skip
        columns.append(column)
    return np.stack(columns, axis=1)


def _get_values(feature: Feature, measured: FeatureMeasurement) -> tuple[np.ndarray, np.ndarray]:
    """Return values (k,) of an image and their derivative (k, 6) by the camera's displacement.

    The values are the error. For photometric features they are the gradient g = L_I^T e of the
    normal equations, whose derivative is H = L_I^T L_I without damping, because these features
    have no other values that correspond between images.
    """
    L = measured.L
    if not isinstance(feature, Luminance) or isinstance(feature, LinearLuminanceFeature | Matches):
        return measured.error, L
    H, damped = L.T @ L, feature.damping / (1.0 + feature.damping)
    return L.T @ measured.error, H - damped * np.diag(H.diagonal())


def _in_order(
    feature: Feature, measured: FeatureMeasurement, first: FeatureMeasurement
) -> np.ndarray:
    """Return values (k,) in the order of the first image, with angles within half a turn of it."""
    now, then = (_get_values(feature, one)[0] for one in (measured, first))
    if np.array_equal(measured.desired, first.desired):
        now = now.copy()
        for i in range(len(now) if len(feature.units) == len(now) else 0):
            if feature.units[i] == "rad":
                now[i] -= np.pi * np.round((now[i] - then[i]) / np.pi)
        return now
    places = {tuple(d): p for d, p in zip(
        measured.desired.reshape(-1, 2), now.reshape(-1, 2), strict=True)}  # fmt: skip
    lost = (np.nan, np.nan)
    return np.ravel([places.get(tuple(d), lost) for d in first.desired.reshape(-1, 2)])


def _errors(kind: _Kind, lens: str) -> dict[str, float]:
    """Return the largest relative error of a row of L, by feature."""
    look, pose = _Look(kind, _CAMERAS[lens]), _LEVEL if kind.level else _VIEWS[lens]
    features, goals = {name: _feature(name) for name in sorted(kind.names)}, {}
    taught_at = pose if kind.at_goal else _GOAL
    for name, feature in features.items():
        goals[name] = Goal.teach(FeatureScheme(feature), look.at(taught_at))
        feature.check(goals[name])
    here = look.at(pose)
    first = {name: f.measure(here, goals[name]) for name, f in features.items()}

    def values(moved: np.ndarray) -> np.ndarray:
        observation = look.at(moved)
        return np.concatenate([
            _in_order(f, f.measure(observation, goals[name]), first[name])
            for name, f in features.items()])  # fmt: skip

    slopes = _slopes(values, kind, pose)
    found, begin = {}, 0
    for name, feature in features.items():
        L = _get_values(feature, first[name])[1]
        numeric = slopes[begin : begin + len(L)]
        begin += len(L)
        if kind.level:
            L, numeric = (rows[:, list(feature.directions)] for rows in (L, numeric))
        known = np.isfinite(numeric).all(axis=1)
        if known.sum() < min(len(L), 20):
            raise RuntimeError(f"{name}: only {known.sum()} of {len(L)} rows are finite")
        off, size = (np.linalg.norm(rows[known], axis=1) for rows in (numeric - L, numeric))
        # Single keypoints of several hundred are too noisy: compare all of them together.
        found[name] = float((off / size).max()) if len(L) <= 24 else float(
            np.linalg.norm(off) / np.linalg.norm(size))  # fmt: skip
    return found


@check("finite differences of images")
def interaction_matrices() -> Iterator[Row]:
    """Compare L of one rendered image with the slopes of s over images of displaced cameras."""
    kinds = _kinds()
    if left := set(FEATURES) - set().union(*(kind.names for kind in kinds)):
        raise RuntimeError(f"features without a check: {', '.join(sorted(left))}")
    for kind in kinds:
        lenses = ["pinhole"] if kind.level else list(_CAMERAS)
        errors = [_errors(kind, lens) for lens in lenses]
        seen_from = "perpendicular" if kind.level else "oblique"
        for name in sorted(kind.names):
            worst = max(error[name] for error in errors)
            yield Row(f"{name}, {seen_from}", "finite differences of s", worst, kind.bound,
                      "of a row")
