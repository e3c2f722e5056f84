"""Shipped schemes with an exact free camera: each converges as its theory predicts."""

from dataclasses import replace

import numpy as np
import pytest
from feature_scenes import CAMERA, CORNERS, GOAL, look, moved
from free_camera import pose

from aras_visual_servo_controller import CameraModel, FeatureObserver, Goal, MeasurementError
from aras_visual_servo_controller.features.corners import NumberedPoints
from aras_visual_servo_controller.laws import Law, Proportional
from aras_visual_servo_controller.schemes import create_scheme
from aras_visual_servo_controller.schemes.partitioned import Partitioned

START = pose((0.06, -0.05, 0.9), (0.1, -0.12, 0.5))
# Features whose L is that of the geometry converge alike: test_feature_registry has them all.
SOME = ("lines", "translation_camera+theta_u", "moments_six", "partitioned", "predictive")


def taught(scheme, place=GOAL, **options):
    """Return a scheme, which may be named, its observer, and a goal that was shown to it."""
    scheme = create_scheme(scheme, **options) if isinstance(scheme, str) else scheme
    observer = FeatureObserver(None, scheme.needs)
    goal = Goal.teach(scheme, look(observer, place))
    scheme.check(goal)
    return scheme, observer, goal


def fly(name, start=START, images=200, dt=0.04, gain=1.5, **options):
    scheme, observer, goal = taught(name, law=Proportional(gain), **options)
    place, way = start, [start]
    for k in range(images):
        decision = scheme.compute(look(observer, place, dt * k), goal, dt * k)
        assert len(decision.error) == len(scheme.names) == len(scheme.tolerances)
        place = moved(place, dt * decision.task.twist)
        way.append(place)
    return np.array(way), decision


def distance(place):
    return float(np.linalg.norm(place @ np.linalg.inv(GOAL) - np.eye(4)))


@pytest.mark.parametrize(("name", "interaction"), [
    *((name, {}) for name in SOME), ("numbered_points", {"interaction": "desired"}),
    ("numbered_points", {"interaction": "mean"}),
])  # fmt: skip
def test_it_comes_to_its_goal(name, interaction):
    way, _ = fly(name, images=400 if name == "partitioned" else 200, **interaction)
    assert distance(way[-1]) < 5e-3 * distance(way[0])
    if interaction:
        (which,) = interaction.values()
        now, then, began = (fly(name, images=1, interaction=one)[1].L
                            for one in ("current", "desired", which))  # fmt: skip
        expected = then if which == "desired" else (now + then) / 2
        np.testing.assert_allclose(began, expected)


def test_the_laboratorys_gains_are_in_its_own_ratio():
    """140, 120, 60 and 30, on what -L^-1 makes of the error; the target is parallel here."""
    scheme, observer, goal = taught("moments_2016", law=Proportional(1.0))
    near = GOAL.copy()
    near[:3, 3] += 0.02, -0.03, 0.05
    decision = scheme.compute(look(observer, near), goal, 0.0)
    xn, yn = decision.features[:2]
    towards = decision.error + decision.error[3] * np.array([yn, -xn, 0.0, 0.0])
    expected = np.array([140.0, 120.0, 60.0, 30.0]) / 140.0 * towards
    assert decision.task.twist[[0, 1, 2, 5]] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("name", ["moments_2016", "partitioned", "numbered_points"])
def test_each_scheme_tells_its_law_the_time_and_that_since_the_last_image(name):
    scheme, observer, goal = taught(name)
    scheme.law = law = Asked()
    decision = scheme.compute(replace(look(observer, START), dt=0.25), goal, 7.0)
    error, L, rotated, t, dt = law.given
    assert (t, dt) == (7.0, 0.25)
    np.testing.assert_array_equal(error, decision.error)
    np.testing.assert_allclose(L, decision.L * decision.task.modelled, atol=1e-12)
    np.testing.assert_allclose(rotated, np.linalg.pinv(L) @ error, atol=1e-9)


class Gainless(Law):
    def desired_error_rate(self, error, *_):
        return -error


class Asked(Proportional):
    def desired_error_rate(self, *given):
        self.given = given
        return -np.linspace(0.7, 1.3, len(given[0])) * given[0]


def test_schemes_of_what_is_very_small_or_very_far():
    """Partitioned takes the one, and the predictive scheme keeps to its speeds before the other."""
    scheme, observer, _ = taught("partitioned", law=Proportional(1.0))
    at = [pose((0.0, 0.0, z), (0.0, 0.0, 0.0)) for z in (0.6, 0.9)]
    near, far = (look(observer, place, corners=1e-4 * CORNERS) for place in at)
    twist = scheme.compute(far, Goal.teach(scheme, near), 0.0).task.twist
    assert twist[2] == pytest.approx(0.9 * np.log(0.9 / 0.6), rel=1e-6)
    way, _ = fly("predictive", pose((0.3, 0.2, 2.5), (0.1, 0.1, 0.3)), images=20, gain=20.0)
    centres = [np.linalg.inv(place)[:3, 3] for place in way]
    speeds = np.linalg.norm(np.diff(centres, axis=0), axis=1) / 0.04
    assert speeds.max() <= np.sqrt(3) * taught("predictive")[2].distance + 1e-6


@pytest.mark.parametrize("rate", [0.0, 0.3 * np.array([1.0, -2.0, 0.5, 0.2, -1.0, 0.7, 0.1, 0.4])])
def test_partitioned_leaves_to_the_points_what_its_two_motions_do_not_bring(rate):
    """Its law's rate, less the target's own and that of vz and wz, by the other four."""

    class Drifting(NumberedPoints):
        def measure(self, observation, goal):
            return replace(super().measure(observation, goal), error_drift=rate)

    scheme, observer, goal = taught(Partitioned(law := Asked(), Drifting()))
    seen = look(observer, START)
    decision = scheme.compute(seen, goal, 0.0)
    L, error, twist = decision.L, decision.error, decision.task.twist
    wanted = law.desired_error_rate(error)
    hull, first = [], []
    for corners in (seen.corners, np.array(goal.features["numbered_points"]["points"])):
        x, y = corners.T
        hull.append(0.5 * abs(sum(x[i - 1] * y[i] - x[i] * y[i - 1] for i in range(4))))
        first.append(np.angle((corners[1] - corners[0]) @ (1, 1j)))
    gain = -wanted @ error / (error @ error)
    depth = np.mean((CORNERS @ START[:3, :3].T + START[:3, 3])[:, 2])
    assert twist[2] == pytest.approx(gain * depth * 0.5 * np.log(hull[1] / hull[0]), rel=1e-9)
    assert twist[5] == pytest.approx(gain * (first[0] - first[1]), rel=1e-9)
    rest = wanted - rate - L[:, [2, 5]] @ twist[[2, 5]]
    others = [0, 1, 3, 4]
    np.testing.assert_allclose(twist[others], np.linalg.lstsq(L[:, others], rest, rcond=None)[0])
    # at the goal nothing is asked for
    there = Partitioned(law).compute(look(observer, GOAL), goal, 0.0).task.twist
    np.testing.assert_allclose(there, 0.0, atol=1e-12)


def test_the_predictive_scheme_fits_a_decay_at_each_step_of_its_horizon():
    """Where no border is near: the nearest to four exponentials and to no motion at all."""
    scheme, observer, goal = taught("predictive", law=Proportional(0.8))
    seen = look(observer, START)
    decision = scheme.compute(seen, goal, 0.0)
    depths = np.repeat((goal.distance, 1.0), 3)  # lengths count in depths
    L, error = decision.L * depths, decision.error
    stamps = (0.1, 0.2, 0.3, 0.4)
    rows = [*(stamp * L for stamp in stamps), 1e-2 * np.eye(6)]
    wanted = [*((np.exp(-0.8 * stamp) - 1.0) * error for stamp in stamps), np.zeros(6)]
    best = np.linalg.lstsq(np.vstack(rows), np.concatenate(wanted), rcond=None)[0]
    np.testing.assert_allclose(decision.task.twist, depths * best, atol=2e-5)
    expected, found = (create_scheme("predictive", law).compute(seen, goal, 0.0).task.twist
                       for law in (Proportional(1.0), Gainless()))  # fmt: skip
    np.testing.assert_allclose(found, expected, atol=1e-6)  # 1/s, of a law without a gain


@pytest.mark.parametrize("way", [(-1, 0), (1, 0), (0, -1), (0, 1)])
def test_the_predictive_scheme_predicts_points_up_to_its_margin(way):
    """At the middle of each side of a lens's picture, with goals beyond it: 12 pixels are left."""
    lens = CameraModel(CAMERA.width, CAMERA.height, CAMERA.K, (-0.2, 0.05, 0.004, -0.003))
    across = np.array(way)
    begun = pose((*(0.1 * across * (2.0, 1.5)), 0.9), (0.0, 0.0, 0.3))
    beyond = pose((*(0.6 * across), 0.9), (0.0, 0.0, 0.3))
    scheme, observer, goal = taught("predictive", beyond, law=Proportional(5.0))
    decision = scheme.compute(replace(look(observer, begun), camera=lens), goal, 0.0)
    ahead = decision.features + scheme.horizon * decision.L @ decision.task.twist
    middle = 0.5 * (np.array([lens.width, lens.height]) - 1)
    edge = np.ravel(lens.normalise(*(middle + across * (middle - scheme.margin))[:, None])[:2])
    assert (ahead.reshape(-1, 2) @ across).max() == pytest.approx(edge @ across, abs=1e-5)


@pytest.mark.parametrize("name", ["numbered_points", "partitioned", "predictive", "pose", "lines"])
def test_each_scheme_says_what_a_square_leaves_open(name):
    scheme = create_scheme(name)
    square = 0.1 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    observer = FeatureObserver(None, scheme.needs)
    goal = Goal.teach(scheme, look(observer, GOAL, corners=square))
    seen = replace(look(observer, START, corners=square), is_numbered=False)
    assert scheme.compute(seen, goal, 0.0).ambiguity == "90°"
    measure = scheme.feature.measure  # a feature's own word, as of a user's
    scheme.feature.measure = lambda *given: replace(measure(*given), notes=("blurred",))
    assert scheme.compute(seen, goal, 0.0).notes == ("blurred",)


def test_the_error_is_smoothed_over_the_time_that_passed_and_begins_anew_after_a_gap():
    """An image of the same time as the last one brings nothing new."""
    scheme, observer, goal = taught("numbered_points", smoothing=0.2)
    further, smoothed = moved(START, np.array([0.1, -0.2, 0.1, 0.0, 0.1, 0.2])), None
    for place, stamp, passed in (
        (START, 0.0, np.inf), (further, 0.3, 0.3), (START, 0.3, 0.0), (START, 0.425, 0.125),
        (further, 0.75, np.inf), (START, 0.625, np.inf),
    ):  # fmt: skip
        found = scheme.compute(look(observer, place, stamp), goal, stamp)
        new = 1.0 - np.exp(-passed / 0.2)
        smoothed = found.error if new == 1.0 else smoothed + new * (found.error - smoothed)
        np.testing.assert_allclose(found.filtered_error, smoothed, atol=1e-12)


def test_the_predictive_scheme_does_nothing_of_which_the_points_tell_nothing():
    """Three on a line see no turn about it."""
    scheme = create_scheme("predictive")
    line = np.array([[-0.1, 0.0, 0.0, 1.0], [0.02, 0.0, 0.0, 1.0], [0.1, 0.0, 0.0, 1.0]])

    def seen(place):
        P = line @ place[:3].T
        view = look(FeatureObserver(None, scheme.needs), place)
        return replace(view, corners=P[:, :2] / P[:, 2:])

    goal = Goal.teach(scheme, seen(GOAL))
    other = create_scheme("partitioned")
    for one in (scheme, other):
        one.check(goal)
    with pytest.raises(MeasurementError, match="on one line, so that its area is zero"):
        other.compute(seen(START), goal, 0.0)
    decision = scheme.compute(seen(START), goal, 0.0)
    depths = np.repeat((goal.distance, 1.0), 3)
    blind = np.linalg.svd(decision.L * depths)[2][5]
    assert np.abs(decision.L @ (depths * blind)).max() < 1e-9
    assert blind @ (decision.task.twist / depths) == pytest.approx(0.0, abs=1e-6)
