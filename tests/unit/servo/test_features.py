"""Moments and points, compared with a moving camera; kernel features on a fine image."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from feature_scenes import moved
from free_camera import pose

from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.kernel import DELTA_X, DELTA_Y, compute_outline_kernel_features
from aras_visual_servo_controller import CameraModel, Goal, Moments, Need, RemoteCameraFeature
from aras_visual_servo_controller.errors import ConfigurationError, MeasurementError, SchemeError
from aras_visual_servo_controller.features import FEATURES, Feature, FeatureMeasurement, Stack
from aras_visual_servo_controller.features.base import wrap
from aras_visual_servo_controller.features.moments import compute_displacement_moments
from aras_visual_servo_controller.features.points import PointFeature, compute_inverse_depth
from aras_visual_servo_controller.laws import Proportional
from aras_visual_servo_controller.observation.feature_observer import FeatureObserver
from aras_visual_servo_controller.schemes import FeatureScheme, create_scheme

CAMERA = CameraModel(320, 240, (200.0, 0, 158.3, 0, 201.0, 121.6, 0, 0, 1))
# A square with a patch that gives it a direction, m.
OUTLINE = np.array(
    [[-25, -25], [25, -25], [25, -7.5], [37.5, -7.5], [37.5, 17.5], [25, 17.5], [25, 25], [-25, 25]]
) / 1000.0  # fmt: skip
SMALL = CameraModel(320, 240, (102.7, 0, 159.5, 0, 102.7, 119.5, 0, 0, 1))
SQUARE = 0.03 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float)
GOAL = pose((0.004, -0.003, 0.2), np.radians((2.0, -3.0, 5.0)))
VIEWS = {
    "near": pose((0.01, 0.02, 0.23), np.radians((6.0, 4.0, 20.0))),
    "tilted": pose((-0.05, 0.03, 0.35), np.radians((-25.0, 15.0, -60.0))),
    "turned": pose((0.02, -0.01, 0.18), np.radians((3.0, -5.0, 150.0))),
}


def seen_from(camera_T_object, shape=OUTLINE):
    P = np.c_[shape, np.zeros(len(shape))] @ camera_T_object[:3, :3].T + camera_T_object[:3, 3]
    return P[:, :2] / P[:, 2:]


def look(needs, camera_T_object, shape=OUTLINE, stamp=0.0, plane=True, observer=None):
    known = Plane.from_pose(camera_T_object[:3, :3], camera_T_object[:3, 3]) if plane else None
    return (observer or FeatureObserver(None, needs)).observe_exact_features(
        stamp, CAMERA, contour=seen_from(camera_T_object, shape), plane=known,
        world_T_camera=np.linalg.inv(camera_T_object))  # fmt: skip


def taught(feature, shape=OUTLINE, view=GOAL, **options):
    return Goal.teach(FeatureScheme(feature), look(feature.needs, view, shape, **options))


def dense(shape, parts=12):
    """The outline (n * parts, 2) of a polygon with points along its sides."""
    along = np.linspace(0.0, 1.0, parts, endpoint=False)[:, None, None]
    return (shape + along * (np.roll(shape, -1, axis=0) - shape)).swapaxes(0, 1).reshape(-1, 2)


@pytest.mark.parametrize("name", ["points", "numbered_points"])
@pytest.mark.parametrize("count", [7, 10])
def test_corners_that_become_more_or_fewer_are_looked_for_where_the_goals_are(name, count):
    feature = FEATURES.create(name)
    goal = taught(feature)
    feature.check(goal)
    wanted = feature.measure(look(feature.needs, VIEWS["near"]), goal)
    seen = look(feature.needs, VIEWS["near"], dense(OUTLINE))
    some = seen.contour[:: len(seen.contour) // count][:count]
    found = feature.measure(replace(seen, corners=some, is_numbered=False), goal)
    np.testing.assert_allclose(found.error, wanted.error, atol=1e-6)
    with pytest.raises(MeasurementError, match=f"{count} points are visible, but the goal has 8$"):
        feature.measure(replace(seen, corners=some, contour=None), goal)


def test_at_the_goal_the_error_is_none_and_L_the_desired_one():
    feature = FEATURES.create("moments")
    goal, scheme = taught(feature), FeatureScheme(feature)
    scheme.check(goal)
    lengths = goal.distance * np.array([0.0025, 0.0025, 0.005])
    assert scheme.tolerances == pytest.approx([*lengths, 0.005])
    measured = feature.measure(look(feature.needs, GOAL), goal)
    np.testing.assert_allclose(measured.error, 0.0, atol=1e-12)
    np.testing.assert_allclose(measured.L, feature.desired_interaction(goal), atol=1e-9)
    measured = feature.measure(look(feature.needs, VIEWS["near"]), goal)
    np.testing.assert_allclose(measured.error, measured.s - measured.desired, atol=1e-15)
    assert len(feature.names) == len(feature.units) == len(measured.L)


@pytest.mark.parametrize("turn", [-170.0, 89.0, 91.0])
def test_moments_know_the_whole_turn_of_a_target_with_a_direction(turn):
    feature = FEATURES.create("moments")
    upright = pose((0, 0, 0.2), (0, 0, 0))
    goal = taught(feature, view=upright)
    seen = look(feature.needs, pose((0, 0, 0.2), (0, 0, np.radians(turn))))
    measured = feature.measure(seen, goal)
    assert measured.error[3] == pytest.approx(np.radians(turn), abs=1e-6)
    assert measured.ambiguity == ""
    for order, count in ((4, 15), (3, 10)):  # the least that tells it, and one less
        m, mu = seen.moments.m_array[:count], seen.moments.mu_array[:count]
        lower = Moments.from_arrays(m, mu, order, seen.moments.kind)
        found = feature.measure(replace(seen, moments=lower), goal)
        half = 0.5 * wrap(2.0 * np.radians(turn))
        assert found.error[3] == pytest.approx(half if order < 4 else np.radians(turn), abs=1e-6)


@pytest.mark.parametrize(("begin", "end", "error"), [(0.0, 170.0, -10.0), (80.0, 100.0, 20.0)])
def test_moments_say_that_half_a_turn_of_a_symmetric_target_stays_open(begin, end, error):
    feature, rectangle = FEATURES.create("moments"), SQUARE * [1.0, 0.6]
    upright, turned = (pose((0, 0, 0.2), (0, 0, np.radians(turn))) for turn in (begin, end))
    goal = taught(feature, rectangle, upright)
    measured = feature.measure(look(feature.needs, turned, rectangle), goal)
    assert measured.error[3] == pytest.approx(np.radians(error), abs=1e-9)
    assert measured.ambiguity == "180°"


class Moving(Feature):
    names, tolerances, needs = ("x", "y"), (1.0, 1.0), frozenset()

    def measure(self, observation, goal):
        L = np.eye(6)[:2]
        return FeatureMeasurement(
            np.ones(2), np.zeros(2), np.ones(2), L, error_drift=np.array([0.3, -0.1]))


def test_the_motion_of_the_target_is_fed_forward():
    nothing = look(frozenset(), GOAL)
    decision = FeatureScheme(Moving(), Proportional(2.0)).compute(nothing, Goal(), 0.0)
    np.testing.assert_allclose(decision.task.desired_rate, [-2.0 - 0.3, -2.0 + 0.1])
    np.testing.assert_allclose(decision.error_drift, [0.3, -0.1])
    assert decision.residual is None
    found = Stack([Moving(), Moving()]).measure(nothing, Goal())
    np.testing.assert_allclose(found.error_drift, [0.3, -0.1, 0.3, -0.1])
    judged = FeatureScheme(Photo()).compute(nothing, Goal(), 0.0)
    np.testing.assert_array_equal(judged.residual, 2.0 * np.ones(6))
    assert (judged.error, judged.features, judged.desired, judged.error_drift) == (1, 1, 0, 0)


class Tall(Feature):
    needs = frozenset()

    def __init__(self, L):
        self.L = np.asarray(L, float)
        self.names = tuple(f"s{i}" for i in range(len(self.L)))
        self.tolerances = (1.0,) * len(self.L)

    def measure(self, observation, goal):
        e = np.sin(np.arange(float(len(self.L))))
        return FeatureMeasurement(e, np.zeros_like(e), e, self.L)


class Told(Proportional):
    def desired_error_rate(self, error, L, rotated, t, dt):
        self.rotated = rotated
        return -error


@pytest.mark.parametrize(("count", "weighted"), [
    (3, True), (6, False), (64, True), (65, False), (200, True),
])  # fmt: skip
def test_the_law_is_told_what_the_error_is_as_a_motion_of_the_camera(count, weighted):
    """In the directions that the feature models; of one that is hardly seen too."""
    random, law = np.random.default_rng(count), Told()
    directions = np.array((1, 1, 0, 1, 1, 1), bool)
    feature, W = Tall(random.normal(size=(count, 6))), np.eye(count)
    feature.directions = directions
    if weighted:
        feature.weights = random.uniform(0.5, 2.0, count)
        W = np.diag(feature.weights)
    error = np.sin(np.arange(float(count)))
    for least in (1.0, 1e-6) if 6 <= count <= 64 else (1.0,):  # its square is 1e-12
        feature.L = feature.L * (1, 1, 1, 1, 1, least)
        FeatureScheme(feature, law).compute(look(frozenset(), GOAL), Goal(), 0.0)
        depths = np.repeat((Goal().distance, 1.0), 3)  # lengths count in depths
        expected = depths * (np.linalg.pinv(W @ feature.L * directions * depths) @ W @ error)
        np.testing.assert_allclose(law.rotated, expected, rtol=1e-6, atol=1e-5)


def test_of_an_l_that_is_none_the_law_is_not_asked():
    feature, law = Tall(np.eye(6)[:4]), Told()
    measured = feature.measure(None, None)
    for L in (np.where(np.eye(4, 6, 1) > 0.0, np.nan, 1.0), np.ones((3, 6))):
        feature.measure = lambda *_, L=L: replace(measured, L=L)
        with pytest.raises(SchemeError, match=r"Tall.measure returned L .*of shape \(4, 6\)"):
            FeatureScheme(feature, law).compute(look(frozenset(), GOAL), Goal(), 0.0)
        assert not hasattr(law, "rotated")


@pytest.mark.parametrize(("jump", "anew"), [
    ((0.99, -0.99), False), ((0.01, 1.0), True), ((-1.0, 0.0), True), ((0.0, -1.2), True),
])  # fmt: skip
def test_what_no_camera_makes_is_not_smoothed(jump, anew):
    """Of one of two errors, up or down: an angle that wrapped."""
    feature = Tall(np.eye(6)[:2])
    scheme = FeatureScheme(feature, Proportional(1.0), smoothing=0.5)
    first = np.array([0.3, -0.2])
    for stamp, error in ((1.0, first), (1.1, first + jump)):
        feature.measure = lambda *_, e=error: FeatureMeasurement(e, np.zeros(2), e, feature.L)
        found = scheme.compute(look(frozenset(), GOAL, stamp=stamp), Goal(), stamp)
    new = 1.0 if anew else 1.0 - np.exp(-0.2)
    np.testing.assert_allclose(found.filtered_error, first + new * np.array(jump))
    np.testing.assert_allclose(found.task.desired_rate, -found.filtered_error)
    np.testing.assert_allclose(found.error, first + jump)
    scheme.reset()
    found = scheme.compute(look(frozenset(), GOAL, stamp=1.2), Goal(), 1.2)
    np.testing.assert_array_equal(found.filtered_error, found.error)


def test_moments_of_too_low_an_order_are_refused():
    feature = FEATURES.create("sx_sy")
    view, goal = look(feature.needs, GOAL), taught(feature)
    values, central = view.moments.m_array[:6], view.moments.mu_array[:6]
    low = Moments.from_arrays(values, central, 2, view.moments.kind)
    with pytest.raises(MeasurementError, match="Sx, Sy need moments up to order 4"):
        feature.measure(replace(view, moments=low), goal)
    moments, square = FEATURES.create("moments"), pose((0, 0, 0.2), (0, 0, 0))
    for one, wrong, words in (
        (feature, replace(goal, moments=low), r"^goal: .*Sx, Sy need moments up to order 4"),
        (feature, replace(goal, moments=None), "^goal holds no moments: teach it again"),
        (moments, taught(moments, SQUARE, square), "alpha is undefined"),
    ):
        with pytest.raises(ConfigurationError, match=words):
            one.check(wrong)


def test_a_camera_that_looks_along_the_plane_by_kinematics_is_refused():
    """The target's middle is seen where it is square on; the joints say something else."""
    feature, upright = FEATURES.create("moments"), pose((0, 0, 0.2), (0, 0, 0))
    goal, seen = taught(feature, view=upright), look(feature.needs, upright, plane=False)
    x = seen.moments.xg

    def measure(sine):
        lean = np.arccos(sine / np.hypot(x, 1.0)) + np.arctan2(x, 1.0)
        there = goal.world_T_camera @ pose((0, 0, 0), (0, -lean, 0))
        return feature.measure(replace(seen, world_T_camera=there), goal)

    assert np.isfinite(measure(0.051).L).all()
    with pytest.raises(MeasurementError, match="the target's plane edge-on or from behind"):
        measure(0.049)


def test_a_square_is_followed_corner_by_corner():
    feature, found = FEATURES.create("points"), []
    goal = taught(feature, SQUARE, pose((0, 0, 0.2), (0, 0, 0)))
    turns = np.radians([0, 30, 60, 90, 120, 95, 60, 25, -15])
    for turn in turns:
        turned = look(feature.needs, pose((0, 0, 0.2), (0, 0, turn)), SQUARE)
        measured = feature.measure(turned, goal)
        s, g = (v[::2] + 1j * v[1::2] for v in (measured.s, measured.desired))
        found.append(np.angle(np.vdot(g, s)))
        assert measured.ambiguity == "90°"
    np.testing.assert_allclose(found, turns, atol=1e-9)


@pytest.mark.parametrize("size", [0.1, 10.0])
@pytest.mark.parametrize(("shape", "open_"), [
    (SQUARE, "90°"), (SQUARE * (1.5, 1.0), "180°"), (np.vstack([SQUARE[:3], [[-0.05, 0.0]]]), ""),
])  # fmt: skip
def test_what_stays_open_does_not_depend_on_how_large_the_target_is_seen(shape, open_, size):
    feature = FEATURES.create("points")
    goal = taught(feature, shape, pose((0, 0, 0.2), (0, 0, 0)))
    seen = look(feature.needs, pose((0, 0, 0.2), (0, 0, 0.3)), shape)
    found = feature.measure(replace(seen, corners=size * seen.corners, is_numbered=False), goal)
    assert found.ambiguity == open_
    np.testing.assert_array_equal(found.s, size * seen.corners.ravel())
    for at, there in ((0.0, 0.3), (0.3, 0.0)):  # nor on how far aside
        goal = taught(feature, shape, pose((at, 0, 0.2), (0, 0, 0)))
        seen = look(feature.needs, pose((there, -0.2, 0.2), (0, 0, 0.2)), shape)
        assert open_ != "180°" or feature.measure(seen, goal).ambiguity == open_


@pytest.mark.parametrize("name", ["points", "segments", "pose"])
def test_accuracy_of_corners_goes_through_the_feature(name):
    """Each column is what the feature makes of one corner coordinate that is off."""
    feature = FEATURES.create(name)
    tilted = pose((0.01, -0.02, 0.2), (0.1, -0.2, 0.3))
    goal = replace(taught(feature, SQUARE, tilted), camera=None)
    feature.check(goal)
    view = look(feature.needs, tilted, SQUARE)
    assert feature.accuracy(view, goal) is None  # exact
    size = 1e-5
    found = feature.accuracy(replace(view, corner_accuracy=size), goal)
    corners = feature.read_desired_points(goal)
    for k in range(corners.size):
        off = np.zeros(corners.size)
        off[k] = size
        seen = replace(view, corners=corners + off.reshape(-1, 2))
        np.testing.assert_allclose(
            found[:, k], feature.measure(seen, goal).error, atol=2e-3 * np.abs(found).max())
    beside = Stack([Moving(), feature]).accuracy(replace(view, corner_accuracy=size), goal)
    np.testing.assert_array_equal(beside, np.vstack([np.zeros((2, corners.size)), found]))


@pytest.mark.parametrize("name", ["moments", "moments_six"])
def test_accuracy_of_moments_is_that_of_the_outline(name):
    """An outline that is wider all round by d: what the first column says."""
    feature = FEATURES.create(name)
    goal = replace(taught(feature), camera=None)
    feature.check(goal)
    view = look(feature.needs, GOAL, dense(OUTLINE))
    assert feature.accuracy(view, goal) is None
    found = feature.accuracy(replace(view, pixel_count=900), goal)
    assert found.shape == (len(feature.names), 9)
    wider, d = goal.compute_outline(), 0.0075 / 30.0 / view.camera.K[0]
    area = goal.moments.m00
    length = np.linalg.norm(wider - np.roll(wider, -1, axis=0), axis=1).sum()
    # Z sqrt(a* / a) of an area that has grown by its outline's length times d
    at_an = list(feature.names).index("an")
    assert found[at_an, 0] == pytest.approx(-0.5 * goal.depth * length * d / area, rel=0.02)
    assert np.abs(found[0, 1]) > 5.0 * np.abs(found[0, 2])  # cos phi moves it along x


@pytest.mark.parametrize("shape", [SQUARE * (1.6, 1.0), OUTLINE], ids=["half a turn", "directed"])
def test_accuracy_of_alpha_is_the_same_whichever_way_the_target_lies(shape):
    feature, sizes = FEATURES.create("moments"), []
    begin = FEATURES.create("alpha")
    upright = taught(begin, shape, pose((0, 0, 0.2), (0, 0, 0)))
    own = begin.measure(look(begin.needs, pose((0, 0, 0.2), (0, 0, 0)), shape), upright).s[0]
    for turn in (0.4, 0.5 * np.pi, -0.5 * np.pi, np.pi, 2.0):
        place = pose((0, 0, 0.2), (0, 0, turn - own))
        goal = replace(taught(feature, shape, place), camera=None)
        view = replace(look(feature.needs, place, dense(shape)), pixel_count=900)
        sizes.append(np.linalg.norm(feature.accuracy(view, goal)[3]))
    np.testing.assert_allclose(sizes, sizes[0], rtol=1e-3)


def raw_moments(outline, order):
    """(order + 1, order + 1) of a polygon (n, 2), by Green's theorem and Gauss's nodes."""
    nodes, weights = np.polynomial.legendre.leggauss(order + 2)
    ends = np.roll(outline, -1, axis=0)
    part = 0.5 * (nodes[:, None, None] + 1.0)
    x, y = np.moveaxis(outline + part * (ends - outline), 2, 0)
    dy = 0.5 * weights[:, None] * (ends - outline)[:, 1]
    return np.array([[(x ** (i + 1) / (i + 1) * y**j * dy).sum() for j in range(order + 1)]
                     for i in range(order + 1)])  # fmt: skip


def test_what_an_outline_gains_where_it_is_displaced_by_waves():
    t = np.linspace(0.0, 2.0 * np.pi, 1200, endpoint=False)
    outline = np.column_stack([0.2 + 0.09 * np.cos(t), -0.1 + 0.05 * np.sin(t + 0.4)])
    found = compute_displacement_moments(outline[::40], 3)  # of 30 sides
    ahead = np.roll(outline, -1, axis=0) - np.roll(outline, 1, axis=0)
    outward = np.column_stack([ahead[:, 1], -ahead[:, 0]])
    outward /= np.linalg.norm(outward, axis=1)[:, None]
    x, y = (outline - outline.mean(axis=0)).T
    phi = np.arctan2(y, x)
    waves = [np.ones(1200), *(f(m * phi) for m in range(1, 5) for f in (np.cos, np.sin))]
    for wave, gained in zip(waves, found, strict=True):
        sides = [raw_moments(outline + d * wave[:, None] * outward, 3) for d in (1e-5, -1e-5)]
        expected = (sides[0] - sides[1]) / 2e-5
        np.testing.assert_allclose(gained, expected, atol=2e-3 * np.abs(found[0]).max())


@pytest.mark.parametrize("count", [3, 5, 8])
def test_corners_of_any_polygon_are_matched_whichever_way_round_they_are_found(count):
    random, feature = np.random.default_rng(count), FEATURES.create("points")
    about = 2.0 * np.pi * (np.arange(count) + random.uniform(-0.3, 0.3, count)) / count
    shape = 0.05 * random.uniform(0.6, 1.4, (count, 1)) * np.c_[np.cos(about), np.sin(about)]
    for begun in (shape, shape[::-1]):
        goal = taught(feature, begun, pose((0.01, 0.02, 0.3), (0, 0, 0.3)))
        seen = look(feature.needs, VIEWS["near"], begun)
        for way in (1, -1):
            feature.reset()
            corners = np.roll(seen.corners, 2, axis=0)[::way]
            found = feature.measure(replace(seen, corners=corners, is_numbered=False), goal)
            np.testing.assert_array_equal(found.s, seen.corners.ravel())


def test_points_that_are_not_finite_are_refused():
    feature = FEATURES.create("points")
    goal = taught(feature, SQUARE)
    points = [[0.1, 0.1], [0.1, float("nan")], [-0.1, -0.1], [0.2, 0.0]]
    with pytest.raises(ConfigurationError, match="a point is not finite"):
        feature.check(replace(goal, features={"points": {"points": points}}))
    spots = Goal(depth=0.2, features={"spots": {"points": [[0, 0], [1, 0], [1, 1]]}})
    with pytest.raises(MeasurementError, match="not finite"):
        TwoSpots().measure(look(frozenset(), GOAL), spots)
    # those on one line turn neither way round
    line = np.array([[-0.1, 0.0], [0.02, 0.0], [0.1, 0.0], [0.16, 0.0]])
    goal = replace(goal, features={"points": {"points": line}})
    seen = replace(look(feature.needs, GOAL, SQUARE), corners=line + 0.01, is_numbered=False)
    np.testing.assert_allclose(feature.measure(seen, goal).error, 0.01)


def test_a_ratio_is_a_number_above_0_for_each_feature():
    feature, seen = FEATURES.create("moments"), look(FEATURES["moments"].needs, VIEWS["near"])
    for ratio in ((1.0, 1.0, 1.0), (1.0, 0.0, 1.0, 1.0), (1.0, -1.0, 1.0, 1.0)):
        with pytest.raises(ConfigurationError, match="one number above 0 for each of xn, yn"):
            FeatureScheme(feature, ratio=ratio)
    ratio = (1.0, 0.5, 1e-3, 7.0)
    plain, scaled = (FeatureScheme(feature, Proportional(0.8), ratio=one).compute(
        seen, taught(feature), 0.0).task.desired_rate for one in (None, ratio))  # fmt: skip
    np.testing.assert_allclose(scaled, plain * ratio, rtol=1e-12)


TILTED = pose((0.012, -0.02, 0.3), (0.25, -0.3, 0.4))


def depth_image(camera_T_object, mask=True):
    """(240, 320) m of the object's plane; the ground 5 cm behind where it is not `mask`."""
    u, v = np.meshgrid(np.arange(320), np.arange(240))
    x, y, _ = CAMERA.normalise(u.ravel(), v.ravel())
    plane = Plane.from_pose(camera_T_object[:3, :3], camera_T_object[:3, 3])
    depth = 1.0 / (plane.A * x + plane.B * y + plane.C).reshape(240, 320)
    return np.where(mask, depth, depth + 0.05).astype(np.float32)


@pytest.mark.parametrize("name", ["points", "numbered_points", "points_3d", "lines"])
def test_the_plane_is_that_of_goal_and_kinematics(name):
    feature = FEATURES.create(name)
    goal = taught(feature)
    feature.check(goal)
    observer = FeatureObserver(None, feature.needs, compute_plane=goal.compute_plane)
    known = look(feature.needs, TILTED)
    found = look(feature.needs, TILTED, plane=False, observer=observer)
    np.testing.assert_allclose(found.plane, known.plane, rtol=1e-9)
    assert not found.is_plane_measured
    np.testing.assert_allclose(
        feature.measure(found, goal).L, feature.measure(known, goal).L, rtol=1e-7, atol=1e-9)
    with pytest.raises(MeasurementError, match="the target's plane is not known"):
        feature.measure(look(feature.needs, TILTED, plane=False), goal)
    if name != "points_3d":
        with pytest.raises(MeasurementError, match="behind the camera"):
            feature.measure(replace(known, plane=Plane(0.0, 0.0, -5.0)), goal)


def test_the_plane_is_known_from_both_its_sides_and_not_in_it():
    goal = Goal(plane=Plane(0.0, 0.0, 5.0), world_T_camera=np.eye(4))
    for depth in (0.19, 0.21):
        seen = goal.compute_plane(pose((0.0, 0.0, depth), (0.1, 0, 0)))
        np.testing.assert_allclose(seen, np.array([0.0, np.sin(0.1), np.cos(0.1)]) / (0.2 - depth))
    for one, place in ((goal, pose((0.1, 0.3, 0.2), (0.1, 0, 0))),
                       (replace(goal, plane=None), np.eye(4)),
                       (replace(goal, world_T_camera=None), np.eye(4))):  # fmt: skip
        assert one.compute_plane(place) is None
    with pytest.raises(MeasurementError, match="behind the camera"):  # infinitely far away
        compute_inverse_depth(Plane(2.0, 0.0, 1.0), np.array([[0.3, 0.1], [-0.5, 0.1]]))


@pytest.mark.parametrize("posed", [True, False])
def test_the_depth_of_the_area_is_the_goals_own_at_the_goal(posed):
    """Far off the axis of a camera that leans both ways, and on the way to it; by it the loop tells
    a wrong focal length, which a plane of kinematics hides."""
    feature = FEATURES.create("moments")
    aside = pose((0.1, -0.05, 0.3), (0.4, 0.3, 0.2))
    goal = taught(feature, view=aside)
    if not posed:
        goal = replace(goal, world_T_camera=None)
    feature.check(goal)
    found = feature.measure(look(feature.needs, aside, plane=False), goal)
    np.testing.assert_allclose(found.L, feature.desired_interaction(goal), rtol=1e-9, atol=1e-9)
    if not posed:
        return
    # the area of a small patch goes with its distance and its slant
    small = 0.1 * OUTLINE
    goal, on = taught(feature, small, aside), pose((-0.06, 0.1, 0.5), (-0.3, 0.5, 1.0))
    seen = look(feature.needs, on, small)
    exact = feature.measure(seen, goal).L
    by_area = feature.measure(look(feature.needs, on, small, plane=False), goal).L
    scale = np.abs(exact).max(axis=1, keepdims=True)
    np.testing.assert_allclose(by_area / scale, exact / scale, atol=1e-3)
    for plane, measured in ((Plane(0.0, 0.0, -5.0), True), (Plane(0.1, 0.2, 9.0), False)):
        told = replace(seen, plane=plane, is_plane_measured=measured)
        np.testing.assert_array_equal(feature.measure(told, goal).L, by_area)
    assert seen.is_plane_measured and not np.array_equal(exact, by_area)


def seen_with_depth(depth, needs=frozenset((Need.CORNERS, Need.DEPTH)), **options):
    """An image of the outline at TILTED, dark on white, with a depth image."""
    pixels = np.column_stack(CAMERA.project(*dense(seen_from(TILTED)).T))
    image = np.full((240, 320), 255, np.uint8)
    cv2.fillPoly(image, [np.round(pixels).astype(np.int32)], 0)
    observer = FeatureObserver(None, needs, **options)
    return observer.observe_image(0.0, image, CAMERA, depth=depth)


def test_the_plane_is_that_of_the_depth_image_where_it_is_asked_for():
    goal = taught(FEATURES.create("points"))
    plane = Plane.from_pose(TILTED[:3, :3], TILTED[:3, 3])
    pixels = np.column_stack(CAMERA.project(*seen_from(TILTED).T)).astype(np.float32)
    target = np.zeros((240, 320), np.uint8)
    cv2.fillConvexPoly(target, np.round(cv2.convexHull(pixels)).astype(np.int32), 1)
    depth = depth_image(TILTED, cv2.dilate(target, np.ones((5, 5))).astype(bool))
    for needs in ((Need.CORNERS,), (Need.MOMENTS,), (Need.CONTOUR, Need.MOMENTS)):
        # The goal's plane would be wrong: it is nearer, and the camera's pose is not known.
        needs = frozenset((*needs, Need.DEPTH))
        seen = seen_with_depth(depth, needs, compute_plane=goal.compute_plane)
        assert seen.valid, seen.reason
        np.testing.assert_allclose(seen.plane, plane, rtol=1e-4, atol=1e-4)
    seen = seen_with_depth(depth, frozenset((Need.CORNERS,)))
    assert seen.plane is None and seen.depth is None
    depth = depth_image(TILTED)  # pixels without depth do not count
    depth[::2], depth[1::4] = np.nan, 0.0
    np.testing.assert_allclose(seen_with_depth(depth).plane, plane, rtol=1e-4, atol=1e-4)
    seen = seen_with_depth(np.full((240, 320), np.inf, np.float32))
    with pytest.raises(MeasurementError, match="the depth image has no depth at the target"):
        FEATURES.create("points").measure(replace(seen, world_T_camera=np.eye(4)), goal)


@pytest.mark.parametrize(("name", "corners", "words"), [
    ("polar_points", [[9e-10, 0.0], [0.1, 0.0], [0.1, 0.1]], "has no polar angle"),
    ("segments", [[0.1, 0.0], [0.1, 9e-10], [0.3, 0.1]], "coincide, so the edge between them"),
    ("lines", [[0.1, 0.2], [0.1, 0.2], [0.3, 0.1]], "coincide, so the edge between them"),
    ("pose", [[-0.05, 0.01], [0.0, 0.01], [0.02, 0.01], [0.06, 0.01]],
     "goal: a pose needs four points that are not on one line; the goal has 4"),
    ("pose", [[0.1, 0.2], [0.1, 0.3], [0.3, 0.1]], "a pose needs four points .* the goal has 3"),
    ("points", "far away", "no points of the feature 'points'"),
    ("points", [[0.1, 0.2], [0.3, 0.1]], "goal holds no points of the feature 'points': teach it"),
])  # fmt: skip
def test_a_goal_of_points_that_are_no_such_feature_is_refused(name, corners, words):
    with pytest.raises(ConfigurationError, match=words):
        FEATURES.create(name).check(Goal(depth=0.5, features={name: {"points": corners}}))


@pytest.mark.parametrize(("name", "each", "elements"), [
    ("points", 2, 8), ("points_3d", 3, 8), ("lines", 2, 8), ("segments", 4, 8), ("pose", 6, 1),
])  # fmt: skip
def test_a_feature_is_as_long_as_the_goal_that_it_was_checked_with(name, each, elements):
    feature = FEATURES.create(name)
    assert feature.count == 4
    goal = taught(feature)  # of eight corners
    feature.check(goal)
    assert feature.count == 8
    found = feature.measure(look(feature.needs, VIEWS["near"]), goal)
    for numbers in (feature.names, feature.tolerances, feature.units, found.s, found.L):
        assert len(numbers) == each * elements


@pytest.mark.parametrize("name", ["points", "moments", "kernel"])
def test_a_goal_without_the_depth_of_its_target_is_refused(name):
    feature = FEATURES.create(name)
    kernel = Goal.teach(None, kernel_view(SMALL, GOAL), depth=0.2).kernel
    goal = replace(taught(feature), kernel=kernel)
    feature.check(goal)
    with pytest.raises(ConfigurationError, match="goal contains no depth of the target: teach"):
        feature.check(replace(goal, depth=None, plane=None))
    if name == "kernel":
        nothing = replace(kernel, features=np.array([1.0, 1.0, 0.0, 0.1]))
        with pytest.raises(ConfigurationError, match="kernel features 0 to 2 must be above 0"):
            feature.check(replace(goal, kernel=nothing))


class TwoSpots(PointFeature):
    name = "spots"
    needs = frozenset((Need.IMAGE,))

    def points(self, observation):
        return np.array([[0.0, 0.1], [0.2, np.nan], [0.3, 0.4]])


def test_a_stack_has_the_parts_one_under_the_other_with_their_weights():
    parts = [FEATURES.create("moments"), FEATURES.create("points")]
    stack = Stack(parts, [2.0, 0.5])
    scheme = FeatureScheme(stack)
    goal = Goal.teach(scheme, look(stack.needs, GOAL))
    scheme.check(goal)
    view = look(stack.needs, VIEWS["near"])
    measured = stack.measure(view, goal)
    one, two = (part.measure(view, goal) for part in parts)
    np.testing.assert_array_equal(measured.error, [*one.error, *two.error])
    np.testing.assert_array_equal(measured.L, np.vstack([one.L, two.L]))
    np.testing.assert_array_equal(stack.weights, [2.0] * 4 + [0.5] * 16)
    np.testing.assert_array_equal(Stack(parts, [2.0, 0.0]).weights, [2.0] * 4 + [0.0] * 16)
    rows = [part.desired_interaction(goal) for part in parts]
    np.testing.assert_array_equal(stack.desired_interaction(goal), np.vstack(rows))
    assert stack.accuracy(view, goal) is None  # exact
    assert len(scheme.tolerances) == len(scheme.names) == 20
    assert stack.needs == {Need.MOMENTS, Need.CORNERS} and stack.directions == (True,) * 6
    decision = scheme.compute(view, goal, 0.0)
    # weighted least squares: the same as rows scaled by the weights
    W = np.diag(stack.weights)
    expected = np.linalg.lstsq(W @ measured.L, W @ (-5.0 * measured.error), rcond=None)[0]
    np.testing.assert_allclose(decision.task.twist, expected, rtol=1e-6, atol=1e-9)
    np.testing.assert_array_equal(decision.error, measured.error)
    for weights in ([1.0], [1.0, -1.0], [1.0, np.nan], [0, 0]):
        with pytest.raises(ConfigurationError, match="weights"):
            Stack(parts, weights)


@pytest.mark.parametrize(("shape", "open_"), [(SQUARE * [1.0, 0.6], "180°"), (OUTLINE, "")])
def test_a_part_that_sees_the_whole_turn_is_enough(shape, open_):
    scheme = create_scheme("moments+points")
    seen = look(scheme.needs, GOAL, shape)
    scheme.check(goal := Goal.teach(scheme, seen))
    assert scheme.compute(seen, goal, 0.0).ambiguity == open_


class Photo(Feature):
    """A user's: six rows for the law, one number to be judged by; it does not say so before."""

    names, tolerances, needs = ("rms",), (1.0,), frozenset()

    def measure(self, observation, goal):
        s = 3.0 * np.ones(6)
        return FeatureMeasurement(
            s, s / 3.0, s / 1.5, np.eye(6), error_drift=0.1, error_summary=np.ones(1))


def test_what_is_judged_by_other_numbers_than_its_rows_is_in_no_stack():
    left = RemoteCameraFeature(FEATURES.create("luminance"), "left")
    for parts, words in (
        (["points", "luminance"], "cannot be combined"),
        (["matches", "luminance_dct"], "cannot be combined"),
        ([left, "points"], "luminance@left publishes other errors than the law uses"),
    ):
        with pytest.raises(ConfigurationError, match=words):
            Stack([FEATURES.create(part) if isinstance(part, str) else part for part in parts])
    assert Stack([FEATURES.create("points"), FEATURES.create("matches_pose")]).names
    stack = Stack([Photo(), FEATURES.create("points")])
    with pytest.raises(ConfigurationError, match="Photo publishes other errors"):
        stack.measure(look(stack.needs, GOAL), taught(stack))


# -- kernel ------------------------------------------------------------------------------------
def kernel_view(camera, camera_T_object, stamp=0.0):
    numbers = compute_outline_kernel_features(
        seen_from(camera_T_object), camera.pinhole, camera.width, camera.height
    ).to_message_data()
    return FeatureObserver(None, frozenset((Need.KERNEL,))).observe_moments(
        stamp, None, True, "", camera, kernel=numbers)


@pytest.mark.parametrize(
    ("way", "turn", "fx", "fy", "rows"),
    [((1, 1, 0, 0, 0, 0), -0.5, 380.0, 460.0, 3), ((0, 0, 1, 0, 0, 0), -0.5, 380.0, 460.0, 3),
     ((0, 0, 0, 0, 0, 1), -0.5, 380.0, 460.0, 3),
     ((0, 0, 0, 0, 0, 1), 0.5, 400.0, 410.0, 4)],  # k3 is the angle where pixels are square
)  # fmt: skip
def test_the_kernels_interaction_matrix_is_the_derivative(way, turn, fx, fy, rows):
    camera = CameraModel(800, 600, (fx, 0, 99.5, 0, fy, 119.5, 0, 0, 1))
    feature = FEATURES.create("kernel")
    goal = Goal.teach(None, kernel_view(camera, pose((0.01, 0.02, 0.2), (0, 0, 0.3))), depth=0.2)
    feature.check(goal)
    view = pose((0.01, 0.005, 0.2), (0, 0, turn))
    # the depth that the area tells, where the target lies square on
    told = feature.measure(kernel_view(camera, view), goal).L @ way
    step = 2e-2 if way[5] else 4e-3
    places = [moved(view, sign * step * np.array(way)) for sign in (1.0, -1.0)]
    sides = [feature.measure(kernel_view(camera, place), goal).error for place in places]
    found = (sides[0] - sides[1]) / (2.0 * step)
    np.testing.assert_allclose(
        found[:rows], told[:rows], rtol=0.02, atol=0.02 * np.abs(told[:rows]).max())


def test_kernel_features_refuse_another_camera_a_dirty_ground_and_emptiness():
    feature = FEATURES.create("kernel")
    view = kernel_view(SMALL, pose((0.01, 0.02, 0.2), (0, 0, 0.3)))
    goal = Goal.teach(None, view, depth=0.2)
    feature.check(goal)
    half = round(view.kernel[18] / (DELTA_X * DELTA_Y)) / 2.0
    for counted in (view.pixel_count, half):  # twice the target's pixels is not yet too many
        found = feature.measure(replace(view, pixel_count=counted), goal)
        np.testing.assert_allclose(found.error, 0.0, atol=1e-12)
    turned = kernel_view(SMALL, pose((0.02, -0.01, 0.25), (0, 0, 0.9)))
    found, now, then = feature.measure(turned, goal), turned.kernel[16:], view.kernel[16:]
    np.testing.assert_array_equal([found.s, found.desired], [now, then])
    expected = [*((now - then)[:3] / then[:3]), (now - then)[3]]  # the angle's is not of a part
    np.testing.assert_allclose(found.error, expected)
    assert found.ambiguity == "180°"
    accuracy = feature.accuracy(turned, goal)
    np.testing.assert_array_equal(accuracy, np.diag((0.01, 0.01, 0.02, 0.04)))
    for change, words in (
        ({"camera": replace(SMALL, K=(110.0, 0, 159.5, 0, 110.0, 119.5, 0, 0, 1))},
         "taught with another camera"),
        ({"pixel_count": 100}, "counts .* pixels of the target"),
        ({"kernel": None}, "expected the 20 numbers"), ({"kernel": np.zeros(4)}, "got 4"),
        ({"kernel": np.zeros(20)}, "not visible"),
        ({"kernel": np.r_[np.zeros(16), then]}, "Jacobian is singular"),
        ({"kernel": np.where(np.arange(20) == 3, np.nan, view.kernel)}, "not visible"),
    ):  # fmt: skip
        with pytest.raises(MeasurementError, match=words):
            feature.measure(replace(view, **change), goal)
    with pytest.raises(ConfigurationError, match="no kernel features"):
        feature.check(Goal(depth=0.2))
