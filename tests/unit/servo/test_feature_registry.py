"""s, L and e of every registered feature on an exact camera, compared with values from geometry,
with the finite differences of those values, and with their difference on the circle."""

from dataclasses import replace

import numpy as np
import pytest
from feature_scenes import CAMERA, CORNERS, GOAL, PERIODS, TARGETS, VALUES, VIEWS, look, moved

from aras_visual_servo_controller import CameraModel, FeatureObserver, Goal, Need
from aras_visual_servo_controller.errors import ConfigurationError, MeasurementError
from aras_visual_servo_controller.features import FEATURES, Feature, base, moment_features, points
from aras_visual_servo_controller.laws.pi import ProportionalIntegral
from aras_visual_servo_controller.schemes import FeatureScheme, create_scheme
from aras_visual_servo_controller.schemes import base as schemes

STEP = 1e-6
# They model a camera that looks square on, or pixels: test_features and, for every feature that
# needs pictures, test_luminance hold them to account; for invariants, features/test_features and
# test_interaction_check.
ELSEWHERE = {"kernel", "moments", "invariants"}
PICTURED = {name for name, feature in FEATURES.items() if Need.IMAGE in feature.needs}
OF_SEVERAL = {name for name, feature in FEATURES.items() if feature.camera_count > 1}  # test_rig
NAMES = sorted(set(FEATURES) - ELSEWHERE - PICTURED - OF_SEVERAL)
# The corners of an outline are matched by their turn, which beyond a quarter is ambiguous.
SEEN = [(name, i) for name in NAMES for i in range(len(VIEWS)) if (name, i) != ("points", 2)]


def shown(name, feature, place):
    return look(FeatureObserver(None, feature.needs), place, corners=TARGETS.get(name, CORNERS))


def at_goal(name, place=GOAL):
    feature = FEATURES.create(name)
    goal = Goal.teach(FeatureScheme(feature), shown(name, feature, place))
    feature.check(goal)
    return feature, goal


def wrapped(difference, name):
    periods = np.array(PERIODS.get(name, [0] * len(difference)), float)
    turn = np.where(periods > 0, periods, np.inf)
    return np.where(periods > 0, difference - np.round(difference / turn) * periods, difference)


@pytest.mark.parametrize(("name", "view"), SEEN)
def test_s_its_rate_and_the_error_are_those_of_the_geometry(name, view):
    assert set(NAMES) == set(VALUES)
    feature, goal = at_goal(name)
    place, value = VIEWS[view], VALUES[name]
    found = feature.measure(shown(name, feature, place), goal)
    assert wrapped(found.s - value(place), name) == pytest.approx(0.0, abs=1e-9)
    rows = np.array([
        wrapped(value(moved(place, STEP * v)) - value(moved(place, -STEP * v)), name) / (2 * STEP)
        for v in np.eye(6)
    ]).T  # fmt: skip
    assert pytest.approx(rows, abs=2e-8 * max(1.0, np.abs(rows).max())) == found.L
    assert len(feature.names) == len(feature.tolerances) == len(feature.units) == len(found.s)
    assert wrapped(found.desired - value(GOAL), name) == pytest.approx(0.0, abs=1e-9)
    expected = wrapped(value(place) - value(GOAL), name)
    # Near half a turn all angles are taken on one side.
    assert wrapped(found.error - expected, name) == pytest.approx(0.0, abs=1e-9)


TURNING = ("alpha", "moments_six", "moments_pitch", "polar_points", "lines", "segments", "theta_u")


@pytest.mark.parametrize("name", TURNING)
def test_a_turn_goes_the_short_way_over_the_end_of_the_circle(name):
    """No angle's error is more than half a turn, and a small turn is a small error, wherever the
    angles of goal and view happen to lie."""
    for turn in np.radians(np.arange(0.0, 360.0, 20.0)):
        about_goal = moved(GOAL, np.array([0, 0, 0, 0, 0, turn]))
        feature, goal = at_goal(name, about_goal)
        for further, most in ((0.2, 0.35), (2.6, np.pi), (-2.6, np.pi)):
            on = moved(about_goal, np.array([0, 0, 0, 0, 0, further]))
            found = feature.measure(shown(name, feature, on), goal)
            assert np.abs(found.error).max() < most


@pytest.mark.parametrize("name", NAMES)
def test_nothing_is_left_to_do_at_the_goal(name):
    """And tolerances are between a tenth of a millimetre and what one sees at a glance, by how far
    the camera moves, m or rad, until the number is off by its tolerance."""
    feature, goal = at_goal(name)
    found = feature.measure(shown(name, feature, GOAL), goal)
    assert found.error == pytest.approx(0.0, abs=1e-9)
    assert feature.desired_interaction(goal) == pytest.approx(found.L, abs=1e-9)
    reach = np.array(feature.tolerances) / np.abs(found.L).max(axis=1)
    assert reach.min() > 1e-4 and reach.max() < 0.2
    nothing = FeatureObserver(None, feature.needs).observe_exact_features(0.0, CAMERA)
    with pytest.raises(MeasurementError) as told:
        feature.measure(nothing, goal)
    assert "finite" not in str(told.value)


def test_vanishing_points_may_lie_along_either_side_of_the_picture():
    """Of a rectangle that is seen square on, or turned about one side."""
    feature, goal = at_goal("vanishing_points")
    rectangle = np.array([[-0.1, -0.05, 0], [0.1, -0.05, 0], [0.1, 0.05, 0], [-0.1, 0.05, 0.0]])
    observer = FeatureObserver(None, feature.needs)
    for turn in (np.zeros(6), 0.3 * np.eye(6)[3], 0.3 * np.eye(6)[4]):
        place = moved(np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0.7], [0, 0, 0, 1]]), turn)
        found = feature.measure(look(observer, place, corners=rectangle), goal).s.reshape(2, 2)
        expected = [(d[2] / np.hypot(*d[:2]), np.arctan2(d[1], d[0])) for d in place[:3, :2].T]
        np.testing.assert_allclose(found, expected, atol=1e-9)
    triangle = look(observer, GOAL, corners=rectangle[:3])
    with pytest.raises(ConfigurationError, match="four corners"):
        feature.check(Goal.teach(FeatureScheme(feature), triangle))


@pytest.mark.parametrize("along", [(0.0, 0.9, 1.3, 0.4), (0.0, 1.0, 2.1, 0.7), (0.0,) * 4])
def test_vanishing_points_refuse_a_target_seen_edge_on(along):
    """Its sides lie on one line of the image then, which meets itself anywhere."""
    feature, goal = at_goal("vanishing_points")
    seen = shown("vanishing_points", feature, VIEWS[0])
    line = np.array([[-0.137, 0.051]]) + np.outer(along, [0.213, 0.067])
    with pytest.raises(MeasurementError, match="no vanishing point"):
        feature.measure(replace(seen, corners=line), goal)


def test_a_feature_that_knows_no_desired_l_names_the_remedy():
    class Own(Feature):
        names, tolerances, units = ("x",), (1.0,), ("",)

        def measure(self, observation, goal):
            raise NotImplementedError

    with pytest.raises(ConfigurationError, match="Own has no interaction.*interaction 'current'"):
        Own().desired_interaction(Goal(depth=0.2))
    for interaction in ("desired", "mean"):  # before anything moves
        with pytest.raises(ConfigurationError, match="Own has no interaction"):
            FeatureScheme(Own(), interaction=interaction).check(Goal(depth=0.2))
    FeatureScheme(Own()).check(Goal(depth=0.2))


# -- declarations of features and schemes -------------------------------------------------------
def test_what_a_user_s_own_need_not_say():
    class Own(base.Feature):
        def measure(self, observation, goal):
            raise NotImplementedError

    class Theirs(schemes.Scheme):
        def compute(self, observation, goal, t):
            raise NotImplementedError

    class Joints(schemes.JointController):
        process_image = update = None

    own, scheme, controller = Own(), Theirs(), Joints()
    assert (own.name, own.cameras, own.weights, own.camera_count) == ("Own", (), None, 1)
    assert own.is_geometric and own.is_stackable and tuple(own.directions) == (True,) * 6
    for one in (own, scheme, controller):
        assert one.needs == one.get_needs("") == one.get_needs("left", "") == {Need.MOMENTS}
        assert one.units == one.cameras == () and one.teach(None) == {}
        assert one.check(None) is None and one.accuracy(None, None) is None
    assert scheme.can_check_camera and controller.output == "velocity"
    law = ProportionalIntegral(7.0)
    assert Theirs(law).law is law and type(scheme.law) is schemes.Proportional
    error, L, still = np.ones(1), np.eye(1, 6), np.zeros(6)
    first, second = (law.desired_error_rate(error, L, still, t, 0.5) for t in (0.0, 0.5))
    Theirs(law).reset()
    assert law.desired_error_rate(error, L, still, 0.0, 0.5) == first != second
    controller.reset(arm := object())
    assert controller.arm is arm
    one = np.ones(1)
    measured = base.FeatureMeasurement(one, one, one, np.ones((1, 6)))
    decision = schemes.SchemeOutput(("x",), one, one, one)
    for made in (measured, decision):
        assert (made.error_drift, made.ambiguity, made.notes) == (0.0, "", ())
    assert measured.error_summary is decision.task is decision.L is decision.residual is None
    assert decision.filtered_error is None


def test_a_camera_is_the_same_one_to_a_thousandth_of_its_numbers_and_half_a_pixel():
    K = np.array([[2000.0, 0.0, 320.0], [0.0, 1500.0, 200.0], [0.0, 0.0, 1.0]])
    for (fx, fy, cx, cy), same in (
        ((2.5, -2.0, 0, 0), True), ((2.8, 0, 0, 0), False), ((0, -2.3, 0, 0), False),
        ((0, 0, 0.9, 0), True), ((0, 0, -1.0, 0), False), ((0, 0, 0, 0.85), False),
    ):  # fmt: skip
        lens = CameraModel(640, 480, tuple((K + [[fx, 0, cx], [0, fy, cy], [0, 0, 0]]).ravel()))
        assert (base.compare_cameras(640, 480, K, lens) == "") is same
        for width, height in ((641, 480), (640, 479)):
            assert base.compare_cameras(width, height, K, lens) == (
                f"{width}x{height} px, fx 2000.00; this camera has 640x480 px, fx {2000 + fx:.2f}")


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
