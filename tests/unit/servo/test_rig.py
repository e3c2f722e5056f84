"""Several cameras of one scheme: simultaneous images, and one observation of them."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from feature_scenes import CAMERA
from loop_rig import URDF, the_arm, the_goal
from scipy.spatial.transform import Rotation

from aras_visual_servo_base.poses import exponential, inverse, logarithm, matrix_from_xyz_rpy
from aras_visual_servo_bench.plants.free_camera_kinematics import (
    COORDINATE_NAMES,
    FreeCameraKinematics,
)
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_controller import Goal, JointSample, Need, Points, RemoteCameraFeature
from aras_visual_servo_controller.errors import ConfigurationError, MeasurementError
from aras_visual_servo_controller.features import Feature, FeatureMeasurement, Stack
from aras_visual_servo_controller.features.stereo import estimate_rigid_motion, triangulate
from aras_visual_servo_controller.loop import teaching
from aras_visual_servo_controller.observation.camera_rig import CameraRig, FixedCameraKinematics
from aras_visual_servo_controller.observation.feature_observer import FeatureObserver
from aras_visual_servo_controller.schemes import FeatureScheme, create_scheme
from aras_visual_servo_controller.settings import ControllerSettings

# of the right camera in the left one
SEAT = matrix_from_xyz_rpy((0.05, -0.01, 0.02), (0.1, -0.2, 0.3))
SHAPE = np.array([[-0.05, -0.03, 0], [0.05, -0.02, 0], [0.03, 0.04, 0], [-0.04, 0.03, 0.0]])
NAMES = COORDINATE_NAMES
ORIGIN = matrix_from_xyz_rpy((0.02, -0.03, 0.4), (np.pi, 0.1, 0.2))
LEFT, RIGHT = FreeCameraKinematics(ORIGIN, np.eye(4)), FreeCameraKinematics(ORIGIN, SEAT)
Q0 = np.zeros(6)
Q = np.array([0.01, -0.02, 0.03, 0.05, -0.04, 0.2])
NOW = Q + 1e-3 * np.array([1.0, -2.0, 1.5, 3.0, 2.0, -1.0])


def rig(needs=(Need.CORNERS,), right=RIGHT, goal=None, change=None):
    """Return a rig, which may be displaced by a change (4, 4) of the left camera from Q on."""
    arms = {"left": LEFT, "right": right}
    if change is not None:
        arms = {name: FreeCameraKinematics(arm.origin @ exponential(Q) @ change, arm.mounting)
                for name, arm in arms.items()}  # fmt: skip
    plane = {} if goal is None else {n: g.compute_plane for n, g in goal.cameras.items()}
    return CameraRig([
        FeatureObserver(arm, frozenset(needs), compute_plane=plane.get(name), name=name)
        for name, arm in arms.items()
    ])  # fmt: skip


def places(camera, shape=SHAPE):
    return (np.column_stack([shape, np.ones(4)]) @ inverse(camera).T)[:, :3]


def corners(pose, shape=SHAPE):
    seen = places(pose, shape)
    return seen[:, :2] / seen[:, 2:]


def view(observer, stamp, q, plane=None, shape=SHAPE):
    joints = JointSample.from_values(stamp, NAMES, q)
    outline = corners(observer.arm.pose(np.asarray(q)), shape)
    return observer.observe_exact_features(stamp, CAMERA, joints, contour=outline, plane=plane)


def together(made, q, stamp=1.0, then=None):
    """Return one observation; the right camera is exposed at coordinates `then`, 0.02 s before."""
    seen = view(made.observers["right"], *((stamp, q) if then is None else (stamp - 0.02, then)))
    return made.merge_observations(view(made.control, stamp, q), {"right": seen})


def checked(name, target=None):
    """Return a scheme, and a goal that was shown to it with both cameras."""
    scheme = create_scheme(name)
    goal = goal_of(scheme, target)
    scheme.check(goal)
    return scheme, goal


# -- which pictures belong together -------------------------------------------------------------
def fed(made, *pictures):
    """Return the pairs of stamps (control, right) that are used of the images (camera, stamp)."""
    answered = []
    for name, stamp in pictures:
        def look(joints, commands, name=name, stamp=stamp):
            return view(made.observers[name], stamp, Q0)

        found = made.add_image(name, stamp, look)
        if found is not None:
            seen = found[1](JointSample.from_values(found[0], NAMES, Q0), ())
            answered.append((round(seen.stamp, 3), round(seen.cameras["right"].stamp, 3)))
    return answered


def test_one_camera_waits_for_nobody_and_two_say_which_is_missing():
    alone = CameraRig([FeatureObserver(LEFT, frozenset((Need.CORNERS,)))])
    assert alone.add_image("camera", 0.3, len) == (0.3, len)
    made = rig()
    assert fed(made, ("left", 0.1), ("left", 0.2)) == [] and made.missing_camera == "right"
    made.reset()
    assert made.missing_camera == ""


LEFTS, RIGHTS = ([(name, 0.1 * k) for k in range(1, 10)] for name in ("left", "right"))
SLOWER = [*LEFTS[:8], *(("right", 0.25 * k) for k in (1, 2, 3))]


@pytest.mark.parametrize(("pictures", "answered"), [
    ([image for pair in zip(LEFTS, RIGHTS, strict=True) for image in pair[::-1]][:8], (1, 2, 3, 4)),
    ([*LEFTS[:2], RIGHTS[0], LEFTS[2], RIGHTS[1], LEFTS[3], RIGHTS[2]], (1, 2, 3)),  # late ones
    ([LEFTS[0], RIGHTS[0], LEFTS[1], RIGHTS[1], *LEFTS[2:4], RIGHTS[3]], (1, 2, 4)),  # one is lost
    ([*LEFTS[:8], RIGHTS[0]], (1,)), ([*LEFTS, RIGHTS[0]], ()),  # eight wait for another camera's
    (sorted(SLOWER, key=lambda one: one[1]), ((0.5, 0.5), (0.6, 0.5), (0.7, 0.5), (0.8, 0.75))),
], ids=["right first", "late", "lost", "eight", "nine", "slower"])  # fmt: skip
def test_what_was_exposed_together_is_seen_together(pictures, answered):
    pairs = [one if isinstance(one, tuple) else (0.1 * one, 0.1 * one) for one in answered]
    found = np.reshape(fed(rig(), *pictures), (-1, 2))
    np.testing.assert_allclose(found, np.reshape(pairs, (-1, 2)))


def test_an_older_picture_gets_the_joints_of_its_own_exposure():
    made, heard = rig(), []
    made.find_joints = lambda stamp: JointSample.from_values(stamp, NAMES, Q0)

    def look(joints, commands, name, stamp):
        heard.append((name, round(stamp, 3), round(joints.stamp, 3)))
        return view(made.observers[name], stamp, Q0)

    for name, stamp in sorted(SLOWER, key=lambda one: one[1]):
        found = made.add_image(name, stamp, partial(look, name=name, stamp=stamp))
        if found is not None:
            # of the control camera's they are said to be a little later here
            found[1](JointSample.from_values(found[0] + 0.01, NAMES, Q0), ())
    of_right = [one[1:] for one in heard if one[0] == "right"]
    assert of_right == [(0.5, 0.51), (0.75, 0.75)]


@pytest.mark.parametrize(("late", "pair"), [
    (0.004, (0.4, 0.404)), (0.024, (0.4, 0.424)), (0.028, (0.4, 0.328)),  # a quarter of the period
])  # fmt: skip
def test_stamps_of_one_trigger_may_differ_a_little(late, pair):
    pictures = [(name, 0.1 * k + (late if name == "right" else 0.0))
                for k in range(1, 6) for name in ("left", "right")]  # fmt: skip
    assert pair in fed(rig(), *pictures)


# -- what they see -----------------------------------------------------------------------------
def test_an_observation_of_two_cameras_holds_each_with_its_own_view():
    seen = together(rig(), Q)
    assert list(seen.cameras) == ["left", "right"] and seen.cameras["left"] is seen
    right = seen.cameras["right"]
    np.testing.assert_allclose(right.world_T_camera, RIGHT.pose(Q))
    np.testing.assert_allclose(right.corners, corners(RIGHT.pose(Q)))
    assert seen.twist_from_control is None and right.motion_since_exposure is None
    twist, step = np.arange(1.0, 7.0), 1e-6
    ahead = LEFT.pose(Q) @ exponential(step * twist) @ SEAT
    moved = logarithm(inverse(RIGHT.pose(Q)) @ ahead) / step
    np.testing.assert_allclose(right.twist_from_control @ twist, moved, atol=1e-5)
    standing = together(rig(right=FixedCameraKinematics(RIGHT.pose(Q0))), Q0)
    of_control = standing.cameras["right"].twist_from_control
    assert of_control.shape == (6, 6) and not of_control.any()


def test_an_older_picture_is_brought_up_to_now():
    made = rig()
    right = together(made, NOW, then=Q).cameras["right"]
    np.testing.assert_allclose(
        exponential(right.motion_since_exposure), inverse(RIGHT.pose(Q)) @ RIGHT.pose(NOW),
        atol=1e-12)
    for age, known in ((5e-4, True), (5e-10, False)):
        views = view(made.control, 1.0, NOW), view(made.observers["right"], 1.0 - age, Q)
        seen = made.merge_observations(views[0], {"right": views[1]}).cameras["right"]
        assert (seen.motion_since_exposure is not None) is known


@pytest.mark.parametrize("known", ["left", "right", ""])
def test_where_one_camera_is_tells_nothing_of_another(known):
    arms = {"left": LEFT, "right": RIGHT}
    made = CameraRig([FeatureObserver(arm if name == known else None, frozenset(), name=name)
                      for name, arm in arms.items()])  # fmt: skip
    joints = JointSample.from_values(1.0, NAMES, Q0)
    views = [o.observe_exact_features(1.0, CAMERA, joints, contour=corners(LEFT.pose(Q0)))
             for o in made.observers.values()]  # fmt: skip
    with pytest.raises(MeasurementError, match="camera right relative to left is unknown"):
        made.merge_observations(views[0], {"right": views[1]})


# -- features of cameras -----------------------------------------------------------------------
def goal_of(scheme, target=None, shape=SHAPE):
    made = rig()

    def plane(pose):
        n, p = inverse(pose)[:3, 2:].T
        return Plane(*(n / (n @ p)).tolist())

    views = {n: view(o, 1.0, Q0, plane(o.arm.pose(Q0)), shape) for n, o in made.observers.items()}
    shown = made.merge_observations(views["left"], {"right": views["right"]})
    return Goal.teach(scheme, shown, target=target)


@pytest.mark.parametrize(("name", "rtol"), [
    ("points@left+points@right", 1e-4), ("points@left+pose@right", 1e-4),
    ("points@left+moments_six@right", 1e-3),  # moments tell the depth of a tilted plane to 0.05 %
    ("stereo_points@left,right", 1e-5), ("stereo_pose@left,right", 1e-5),
    ("stereo_points@right,left", 1e-5),
])  # fmt: skip
def test_L_is_that_of_the_control_camera_s_twist(name, rtol):
    scheme, goal = checked(name)
    feature = scheme.feature.features[1] if "+" in name else scheme.feature
    needs, step = (Need.CORNERS, Need.MOMENTS), 1e-6

    def measured(change):
        return feature.measure(together(rig(needs, goal=goal, change=change), Q0), goal)

    columns = [
        (measured(exponential(step * d)).s - measured(exponential(-step * d)).s) / (2 * step)
        for d in np.eye(6)
    ]
    L = measured(np.eye(4)).L
    np.testing.assert_allclose(L, np.transpose(columns), rtol=rtol, atol=0.2 * rtol)
    if "+" in name:
        assert feature.names[0].startswith("right.")
        there = feature.measure(together(rig(needs, goal=goal), Q0), goal).L
        np.testing.assert_allclose(feature.desired_interaction(goal), there, rtol=rtol, atol=1e-4)


@pytest.mark.parametrize(("name", "off"), [
    ("points@left+points@right", 2e-3), ("stereo_points@right,left", 5e-4),
])  # fmt: skip
def test_an_older_view_s_features_are_brought_to_the_control_camera_s_exposure(name, off):
    scheme, goal = checked(name)
    made, feature = rig(goal=goal), scheme.feature.features[1] if "+" in name else scheme.feature
    true, old = (feature.measure(together(made, q), goal) for q in (NOW, Q))
    found = feature.measure(together(made, NOW, then=Q), goal)
    assert np.abs(old.s - true.s).max() > off
    np.testing.assert_allclose(found.s, true.s, atol=0.05 * off)  # to first order
    np.testing.assert_array_equal(found.desired, true.desired)
    np.testing.assert_allclose(found.error, found.s - found.desired, atol=1e-15)
    np.testing.assert_allclose(found.L, true.L, atol=20 * off)

    class Moving(Points):
        def measure(self, observation, goal):
            return replace(super().measure(observation, goal), error_drift=0.3)

    if "+" in name:
        feature = RemoteCameraFeature(Moving(), "right")
        feature.check(goal)
        moving = feature.measure(together(made, NOW, then=Q), goal)
        np.testing.assert_allclose(moving.s, found.s + 0.02 * 0.3)


def test_directions_of_another_camera_are_the_control_camera_s_that_move_it_so():
    level = RemoteCameraFeature(create_scheme("moments").feature, "right")
    goal = goal_of(create_scheme("points@left+points@right"))
    aside = goal.world_T_camera @ matrix_from_xyz_rpy((0.05, 0.0, 0.0), (0.0, 0.0, 0.0))
    parallel = replace(goal.other_cameras["right"], world_T_camera=aside)
    level.check(replace(goal, other_cameras={"right": parallel}))
    assert level.directions == (True, True, True, False, False, True)
    level.check(goal)
    assert level.directions == (True,) * 6  # tilted against the control camera


def test_a_camera_where_the_target_is_lost_is_named():
    scheme, goal = checked("points@left+points@right")
    made, joints = rig(goal=goal), JointSample.from_values(1.0, NAMES, Q0)
    lost = made.observers["right"].observe_exact_features(1.0, CAMERA, joints)
    seen = made.merge_observations(view(made.control, 1.0, Q0), {"right": lost})
    with pytest.raises(MeasurementError, match="camera right: the target is not in view"):
        scheme.compute(seen, goal, 0.0)

    class Wanting(Feature):
        names, tolerances, needs = ("x",), (1.0,), frozenset((Need.IMAGE,))

        def measure(self, observation, goal):
            return FeatureMeasurement(np.ones(1), np.zeros(1), np.ones(1), np.ones((1, 6)))

    scheme = FeatureScheme(
        [RemoteCameraFeature(Points(), "left"), RemoteCameraFeature(Wanting(), "right")])
    assert len(scheme.compute(seen, goal, 0.0).error) == 9


# -- names -------------------------------------------------------------------------------------
@pytest.mark.parametrize(("name", "read"), [
    ("points", ("left",)), ("points@right", ("right",)), ("partitioned@right", ("right",)),
    ("points+area@right", ("left", "right")), ("points@right+area@left", ("left", "right")),
    ("points@rihgt", "reads the unknown camera 'rihgt': did you mean 'right'"),
    ("points@", "the name of a camera is missing after @"),
    ("points@left,right", "scheme 'points' reads 1 camera: name one, for example points@l"),
    ("partitioned@left,right", "scheme 'partitioned' reads one camera"),
    ("stereo_points", "'stereo_points' reads 2 cameras: name them, for example stereo_p"),
    ("stereo_pose@left,right,wall", "scheme 'stereo_pose' reads 2 cameras: name them"),
])  # fmt: skip
def test_a_scheme_says_which_cameras_it_reads(name, read):
    settings = ControllerSettings(cameras={"left": {}, "right": {}})
    if isinstance(read, tuple):
        assert settings.list_cameras(create_scheme(name)) == read
        return
    with pytest.raises(ConfigurationError, match=read):
        settings.list_cameras(create_scheme(name))


def test_a_goal_of_one_camera_has_no_view_of_another():
    for name in ("points@left+points@right", "stereo_pose@left,right"):
        scheme, goal = checked(name)
        with pytest.raises(ConfigurationError, match="has no view of camera 'right': teach it"):
            scheme.check(replace(goal, other_cameras={}))
    # A stack needs of each camera what its features do.
    grey = create_scheme("matches_pose").feature
    stack = Stack([RemoteCameraFeature(Points(), "left"), RemoteCameraFeature(grey, "right")])
    assert stack.cameras == ("left", "right")
    assert stack.get_needs("", "left") == {Need.CORNERS}
    assert stack.get_needs("right") == {Need.IMAGE}


# -- stereo ------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", ["stereo_points@left,right", "stereo_pose@right,left"])
def test_accuracy_of_stereo_goes_through_the_feature(name):
    """Each column is what the feature makes of one coordinate in one camera that is off."""
    scheme, goal = checked(name)
    made, feature, size = rig(), scheme.feature, {"left": 1e-6, "right": 3e-6}

    def seen(off, corner_accuracy):
        views = {}
        for camera, observer in made.observers.items():
            shown = view(observer, 1.0, Q0)
            corners = shown.corners + off.get(camera, 0.0)
            views[camera] = replace(shown, corners=corners, corner_accuracy=corner_accuracy[camera])
        return made.merge_observations(views["left"], {"right": views["right"]})

    assert feature.accuracy(seen({}, dict.fromkeys(size, 0.0)), goal) is None  # exact
    # What was taught through another lens shares nothing with what is seen now.
    right = replace(goal.other_cameras["right"], camera=None)
    apart = replace(goal, camera=None, other_cameras={"right": right})
    found = feature.accuracy(seen({}, size), apart)
    offs = [(camera, off) for camera in feature.cameras for off in np.eye(8).reshape(8, 4, 2)]
    expected = [feature.measure(seen({c: size[c] * off}, size), goal).error for c, off in offs]
    np.testing.assert_allclose(found, np.transpose(expected), atol=1e-4 * np.abs(found).max())
    own = feature.accuracy(seen({}, {"left": 0.0, "right": 3e-6}), apart)  # one of them is exact
    of_right = np.array([camera == "right" for camera, _ in offs])
    np.testing.assert_allclose(own, found * of_right, atol=1e-12)


def test_places_of_two_cameras_are_the_target_s():
    scheme = create_scheme("stereo_points@left,right")
    assert scheme.names == tuple(f"{axis}{i}" for i in range(4) for axis in "XYZ")  # no goal yet
    scheme.check(goal := goal_of(scheme))  # which is shown from q = 0
    found = scheme.feature.measure(together(rig(), Q), goal)
    for values, q in ((found.s, Q), (found.desired, Q0)):
        np.testing.assert_allclose(values.reshape(-1, 3), places(LEFT.pose(q)), atol=1e-9)
    alike = [create_scheme("points_3d").feature, scheme.feature]  # by a plane, by two cameras
    assert alike[0].tolerances == alike[1].tolerances and alike[0].units == alike[1].units


def test_a_goal_of_two_cameras_holds_points_of_both_that_are_the_same():
    scheme, goal = checked("stereo_pose@left,right")
    one, other = goal.features["stereo_pose"]["points"]
    seen = together(rig(), Q0)
    right = seen.cameras["right"]  # there the corners are found in another order
    right = replace(right, corners=np.roll(right.corners, 1, axis=0), is_numbered=False)
    found = scheme.teach(replace(seen, other_cameras={"right": right}))
    np.testing.assert_allclose(found["stereo_pose"]["points"], [one, other], atol=1e-12)
    fewer = replace(right, corners=right.corners[:3], contour=None)
    found = scheme.teach(replace(seen, other_cameras={"right": fewer}))["stereo_pose"]["points"]
    assert [len(points) for points in found] == [4, 3]  # the check of the goal says so
    for points, words in (
        ([one], "goal holds no points of two cameras: teach it with stereo_pose"),
        ([one, other[:3]], "holds no points of two cameras"),
        ([one[0], other[0]], "holds no points of two cameras"),
        ([one, [[x + 0.5, y] for x, y in other]], "goal: .* lies behind one"),
    ):
        with pytest.raises(ConfigurationError, match=words):
            scheme.check(replace(goal, features={"stereo_pose": {"points": points}}))
    right, depth = goal.other_cameras["right"], 1.0 / goal.plane.C
    for apart, refused in ((1.9e-3 * depth, True), (2.1e-3 * depth, False)):
        there = goal.world_T_camera @ matrix_from_xyz_rpy((0.0, apart, 0.0), (0.0, 0.0, 0.0))
        close = replace(goal, other_cameras={"right": replace(right, world_T_camera=there)})
        told = (f"cameras left and right are {1e3 * apart:.1f} mm apart, too close to measure depth"
                if refused else "behind")
        with pytest.raises(ConfigurationError, match=told):
            scheme.check(close)
    line = places(SEAT, SHAPE * [1, 0, 0]) + [0, 0, 0.4]
    for after in (line + [0.1, 0.0, 0.0], np.zeros_like(line)):  # nor in one place
        with pytest.raises(MeasurementError, match="on one line: they give no pose"):
            estimate_rigid_motion(line, after)


@pytest.mark.parametrize("seed", range(3))
def test_a_rigid_motion_is_that_of_least_squares(seed):
    """As SciPy has it, also of a plane's points, and of a mirrored body, which no turn fits."""
    random = np.random.default_rng(seed)
    before = random.normal(0.0, 0.1, (6, 3)) * (1.0, 0.7, 0.0 if seed == 1 else 0.5)
    turn = Rotation.from_rotvec(random.normal(0.0, 1.0, 3))
    after = turn.apply(before * (1.0, 1.0, -1.0 if seed == 2 else 1.0))
    after += random.normal(0.0, 5e-3, after.shape) + random.normal(0.0, 0.5, 3)
    found = estimate_rigid_motion(before, after)
    middles = before.mean(axis=0), after.mean(axis=0)
    expected = Rotation.align_vectors(after - middles[1], before - middles[0])[0]
    np.testing.assert_allclose(found[:3, :3], expected.as_matrix(), atol=1e-6)
    np.testing.assert_allclose(found @ (*middles[0], 1.0), (*middles[1], 1.0), atol=1e-12)
    # A point behind either of two cameras, before or behind the other, is refused.
    for apart in (1.0, -1.0):
        beside = matrix_from_xyz_rpy((0.02, 0.0, apart), (0.0, 0.0, 0.0))
        there = np.array([[0.1, -0.05, -0.5 * apart], [0.2, 0.1, 3.0]])  # the second before both
        seen = [points[:, :2] / points[:, 2:] for points in (there, there + beside[:3, 3])]
        with pytest.raises(MeasurementError, match="lies behind one"):
            triangulate(*seen, beside)


def test_two_cameras_forget_the_turn_to_which_a_square_was_followed():
    square = 0.04 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0.0]])
    scheme, made = create_scheme("stereo_points@left,right"), rig()
    goal = goal_of(scheme, shape=square)

    def measure(turn=0.0, numbered=""):
        q = (0.0, 0.0, 0.0, 0.0, 0.0, turn)
        left, right = (replace(view(observer, 1.0, q, shape=square),
                               is_numbered=None if name == numbered else False)
                       for name, observer in made.observers.items())  # fmt: skip
        return scheme.feature.measure(made.merge_observations(left, {"right": right}), goal)

    for which, open_ in (("", "90°"), ("left", ""), ("right", "")):  # where one knows its corners
        assert measure(numbered=which).ambiguity == open_
    scheme.reset()
    begun = measure(1.0).s  # a square that is turned by less than half a quarter back
    followed = [measure(turn).s for turn in (0.0, 0.5, 1.0)][-1]
    assert np.abs(followed - begun).max() > 0.05
    scheme.reset()
    np.testing.assert_array_equal(measure(1.0).s, begun)


def test_the_mean_of_views_of_two_cameras_is_that_of_each():
    scheme, made = create_scheme("points@left+points@right"), rig()
    several = 0.02 * np.random.default_rng(4).normal(size=(3, 6))
    views = [together(made, q) for q in several]
    found = teaching.make_mean_goal(views, scheme, LEFT, "mine", depth=0.4)
    middle = several.mean(axis=0)
    assert found.joints == pytest.approx(dict(zip(NAMES, middle, strict=True)))
    np.testing.assert_allclose(found.world_T_camera, LEFT.pose(middle), atol=1e-12)
    assert (found.name, found.depth, found.camera_name, list(found.other_cameras)) == (
        "mine", 0.4, "left", ["right"])  # fmt: skip
    for name, goal in found.cameras.items():
        seen = [one.cameras[name] for one in views]
        points = found.features[f"points@{name}"]["points"]
        np.testing.assert_allclose(points, np.mean([one.corners for one in seen], axis=0))
        for key in ("m_array", "mu_array"):
            mean = np.mean([getattr(one.moments, key) for one in seen], axis=0)
            np.testing.assert_allclose(getattr(goal.moments, key), mean)


def test_a_goal_of_two_cameras_is_either_s_as_the_control_camera():
    target = the_goal("2016").target
    goal = replace(goal_of(create_scheme("points@left+points@right"), target), name="mine")
    right = goal.other_cameras["right"]
    right = replace(right, camera_name="", other_cameras={"left": goal})
    goal = replace(goal, other_cameras={"right": right})
    arms = {"left": LEFT, "right": RIGHT}
    for first, second in (("left", "right"), ("right", "left")):
        found = goal.for_cameras({first: arms[first], second: arms[second]})
        assert list(found.cameras) == [first, second] and found.target is target
        assert found.joints == goal.joints and found.features == goal.features
        for name, own in found.cameras.items():
            held = goal.cameras[name]
            assert (own.camera_name, own.joints, own.plane) == (name, goal.joints, held.plane)
            np.testing.assert_allclose(own.world_T_camera, arms[name].pose(np.zeros(6)))
            assert own.moments is held.moments and own.camera is held.camera
        assert found.other_cameras[second].other_cameras == {}
    standing = goal.for_cameras(
        {"left": arms["left"], "right": FixedCameraKinematics(RIGHT.pose(Q0))})
    assert standing.other_cameras["right"].joints == {}  # it is moved by none
    one = goal.for_cameras({"right": arms["right"]})
    assert list(one.cameras) == ["right"] and one.other_cameras == {}


def test_a_feature_of_another_camera_is_that_of_the_goal_that_it_is_asked_for():
    scheme = create_scheme("points@left+points@right")
    goal, feature = goal_of(scheme), scheme.feature.features[1]
    further = replace(goal, features={
        name: {"points": (np.array(entry["points"]) + 0.01).tolist()}
        for name, entry in goal.features.items()
    })  # fmt: skip
    seen = together(rig(), Q0)
    right = replace(seen.other_cameras["right"], plane=Plane(0.0, 0.0, 2.5))
    seen = replace(seen, other_cameras={"right": right})
    for asked, off in ((goal, 0.0), (further, -0.01), (further, -0.01), (goal, 0.0)):
        found = feature.measure(seen, asked)
        np.testing.assert_allclose(found.error, off, atol=1e-9)


def test_a_goal_of_one_camera_tells_the_others_views_by_the_target_s_geometry():
    arm, alone = the_arm(), the_goal("2016")
    wall = FixedCameraKinematics(matrix_from_xyz_rpy((0.3, 0.1, 0.9), (3.0, 0.2, -0.1)))
    goal = alone.for_cameras({"left": arm, "wall": wall})
    assert list(goal.cameras) == ["left", "wall"]
    q, there = alone.get_joints(arm.names), goal.other_cameras["wall"]
    np.testing.assert_allclose(goal.world_T_camera, arm.pose(q), atol=1e-12)
    np.testing.assert_allclose(there.world_T_camera, wall.pose(q), atol=1e-12)
    np.testing.assert_allclose(there.compute_outline(), alone.target.compute_outline(wall.pose(q)))
    assert (there.camera_name, there.joints, there.camera) == ("wall", {}, None)
    assert goal.joints == alone.joints
    unknown = replace(alone, target=None).for_cameras({"left": arm, "wall": wall})
    assert unknown.other_cameras == {}  # nothing tells what the other sees


@pytest.mark.parametrize(("right", "words"), [
    ({"namespace": "/left"}, "left and right both listen to /left/image_raw: give each"),
    ({"features": "/aras_visual_servo/camera/left"}, "left and right both listen to "
     "/aras_visual_servo/camera/left/moments"),
    ({"topic": "/right"}, "unknown parameter ~cameras.right.topic"),
])  # fmt: skip
def test_cameras_of_a_node_are_checked(right, words):
    with pytest.raises(ConfigurationError, match=words):
        ControllerSettings.from_mapping(
            {"cameras": {"left": {"namespace": "/left"}, "right": right}})


def test_cameras_of_a_node_have_topics_of_their_names():
    two = ControllerSettings.from_mapping(
        {"cameras": {"left": {"namespace": "/a/b/"}, "right": {}}})
    left, right = two.get_camera("left"), two.get_camera("right")
    assert (left.frame, left.namespace) == ("left_optical_frame", "/a/b")
    assert right.namespace == "/right" and right.features == "/aras_visual_servo/camera/right"
    alone = ControllerSettings(camera_frame="eye", namespace="/arm")
    one = alone.get_camera("camera")
    assert (one.frame, one.features) == ("eye", "/arm/camera")
    assert alone.list_cameras(create_scheme("points")) == ("camera",)
    # An arm of one camera is known without its scheme.
    arm = ControllerSettings(scheme="not_here:Theirs").make_arm(URDF.read_text())
    assert arm.camera_frame == "camera_optical_frame"


ELBOW = """<robot name="r"><link name="a"/><link name="b"/><link name="c"/>
<link name="left_optical_frame"/><link name="right_optical_frame"/><link name="wall_optical_frame"/>
<joint name="j" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
  <limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
<joint name="k" type="revolute"><parent link="b"/><child link="c"/><axis xyz="0 1 0"/>
  <limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
<joint name="l" type="fixed"><parent link="c"/><child link="left_optical_frame"/></joint>
<joint name="r" type="fixed"><parent link="b"/><child link="right_optical_frame"/></joint>
<joint name="w" type="fixed"><parent link="a"/><child link="wall_optical_frame"/>
  <origin xyz="1 2 3"/></joint></robot>"""


def test_a_camera_elsewhere_on_the_arm_is_refused_and_one_that_stands_may_be_read():
    def others(scheme):
        cameras = {name: {} for name in ("left", "right", "wall")}
        settings = ControllerSettings.from_mapping({"scheme": scheme, "cameras": cameras})
        return settings.make_other_cameras(ELBOW, settings.make_arm(ELBOW))

    for scheme, words in (
        ("points@left+points@right", "camera 'right' is moved by j and the control"),
        ("points@left+points@wall", "points@wall cannot .*is fixed, and the arm"),
    ):
        with pytest.raises(ConfigurationError, match=words):
            others(scheme)
    wall = others("stereo_points@left,wall")["wall"]
    np.testing.assert_allclose(wall.pose(np.zeros(2))[:3, 3], [1, 2, 3])
