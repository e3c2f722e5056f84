"""Goals: stored completely in a file, checked key by key, refused if they do not fit."""

import re
from dataclasses import replace

import numpy as np
import pytest
import yaml
from loop_rig import CAMERA, CONFIG, URDF, the_arm, the_goal
from scipy.spatial.transform import Rotation

from aras_visual_servo_base.poses import matrix_from_xyz_rpy, pose_difference
from aras_visual_servo_camera.errors import TrackingModelError
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.kernel import compute_outline_kernel_features
from aras_visual_servo_camera.moments import Moments, Pinhole
from aras_visual_servo_controller import Arm, FeatureObserver, Goal, JointSample, Points
from aras_visual_servo_controller.errors import (
    ConfigurationError,
    ServoError,
    UnreachableError,
)
from aras_visual_servo_controller.goals.goal_file import GoalKernel
from aras_visual_servo_controller.observation import target_geometry
from aras_visual_servo_controller.schemes import create_scheme

TargetGeometry = target_geometry.TargetGeometry


def mapping(**changes):
    return {**yaml.safe_load((CONFIG / "goal_2016.yaml").read_text()), **changes}


@pytest.mark.parametrize("year", ["2015", "2016"])
def test_the_shipped_goals_are_what_an_exact_camera_sees(year):
    goal = Goal.load(CONFIG / f"goal_{year}.yaml")
    assert goal.moments.order == 6
    assert not (goal.kernel.K.flags.writeable or goal.kernel.features.flags.writeable)  # shared
    fitted = goal.for_arm(the_arm())
    again = fitted.predict_from_pose(fitted.world_T_camera)
    np.testing.assert_allclose(again.moments.m_array, goal.moments.m_array, rtol=1e-6, atol=1e-12)
    assert again.depth == pytest.approx(goal.depth, rel=1e-6)
    np.testing.assert_allclose(again.plane, goal.plane, atol=1e-6)
    np.testing.assert_allclose(again.kernel.features, goal.kernel.features, rtol=1e-3)


def taught():
    scheme = create_scheme("points+moments")
    goal = the_goal("2016")
    names = the_arm().names
    joints = JointSample.from_values(1.0, names, goal.get_joints(names) + 0.01)
    observer = FeatureObserver(the_arm(), scheme.needs)
    outline = goal.target.compute_outline(the_arm().pose(joints.positions))
    seen = observer.observe_exact_features(1.0, CAMERA, joints, contour=outline)
    return scheme, seen, Goal.teach(scheme, seen, "mine", depth=0.2, target=goal.target)


def test_what_was_seen_is_what_is_taught_and_survives_a_file():
    scheme, seen, goal = taught()
    text = goal.to_yaml("a heading\nof two lines")
    assert text.startswith("# a heading\n# of two lines\n")
    back = Goal.from_mapping(yaml.safe_load(text), "mine")
    assert back.joints == dict(zip(the_arm().names, seen.joints.positions, strict=True))
    np.testing.assert_allclose(back.moments.m_array, seen.moments.m_array, rtol=1e-15)
    np.testing.assert_allclose(back.features["points"]["points"], seen.corners)
    np.testing.assert_allclose(back.world_T_camera, seen.world_T_camera, atol=1e-12)
    assert (back.depth, back.camera) == (0.2, CAMERA)
    scheme.check(back.for_arm(the_arm()))
    for seen_now, depth, words in (
        (replace(seen, valid=False, reason="gone"), 0.2, "not detected: gone"),
        (seen, None, "give the depth"), (replace(seen, corners=None), 0.2, "no corners"),
    ):
        with pytest.raises(ConfigurationError, match=words):
            Goal.teach(scheme, seen_now, depth=depth)

    class Own(Points):
        def teach(self, observation):
            raise TrackingModelError("no plane fits the outline")

    with pytest.raises(ConfigurationError, match=r"^mine: no plane fits the outline$"):
        Goal.teach(Own(), seen, "mine", depth=0.2)


def test_every_number_of_a_goal_is_in_its_file():
    K = (301.5, 0.25, 160.5, 0.0, 202.5, 121.5, 0.0, 0.0, 1.0)
    other = Goal("goal: cameras.right", depth=0.7, plane=Plane(0.1, -0.2, 1.5), camera_name="right",
                 world_T_camera=matrix_from_xyz_rpy((0.4, 0.5, -0.6), (0.1, 0.2, 0.3)))  # fmt: skip
    goal = Goal(
        "goal", {"a": 0.1, "b": -0.2}, matrix_from_xyz_rpy((0.1, -0.2, 0.3), (0.4, 0.5, -0.6)), 0.8,
        Plane(0.2, 0.3, 1.25), Moments.from_polygon(np.array([[0.0, 0], [2, 0], [1, 3]]) / 9, 5),
        GoalKernel(320, 240, np.reshape(K, (3, 3)), np.array([1.5, 2.5, 3.5, -0.4])),
        replace(CAMERA, K=(30.5, 0, 31.5, 0, 40.5, 23.5, 0, 0, 1), D=(0.1, -0.2, 0.01, 0.02)),
        {"own": {"text": "x", "points": [[1.0, 2.0]], "n": 3}},
        TargetGeometry.from_values(BOX.copy(), 0.001, 0.012),
        matrix_from_xyz_rpy((0.7, 0.8, 0.9), (-0.1, -0.2, -0.3)), "left", {"right": other})
    text = goal.to_yaml()
    assert text.startswith("joints:")
    back = Goal.from_mapping(yaml.safe_load(text))
    for made, kept in ((goal, back), (other, back.other_cameras["right"])):
        for name in ("name", "camera_name", "joints", "depth", "plane", "camera", "features"):
            assert getattr(kept, name) == getattr(made, name)
        np.testing.assert_allclose(kept.world_T_camera, made.world_T_camera, atol=1e-12)
    np.testing.assert_allclose(back.mounting, goal.mounting, atol=1e-12)
    assert back.target.to_mapping() == goal.target.to_mapping()
    assert (back.kernel.width, back.kernel.height) == (320, 240)
    for name in ("K", "features"):
        np.testing.assert_array_equal(getattr(back.kernel, name), getattr(goal.kernel, name))
    assert (back.moments.order, back.moments.kind) == (5, goal.moments.kind)
    for name in ("m_array", "mu_array"):
        kept = getattr(back.moments, name)
        np.testing.assert_allclose(kept, getattr(goal.moments, name), atol=1e-15)
    assert Goal().to_yaml("two\nlines") == "# two\n# lines\n{}\n"
    for made in (Goal.from_mapping({}), Goal()):
        rest = ("world_T_camera", "depth", "plane", "moments", "kernel", "camera", "target")
        assert all(getattr(made, name) is None for name in (*rest, "mounting"))
        assert (made.name, made.joints, made.features) == ("goal", {}, {})
        assert made.other_cameras == {} and list(made.cameras) == [made.camera_name] == ["camera"]


WRONG = {
    "depth 0": ({"depth": 0.0}, "depth is 0.0, must be >= 0.001 m: is it in metres"),
    "depth mm": ({"depth": 191.7}, "depth is 191.7, must be <= 100 m: is it in metres"),
    "plane 0": ({"plane": [0.0, 0.0, 0.0]}, "C, the last number of plane, is 0, must be 1/Z"),
    "plane behind": ({"plane": [0.0, 0.0, -5.0]}, "C, the last number of plane, is -5"),
    "plane aslant": ({"plane": [0.0, 101.0, 5.0]}, "the camera looks parallel to plane"),
    "order": ({"moments": {"order": 9, "m": [], "mu": []}}, "moments.order is 9, must be <= 6"),
    "few": ({"moments": {"order": 1, "m": [1.0], "mu": [1, 0, 0]}}, "moments.m must be 3"),
    "empty": ({"moments": {"order": 1, "m": [0, 0, 0], "mu": [0, 0, 0]}}, "must be positive"),
    "huge": ({"moments": {"order": 1, "m": [1, 1e308, 0], "mu": [1, 0, 0]}}, "implausible"),
    "kernel": ({"kernel": {"width": 1}}, "kernel.height is missing: give a whole number"),
    "camera": ({"camera": {"width": 1, "height": 1, "K": [0] * 9}}, "goal"),
    "features": ({"features": {"points": 3}}, "features.points is 3, must be a mapping"),
    "target": ({"target": {"boxes": [[[0, 0, 0], [0, 1, 1]]]}}, "lowest"),
}


@pytest.mark.parametrize("name", WRONG)
def test_files_that_are_wrong_are_one_line(name):
    changes, words = WRONG[name]
    with pytest.raises(ConfigurationError, match=words) as caught:
        Goal.from_mapping(mapping(**changes))
    assert "\n" not in str(caught.value)
    for depth in (0.001, 100.0):  # at their bounds they are taken
        assert Goal.from_mapping({"depth": depth}).depth == depth
    for plane in ([0.0, 0.0, 0.01], [0.0, 0.0, 1000.0], [0.0, 99.0, 5.0], [-99.0, 0.0, 5.0],
                  [9975.0**0.5, 0.0, 5.0]):  # whose length is 100
        assert list(Goal.from_mapping({"plane": plane}).plane) == plane


def test_a_goal_for_a_camera_mounted_elsewhere():
    text = URDF.read_text()
    joint = re.search(r'<joint name="camera_joint".*?</joint>', text, re.S)[0]
    origin = re.search(r"<origin[^>]*/>", joint)[0]
    elsewhere = joint.replace(origin, '<origin xyz="0 0.03 0.0334" rpy="3.14 -1.4 0"/>')
    arm = Arm.from_urdf(text.replace(joint, elsewhere))
    goal = Goal.load(CONFIG / "goal_2016.yaml")
    moved, pose = goal.for_arm(arm), arm.pose(goal.get_joints(arm.names))
    assert "camera moved" in moved.name
    np.testing.assert_allclose(moved.world_T_camera, pose)
    assert pose_difference(pose, goal.world_T_camera)[0] > 0.02
    exact = goal.target.compute_outline(pose)
    np.testing.assert_allclose(moved.moments.m_array, Moments.from_polygon(exact, 6).m_array)
    assert np.abs(moved.kernel.features / goal.kernel.features - 1.0).max() > 0.05
    back = moved.predict_from_pose(goal.world_T_camera).kernel.features
    np.testing.assert_allclose(back, goal.kernel.features, rtol=1e-3)
    short = replace(goal.kernel, width=300, height=110)  # a picture that cuts some of it off
    cut = replace(goal, kernel=short).predict_from_pose(goal.world_T_camera).kernel
    whole = goal.target.compute_outline(goal.world_T_camera)
    seen = compute_outline_kernel_features(whole, Pinhole.from_K(short.K), 300, 110).values
    np.testing.assert_array_equal(cut.features, seen)
    assert seen[2] < 0.95 * goal.kernel.features[2] and (cut.width, cut.height) == (300, 110)
    # what was taught is of the view it was taught from
    taught = replace(goal, mounting=np.eye(4), features={"points": {}}).for_arm(arm)
    assert taught.mounting is None and not taught.features
    with pytest.raises(ConfigurationError, match="another mounting.*teach the goal again"):
        replace(goal, target=None).for_arm(arm)


def test_a_pose_that_is_the_joints_to_a_rounding_is_exactly_theirs():
    goal = the_goal("2016")
    near = goal.world_T_camera @ matrix_from_xyz_rpy((5e-5, -3e-5, 2e-5), (2e-4, -1e-4, 0.0))
    for known in (near, None):
        again = replace(goal, world_T_camera=known, target=None).for_arm(the_arm())
        np.testing.assert_array_equal(again.world_T_camera, goal.world_T_camera)
    for off, turn in ((1.2e-4, 0.0), (0.0, 1.2e-3)):  # more than a tenth of a millimetre, a mrad
        moved = goal.world_T_camera @ matrix_from_xyz_rpy((off, 0.0, 0.0), (0.0, turn, 0.0))
        with pytest.raises(ConfigurationError, match="another mounting"):
            replace(goal, world_T_camera=moved, target=None).for_arm(the_arm())


def test_the_posture_of_a_goal_is_its_joints_or_found_for_its_pose():
    arm, goal = the_arm(), the_goal("2016")
    np.testing.assert_array_equal(goal.find_posture(arm), goal.get_joints(arm.names))
    by_pose = replace(goal, joints={})
    found = by_pose.find_posture(arm)
    np.testing.assert_allclose(arm.pose(found), goal.world_T_camera, atol=3e-3)
    away = matrix_from_xyz_rpy((9.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    with pytest.raises(UnreachableError):
        replace(by_pose, world_T_camera=away).find_posture(arm)
    assert replace(by_pose, world_T_camera=None).find_posture(arm) is None


UP, ASIDE = (matrix_from_xyz_rpy(xyz, (0.0, 0.0, 0.0)) for xyz in ((0, 0, 1.0), (3.0, 0, 0)))
LEVEL = Goal(world_T_camera=matrix_from_xyz_rpy((0, 0, 1.0), (np.pi / 2, 0, 0)), depth=0.2)


@pytest.mark.parametrize(("use", "words"), [
    (lambda goal: replace(goal, joints={"J6": 0.0, "J1": 0.0}).for_arm(the_arm()),
     r"no value for the joint\(s\) gantry, J2"),
    (lambda goal: replace(goal, joints={**goal.joints, "J2": 9.0}).for_arm(the_arm()),
     "J2 at 9.0000, outside the joint's limits"),
    (lambda goal: LEVEL.make_level_plane(), "parallel to the table"),
    (lambda goal: Goal().predict_from_pose(np.eye(4)), "does not contain the target's geometry"),
    (lambda goal: goal.predict_from_pose(UP),  # looks up
     r"not visible from this pose .* mounting \(camera_xyz, camera_rpy\), or teach the goal"),
    (lambda goal: goal.predict_from_pose(ASIDE @ goal.world_T_camera),
     "not visible .*there is no target.*mounting"),
])  # fmt: skip
def test_goals_that_do_not_fit_the_arm(use, words):
    with pytest.raises(ConfigurationError, match=words):
        use(Goal.load(CONFIG / "goal_2016.yaml"))


def test_targets_geometry():
    box = TargetGeometry.from_mapping({"boxes": [[[-0.1, -0.05, 0.0], [0.1, 0.05, 0.01]]]})
    assert box.surface == 0.01
    above = matrix_from_xyz_rpy((0.0, 0.0, 1.01), (np.pi, 0.0, 0.0))
    assert box.compute_depth(above) == pytest.approx(1.0)
    np.testing.assert_allclose(box.compute_plane(above), (0.0, 0.0, 1.0), atol=1e-12)
    outline = box.compute_outline(above)
    assert np.abs(outline).max(axis=0) == pytest.approx([0.1, 0.05], rel=1e-9)
    again = TargetGeometry.from_mapping(yaml.safe_load(yaml.safe_dump(box.to_mapping())))
    assert again.to_mapping() == box.to_mapping() and again.ground == -np.inf
    for behind in (matrix_from_xyz_rpy((0.0, 0.0, -1.0), (np.pi, 0.0, 0.0)),
                   matrix_from_xyz_rpy((0.0, 0.0, 0.2), (0.5 * np.pi, 0.0, 0.0)),  # half of it
                   np.eye(4)):  # its bottom in the camera's centre
        with pytest.raises(ServoError, match="behind the camera"):
            box.compute_outline(behind)
    apart = {"boxes": [[[0, 0, 0], [0.1, 0.1, 0.01]], [[0.5, 0.5, 0], [0.6, 0.6, 0.01]]]}
    with pytest.raises(ServoError, match="do not overlap"):
        TargetGeometry.from_mapping(apart).compute_outline(above)
    for shape in ((1, 3, 3), (2, 3), (3, 2, 3), (0, 2, 3)):
        with pytest.raises(ConfigurationError, match="one or two pairs of corners"):
            TargetGeometry.from_values(np.zeros(shape), 0.0, 0.0)


def test_where_only_moments_are_known_the_outline_is_the_ellipse_that_has_them():
    known = the_goal("2016").for_arm(the_arm())
    exact = known.target.compute_outline(known.world_T_camera)
    np.testing.assert_array_equal(known.compute_outline(), exact)
    turn = np.radians(25.0)
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    box = np.array([[-0.3, -0.1], [0.3, -0.1], [0.3, 0.1], [-0.3, 0.1]]) @ R.T + [0.05, -0.02]
    goal = replace(known, target=None, moments=Moments.from_polygon(box, 4))
    seen = Moments.from_polygon(goal.compute_outline(), 2)
    assert (seen.xg, seen.yg) == pytest.approx((0.05, -0.02))
    # a polygon of 32 corners is a little smaller than its ellipse
    spread, expected = ([m.mu(i, 2 - i) / m.m00 for i in range(3)] for m in (seen, goal.moments))
    assert spread == pytest.approx(expected, rel=0.03)
    assert replace(goal, moments=None).compute_outline().shape == (0, 2)


BOX = np.array([[[-0.1, -0.05, 0.0], [0.1, 0.05, 0.01]]])


def test_a_box_has_a_size_and_finite_numbers_which_may_be_whole():
    for corner, ground, surface, words in (
        ([np.inf, 0.1, 0.1], 0.0, 0.0, "not finite"), ([0.1, 0.1, 0.1], np.nan, 0.0, "not finite"),
        ([0.1, 0.1, 0.1], 0.0, np.nan, "not finite"), ([0.1, 0.1, 0.1], 0.0, np.inf, "not finite"),
        ([0.1, -0.05, 0.1], 0.0, 0.0, "first corner of a box must have its lowest"),
        ([0.1, 0.1, -0.1], 0.0, 0.0, "first corner of a box must have its lowest"),
    ):  # fmt: skip
        boxes = BOX.copy()
        boxes[0, 1] = corner
        with pytest.raises(ConfigurationError, match=f"mine: .*{words}"):
            TargetGeometry.from_values(boxes, ground, surface, "mine")
    boxes = np.array([[[-1, -1, 0], [1, 1, 1]]])
    box = TargetGeometry.from_values(boxes, 0, 1)
    above = np.array([[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 3], [0, 0, 0, 1]])
    assert np.abs(box.compute_outline(above)).max(axis=0) == pytest.approx([0.5, 0.5])
    boxes[:] = 0  # the caller's array stays the caller's
    assert box.boxes.tolist() == [[[-1, -1, 0], [1, 1, 1]]]
    # What stands in the ground is not seen: from the side, 0.5 m off, from the ground on.
    box = TargetGeometry.from_values(np.array([[[-0.1, -0.05, -0.2], [0.1, 0.05, 0.3]]]), 0.1, 0.3)
    to_x = np.array([[0.0, 0, 1, -0.6], [-1, 0, 0, 0], [0, -1, 0, 0.1], [0, 0, 0, 1]])
    low, high = np.sort(box.compute_outline(to_x)[:, 1])[[0, -1]]
    assert (low, high) == pytest.approx((-0.2 / 0.5, 0.0), abs=1e-12)


def test_the_depth_is_that_along_a_leaning_axis():
    box = TargetGeometry.from_values(BOX.copy(), -np.inf, 0.02)
    pose = matrix_from_xyz_rpy((0.1, -0.2, 0.7), (np.pi - 0.5, 0.3, 0.2))
    axis = Rotation.from_euler("xyz", (np.pi - 0.5, 0.3, 0.2)).apply((0.0, 0.0, 1.0))
    depth = box.compute_depth(pose)
    assert 0.7 + depth * axis[2] == pytest.approx(0.02) and depth > 0.75
    across, down, ahead = box.compute_plane(pose)
    assert ahead == pytest.approx(1.0 / depth) and min(abs(across), abs(down)) > 0.1
    along = np.array([[0.0, 0, 1, -1], [0, 1, 0, 0], [-1, 0, 0, 0.3], [0, 0, 0, 1]])
    inside = matrix_from_xyz_rpy((0.1, 0.2, 0.02), (np.pi, 0.0, 0.0))
    for pose in (along, inside, matrix_from_xyz_rpy((0.0, 0.0, 1.0), (0.0, 0.0, 0.0))):
        with pytest.raises(ServoError, match="does not look at the target's plane"):
            box.compute_depth(pose)
    with pytest.raises(ServoError, match="lies in the target's plane"):
        box.compute_plane(inside)


def area(polygon):
    x, y = polygon.T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def test_hulls_and_unions_of_polygons():
    grid = [(0.5 * i, 0.25 * j) for i in range(4) for j in range(3)]
    hull = target_geometry.convex_hull(np.array(grid)[::-1])  # no corners within its sides
    assert sorted(map(tuple, hull)) == [(0.0, 0.0), (0.0, 0.5), (1.5, 0.0), (1.5, 0.5)]
    assert area(hull) == 0.75
    # A cross, whose edges cross eight times, and a corner that sticks into a rectangle.
    wide = np.array([[-3.0, -1], [3, -1], [3, 1], [-3, 1]])
    tall = np.array([[-0.5, -2.0], [1, -2], [1, 2.5], [-0.5, 2.5]])
    cross = target_geometry.unite_star_shapes(wide, tall)
    assert len(cross) == 12 and area(cross) == pytest.approx(12.0 + 1.5 * 4.5 - 1.5 * 2.0)
    inner = {(x, y) for x in (-0.5, 1.0) for y in (-1.0, 1.0)}
    assert {tuple(p) for p in cross.round(9)} == inner | {tuple(p) for p in np.vstack([wide, tall])}
    corner = target_geometry.unite_star_shapes(wide, np.array([[2.0, 0], [4, 0], [4, 3], [2, 3]]))
    assert len(corner) == 8 and area(corner) == pytest.approx(12.0 + 6.0 - 1.0)
    with pytest.raises(ServoError, match="do not overlap"):
        target_geometry.unite_star_shapes(wide, tall + [9.0, 0.0])


def test_a_goal_file_that_has_changed_is_read_again(tmp_path):
    path = tmp_path / "goal.yaml"
    for depth in (0.2, 0.3):
        path.write_text(f"depth: {depth}\n")
        goal = Goal.load(path)
        assert goal.depth == depth and Goal.load(path) is goal
