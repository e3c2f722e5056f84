"""Declarations of features and schemes: names, units, tolerances, directions, defaults."""

import re

import numpy as np
import pytest

from aras_visual_servo_camera.undistortion import CameraModel
from aras_visual_servo_controller.errors import ConfigurationError
from aras_visual_servo_controller.features import (
    FEATURES,
    base,
    corners,
    kernel,
    luminance,
    matches,
    moment_features,
    moments,
    points,
    pose,
    stereo,
)
from aras_visual_servo_controller.kinematics.task import DIRECTIONS
from aras_visual_servo_controller.observation.observation import Need
from aras_visual_servo_controller.schemes import base as schemes
from aras_visual_servo_controller.schemes import create_scheme
from aras_visual_servo_controller.schemes.broyden import Broyden
from aras_visual_servo_controller.schemes.feature_scheme import FeatureScheme
from aras_visual_servo_controller.schemes.laboratory_2016 import Laboratory2016
from aras_visual_servo_controller.schemes.predictive import Predictive

MODULES = (
    corners, kernel, luminance, matches, moment_features, moments, points, pose, stereo,
)  # fmt: skip
# Of elements (corners, edges, ...) those of one.
COMPONENTS = {
    "moments": "xn yn an alpha", "kernel": "kernel_0 kernel_1 kernel_2 kernel_3",
    "points": "x y", "numbered_points": "x y", "polar_points": "rho theta", "points_3d": "X Y Z",
    "depth": "log_Z", "lines": "rho theta", "segments": "xm ym length angle",
    "normalised_segments": "xn yn inverse_length angle", "vanishing_points": "inverse_rho alpha",
    "theta_u": "ux uy uz", "translation": "tx ty tz", "translation_camera": "tx ty tz",
    "pose": "tx ty tz ux uy uz", "model": "tx ty tz ux uy uz", "pose_camera": "tx ty tz ux uy uz",
    "two_and_half_d": "x y log_Z ux uy uz", "basic_moments": "m00 m10 m01 m20 m11 m02",
    "centred_moments": "mu20 mu11 mu02 mu30 mu21 mu12 mu03", "gravity_centre": "xg yg",
    "gravity_centre_normalised": "xn yn", "area": "area", "area_normalised": "an",
    "alpha": "alpha", "ellipse": "xg yg n20 n11 n02",
    "invariants": "C1 C2 C3 C4 C5 C6 C7 C8 C9 C10", "sx_sy": "Sx Sy", "px_py": "Px Py",
    "moments_pitch": "xn yn an Sy alpha", "moments_six": "xn yn an Sx Sy alpha",
    "luminance": "rms", "luminance_lm": "rms", "luminance_dct": "rms", "luminance_pca": "rms",
    "photometric_moments": "rms", "matches": "rms", "matches_orb": "rms",
    "matches_pose": "tx ty tz ux uy uz", "stereo_points": "X Y Z",
    "stereo_pose": "tx ty tz ux uy uz",
}  # fmt: skip
# Four corners and their edges, the middle of all, or two pairs of sides.
ELEMENTS = {
    "points": 4, "numbered_points": 4, "polar_points": 4, "points_3d": 4, "lines": 4,
    "segments": 4, "normalised_segments": 4, "stereo_points": 4, "depth": 1, "vanishing_points": 2,
}  # fmt: skip
# Below these a component counts as reached, by its unit: one of a name has the same everywhere.
REACHED = {
    "m": {"xn yn": 2.5e-3, "an": 5e-3, "X Y tx ty tz": 1e-3, "Z": 2e-3},  # of the depth
    "rad": {"alpha theta angle": 5e-3, "ux uy uz": 3e-3, "kernel_3": 0.04},
    "grey level": {"rms": 1.5},
    "": {
        "x y rho xm ym xg yg Sx Sy Px Py rms": 1e-3, "length": 2e-3,
        "xn yn log_Z inverse_rho": 5e-3, "inverse_length": 0.01,
        "m00 m10 m01 area": 1e-4, "m20 m11 m02 mu20 mu11 mu02 n20 n11 n02": 1e-5,
        "mu30 mu21 mu12 mu03": 1e-6, "kernel_0 kernel_1": 0.01, "kernel_2": 0.02,
        "C1 C2 C3 C4 C5 C6 C7 C8 C9 C10": 0.01,
    },
}  # fmt: skip
TURN = 2.0 * np.pi
LEVEL = "vx vy vz wz"
# Directions in which a camera that looks square on is moved, of each that models not all of them.
MODELLED = {
    "gravity_centre": "vx vy", "gravity_centre_normalised": "vx vy", "area": "vz",
    "area_normalised": "vz", "depth": "vz", "alpha": "wz", "sx_sy": "wx wy", "px_py": "wx wy",
    "invariants": "wx wy", "vanishing_points": "wx wy wz", "theta_u": "wx wy wz",
    "translation": "vx vy vz", "moments_pitch": "vx vy vz wy wz", "moments": LEVEL, "kernel": LEVEL,
}  # fmt: skip
IMAGES = {"kernel": Need.KERNEL} | dict.fromkeys(
    ("luminance", "luminance_lm", "luminance_dct", "luminance_pca", "photometric_moments",
     "matches", "matches_orb", "matches_pose"), Need.IMAGE)  # fmt: skip


def test_the_components_of_each_and_when_they_are_reached():
    assert set(FEATURES) == set(COMPONENTS)
    for name, made in FEATURES.items():
        feature, parts = made(), COMPONENTS[name].split()
        assert made.__module__ in {module.__name__ for module in MODULES} and made.name == name
        expected = parts
        if name in ELEMENTS:
            expected = [f"{part}{i}" for i in range(ELEMENTS[name]) for part in parts]
        assert list(feature.names) == expected
        for told, tolerance, unit in zip(expected, feature.tolerances, feature.units, strict=True):
            part = re.sub(r"\d+$", "", told) if name in ELEMENTS else told
            alike = [most for names, most in REACHED[unit].items() if part in names.split()]
            assert (name, told, [tolerance]) == (name, told, alike)
        if isinstance(feature, corners.CornerFeature):
            units = zip(feature.periods, feature.units[: len(parts)], strict=True)
            assert all(period == (TURN if unit == "rad" else 0.0) for period, unit in units)


def test_the_directions_that_each_models_and_what_it_needs():
    for name, made in FEATURES.items():
        feature = made()
        pairs = zip(DIRECTIONS, feature.directions, strict=True)
        modelled = " ".join(word for word, one in pairs if one)
        assert (name, modelled) == (name, MODELLED.get(name, " ".join(DIRECTIONS)))
        moments_of = issubclass(made, moments.MomentFeature)
        need = IMAGES.get(name, Need.MOMENTS if moments_of else Need.CORNERS)
        assert (name, feature.needs) == (name, {need})
        assert feature.camera_count == (2 if name.startswith("stereo") else 1)
        assert feature.is_stackable is (feature.names != ("rms",))
    assert kernel.Kernel.ratio == (1.0, 1.0, 1.0, 0.3)
    np.testing.assert_allclose(Laboratory2016.ratio, np.array([140, 120, 60, 30]) / 140)
    assert (matches.Matches.max_width, matches.MatchesORB.max_width) == (320, 640)
    assert (matches.Matches.count, matches.MatchesORB.detector) == (500, "orb")
    assert (luminance.LuminanceDCT.count, luminance.LuminanceMap.count) == (20, 10)
    components = luminance.LuminancePCA
    assert (components.count, components.views, components.spread) == (20, 80, (0.1, 0.2, 0.1))
    assert luminance.PhotometricMoments.order == 3
    for made in (luminance.Luminance, luminance.LuminanceDamped, components):
        damping = 0.01 if made is luminance.LuminanceDamped else 0.0
        assert (made.blur, made.damping) == (1.0, damping)


def test_what_schemes_are_made_with_where_nothing_is_said():
    planned = Predictive
    assert (planned.horizon, planned.steps, planned.effort) == (0.4, 4, 1e-4)
    assert planned.speed == (1.0, 1.0, 1.0, 1.5, 1.5, 1.5) and planned.margin == 12.0
    assert not planned()._last_twist.any() and planned()._last_twist.shape == (6,)
    assert (Broyden().gain, Broyden().floor, Broyden().start) == (0.5, None, None)
    plain = create_scheme("moments")
    assert (plain.interaction, plain.smoothing, plain.ratio) == ("current", 0.0, None)
    assert plain.estimator is None and plain.can_check_camera
    for interaction in ("desired", "mean", "estimated"):
        other = create_scheme("moments", interaction=interaction)
        assert not other.can_check_camera
        assert (type(other.estimator) is Broyden) is (interaction == "estimated")
    assert create_scheme("kernel").ratio.tolist() == [1.0, 1.0, 1.0, 0.3]
    assert create_scheme("kernel", weights=[2.0]).ratio is None
    assert create_scheme("kernel", ratio=[2.0] * 4).ratio.tolist() == [2.0] * 4
    assert create_scheme("kernel+points").ratio is None
    assert FeatureScheme([kernel.Kernel()]).feature.name == "kernel"
    said = {"interaction": "current", "smoothing": 0.0, "ratio": None, "estimator": ""}
    for name in ("partitioned", "predictive", "moments_2016"):
        law = schemes.Proportional(3.0)
        assert create_scheme(name, law, **said).law is law
        for option in ({"smoothing": 1.0}, {"interaction": "mean"}, {"weights": [1.0]}):
            words = f"scheme '{name}' takes no {next(iter(option))}, which only features use"
            with pytest.raises(ConfigurationError, match=words):
                create_scheme(name, **option)
    blind = points.Points()
    blind.is_geometric = False
    assert not FeatureScheme(blind).can_check_camera
    assert not FeatureScheme([points.Points(), blind]).can_check_camera
    for one in (plain, create_scheme("area+points")):
        assert one.needs == one.feature.needs and one.names == one.feature.names
        assert one.units == tuple(one.feature.units)


def test_what_a_user_s_own_need_not_say():
    class Own(base.Feature):
        def measure(self, observation, goal):
            raise NotImplementedError

    class Theirs(schemes.Scheme):
        def compute(self, observation, goal, t):
            raise NotImplementedError

    class Joints(schemes.JointController):
        def process_image(self, observation, goal, t):
            raise NotImplementedError

        def update(self, t, dt, joints):
            raise NotImplementedError

    own, scheme, controller = Own(), Theirs(), Joints()
    assert (own.name, own.units, own.cameras, own.weights, own.camera_count) == (
        "Own",
        (),
        (),
        None,
        1,
    )
    assert own.is_geometric and own.is_stackable and tuple(own.directions) == (True,) * 6
    assert own.reset() is None
    for one in (own, scheme, controller):
        assert one.needs == one.get_needs("") == one.get_needs("left", "") == {Need.MOMENTS}
        assert one.units == () and one.cameras == ()
        assert one.check(None) is None and one.accuracy(None, None) is None
        assert one.teach(None) == {}
    assert scheme.can_check_camera and controller.output == "velocity"
    law = schemes.Proportional(7.0)
    assert Theirs(law).law is law and type(scheme.law) is schemes.Proportional
    law.reset, told = lambda: told.append(law), []
    Theirs(law).reset()
    assert told == [law]
    controller.reset(arm := object())
    assert controller.arm is arm


def test_what_is_measured_and_decided_says_no_more_than_it_is_given():
    one = np.ones(1)
    measured = base.FeatureMeasurement(one, one, one, np.ones((1, 6)))
    decision = schemes.SchemeOutput(("x",), one, one, one)
    for made in (measured, decision):
        assert (made.error_drift, made.ambiguity, made.notes) == (0.0, "", ())
    assert measured.error_summary is decision.task is decision.L is decision.residual is None
    assert decision.filtered_error is None


def test_a_camera_is_the_same_one_to_a_thousandth_of_its_numbers_and_half_a_pixel():
    K = np.array([[2000.0, 0.0, 320.0], [0.0, 1500.0, 200.0], [0.0, 0.0, 1.0]])
    for change, same in (
        (np.diag([2.5, -2.0, 0.0]), True), (np.diag([2.8, 0.0, 0.0]), False),
        (np.diag([0.0, -2.3, 0.0]), False), (np.outer([1, 0, 0], [0, 0, 0.9]), True),
        (np.outer([1, 0, 0], [0, 0, -1.0]), False), (np.outer([0, 1, 0], [0, 0, 0.85]), False),
    ):  # fmt: skip
        lens = CameraModel(640, 480, tuple((K + change).ravel()))
        assert (base.compare_cameras(640, 480, K, lens) == "") is same
        for size in ((641, 480), (640, 479)):
            assert base.compare_cameras(*size, K, lens) == (
                f"{size[0]}x{size[1]} px, fx 2000.00; this camera has 640x480 px, fx "
                f"{lens.K[0]:.2f}"
            )


def test_an_angle_is_the_shortest_turn_to_it():
    turns = np.arange(-9.0, 9.0, 0.37)
    for period in (2.0 * np.pi, np.pi):
        found = base.wrap(turns) if period > 6.0 else base.wrap(turns, period)
        assert np.abs(found).max() <= 0.5 * period
        whole = (turns - found) / period
        np.testing.assert_allclose(whole, np.round(whole), atol=1e-12)
        assert base.wrap(0.5 * period, period) == -0.5 * period


def test_units_of_a_stack_are_those_of_its_parts_also_where_one_says_none():
    class Own(base.Feature):
        names, tolerances, weights = ("u", "v"), (1.0, 2.0), (3.0, 4.0)
        directions = (True, False, False, False, False, False)

        def measure(self, observation, goal):
            raise NotImplementedError

    stack = base.Stack([moment_features.Alpha(), Own(), moment_features.Area()], [1.0, 0.5, 2.0])
    assert stack.names == ("alpha", "u", "v", "area") and stack.units == ("rad", "", "", "")
    assert stack.tolerances == (5e-3, 1.0, 2.0, 1e-4)
    assert stack.weights.tolist() == [1.0, 1.5, 2.0, 2.0]
    assert stack.directions == (True, False, True, False, False, True)
    assert base.Stack(stack.features).weights.tolist() == [1.0, 3.0, 4.0, 1.0]
    with pytest.raises(ConfigurationError, match="a combination of features needs at least one"):
        base.Stack([])


class Unmade(points.Points):
    def __init__(self):
        raise ValueError("no such file")


@pytest.mark.parametrize("name", [f"{__name__}:Unmade", f"points+{__name__}:Unmade"])
def test_a_scheme_of_a_feature_that_cannot_be_made_names_it(name):
    words = f"^scheme '{__name__}:Unmade': its constructor raised ValueError: no such file"
    with pytest.raises(ConfigurationError, match=words):
        create_scheme(name)
