"""Declarations of features and schemes: names, units, tolerances, directions, defaults."""


import numpy as np
import pytest

from aras_visual_servo_camera.undistortion import CameraModel
from aras_visual_servo_controller.errors import ConfigurationError
from aras_visual_servo_controller.features import base, moment_features, points
from aras_visual_servo_controller.observation.observation import Need
from aras_visual_servo_controller.schemes import base as schemes
from aras_visual_servo_controller.schemes import create_scheme


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
    assert (own.name, own.units, own.cameras, own.weights) == ("Own", (), (), None)
    assert own.camera_count == 1
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
