"""Teaching: the mean view is stored with moments up to order 6; command line."""

import io
import re
import shlex
from dataclasses import replace

import numpy as np
import pytest
from loop_rig import CAMERA, CONFIG, URDF, lost, the_arm, the_goal

from aras_visual_servo_base.poses import inverse, matrix_from_xyz_rpy
from aras_visual_servo_bench.targets.target_factory import make_target
from aras_visual_servo_camera.contour import find_corners
from aras_visual_servo_camera.errors import TrackingModelError
from aras_visual_servo_controller import Arm, ConfigurationError, Feature, Goal, JointSample
from aras_visual_servo_controller.loop import teaching
from aras_visual_servo_controller.observation.camera_rig import CameraRig
from aras_visual_servo_controller.observation.feature_observer import FeatureObserver
from aras_visual_servo_controller.records.state import ServoSettings
from aras_visual_servo_controller.ros.teach_goal import main, make_goal_from_geometry
from aras_visual_servo_controller.schemes import create_scheme
from aras_visual_servo_controller.settings import ControllerSettings


def view_at(observer, stamp, joints):
    outline = the_goal("2016").target.compute_outline(the_arm().pose(joints.positions))
    return observer.observe_exact_features(stamp, CAMERA, joints, contour=outline)


class Teacher(teaching.ViewCollector):
    """Collects views of an arm that goes where it is sent, or of one that stays where it is."""

    def __init__(self, *desired, arm=None):
        arm, self.sent = arm or the_arm(), []
        self.wanted = the_goal("2016").get_joints(arm.names)
        (desired,) = desired or (self.wanted,)
        driven = [] if desired is None else [desired, self.sent.append]
        super().__init__(arm, CameraRig([FeatureObserver(arm)]), *driven)

    def feel(self, q, t):
        self.add_joint_state(the_arm().names, q, np.zeros(6), t)

    def see(self, t, lost_by=""):
        def look(joints, commands):
            seen = view_at(self.camera_rig.control, t, joints)
            return lost(seen, lost_by) if lost_by else seen

        self.add_image(t, look)

    def follow(self, begin=0.0, sag=0.0, seen=True):
        """Go for six seconds where it is sent; joints come to rest aside by `sag` (6,)."""
        q = self.sent[-1] if self.sent else np.zeros(6)
        for t in begin + 0.01 * np.arange(600):
            self.feel(q, t)
            if self.sent:
                near = np.abs(self.sent[-1] - self.wanted).max() < 0.02
                q = self.sent[-1] + sag * near
            if seen:
                self.see(t)


def test_the_pose_is_driven_to_and_what_was_seen_is_stored():
    fast = re.sub(r'velocity="[^"]*"', 'velocity="4"', URDF.read_text())
    arm, scheme = Arm.from_urdf(fast), create_scheme("moments+points")
    teacher = Teacher(arm=arm)
    teacher.camera_rig.control.needs = scheme.needs
    # where the joints really come to rest
    teacher.follow(20.0, np.array([0.0, 0.0, 0.002, -0.003, 0.0, 0.004]))
    assert teacher.is_ready and len(teacher.views) > 50
    # slowly, of joints that could be faster
    assert np.abs(np.diff(teacher.sent, axis=0)).max() == pytest.approx(0.3 * 0.01, rel=0.01)
    goal = teaching.make_mean_goal(teacher.views, scheme, arm, "mine", target_goal=the_goal("2016"))
    stored = goal.get_joints(arm.names)
    np.testing.assert_allclose(stored, teacher.views[-1].joints.positions, atol=2e-3)
    assert np.abs(stored - teacher.wanted).max() > 1e-3  # not the nominal ones
    assert goal.moments.order == 6 and len(goal.features["points"]["points"]) >= 8
    np.testing.assert_allclose(goal.world_T_camera, arm.pose(stored), atol=1e-12)
    scheme.check(goal.for_arm(arm))


def test_at_the_pose_without_images_it_is_images_that_are_missed():
    teacher = Teacher()
    teacher.feel(np.zeros(6), 0.0)
    assert "moving to" in teacher.reason
    teacher.follow(0.01, seen=False)
    assert teacher.is_ready and teacher.reason == "no images arrive"


def test_views_of_an_arm_that_was_moved_away_from_the_pose_do_not_count():
    teacher = Teacher()
    teacher.follow()
    assert teacher.is_ready and teacher.views
    count = len(teacher.sent)
    teacher.feel(teacher.wanted + 0.1 * np.eye(6)[5], 6.0)
    teacher.see(6.0)
    assert not teacher.is_ready and not teacher.views
    teacher.follow(6.01)
    assert teacher.is_ready and teacher.views
    assert np.abs(np.diff(teacher.sent[count:], axis=0)).max() < 0.01


def test_a_joint_that_hangs_is_pushed_by_the_time_that_passed_and_rests_a_second():
    """Not by how many joint states came: a gap counts as 0.1 s, a way back as none."""
    teacher = Teacher()
    hangs = teacher.wanted - [0.0, 0.0, 0.02, 0.0, 0.0, 0.03]
    for stamp in (5.0, 5.5, 5.51, 5.51, 5.4, 5.43, 9.0):
        teacher.feel(hangs, stamp)
    pushes = np.outer([0.01, 0.0, 0.0, 0.03], ServoSettings.push * (teacher.wanted - hangs))
    np.testing.assert_allclose(np.diff(teacher.sent[1:-1], axis=0), pushes, atol=1e-12)
    assert teacher.sent[-1].max() - teacher.wanted.max() < 0.1 and "waiting" in teacher.reason
    for stamp, there in ((10.0, False), (10.99, False), (11.0, True)):
        teacher.feel(teacher.wanted, stamp)
        assert teacher.is_ready is there


def test_what_a_users_feature_keeps_of_the_plane_is_told_by_the_target_s_geometry():
    class Own(Feature):
        names, tolerances, needs = ("x",), (1.0,), frozenset()
        measure = None

        def check(self, goal):
            if "own" not in goal.features:
                raise ConfigurationError("to be taught")

        def teach(self, observation):
            seen.append(observation)
            return {"own": {"plane": list(observation.plane), "stamp": observation.stamp}}

    goal, seen = replace(the_goal("2016").for_arm(the_arm()), camera=CAMERA), []
    known = teaching.complete_by_geometry(goal, Own())
    outline, (view,) = goal.target.compute_outline(goal.world_T_camera), seen
    assert abs(len(view.contour) - 400) <= len(outline) and view.camera is CAMERA
    away = np.linalg.norm(view.contour[:, None] - outline, axis=2)
    assert away.min(axis=0) == pytest.approx(0.0, abs=1e-12)  # it goes through each corner
    np.testing.assert_allclose(view.corners, find_corners(view.contour))
    np.testing.assert_array_equal(view.world_T_camera, goal.world_T_camera)
    assert known.features["own"] == {"plane": list(goal.plane), "stamp": 0.0}
    # where nothing tells the plane, and where it holds that already
    for same in (replace(goal, target=None), replace(goal, world_T_camera=None), known):
        assert teaching.complete_by_geometry(same, Own()) is same


def test_views_are_averaged():
    arm, scheme = the_arm(), create_scheme("moments")
    observer = FeatureObserver(arm, scheme.needs)
    q = the_goal("2016").get_joints(arm.names)
    views = [view_at(observer, float(i), JointSample.from_values(i, arm.names, q + off))
             for i, off in enumerate((-0.001, 0.003, 0.004))]  # fmt: skip
    numbers = np.array([np.arange(20.0), np.arange(20.0) ** 2, np.ones(20)])
    kernels = [replace(v, kernel=one) for v, one in zip(views, numbers, strict=True)]
    goal = teaching.make_mean_goal(kernels, scheme, arm, "mine", depth=0.2)
    np.testing.assert_allclose(goal.get_joints(arm.names), q + 0.002)
    np.testing.assert_allclose(goal.world_T_camera, arm.pose(q + 0.002), atol=1e-12)
    expected = np.mean([v.moments.mu_array for v in views], axis=0)
    np.testing.assert_allclose(goal.moments.mu_array, expected)
    np.testing.assert_allclose(goal.kernel.features, numbers.mean(axis=0)[16:])
    for entries, mean in (
        ([{"a": [1.0, 2.0], "b": "x"}, {"a": [3.0, 2.0], "b": "y"}], {"a": [2.0, 2.0], "b": "y"}),
        ([[1.0], [1.0, 2.0]], [1.0, 2.0]), ([None, "last"], "last"),
        ([{"a": 1.0}, {"a": 3.0, "b": 5.0}, {"a": 8.0, "b": 6.0}], {"a": 4.0, "b": 5.5}),
        ([{"p": {"q": [[1, 2]]}}, {"p": {"q": [[3, 6]]}}], {"p": {"q": [[2.0, 4.0]]}}),
    ):  # fmt: skip
        assert teaching.average_entries(entries) == mean
    with pytest.raises(ConfigurationError, match="no valid view"):
        teaching.make_mean_goal([], scheme, arm, "mine", depth=0.2)


def test_bad_views_and_bad_joints_are_not_kept():
    arm, teacher = the_arm(), Teacher(None)
    teacher.add_image(0.0, lambda *_: pytest.fail("not there yet"))
    teacher.add_joint_state(arm.names[:3], [0.0] * 3, [], 0.0)
    assert "lack" in teacher.reason
    teacher.feel(np.zeros(6), 0.0)
    for count in range(1, 5):
        teacher.see(0.1 if count == 1 else 0.2, "gone")
        assert (teacher.views, teacher.reason, teacher.refused_count) == ([], "gone", count)

    def cannot_be_taught(joints, commands):
        raise TrackingModelError("the visible outline of it")

    teacher.add_image(0.25, cannot_be_taught)
    assert (teacher.reason, teacher.refused_count) == ("the visible outline of it", 5)
    teacher.feel(teacher.wanted, 0.3)
    teacher.see(0.3)
    assert (len(teacher.views), teacher.refused_count) == (1, 0)
    driven = Teacher(np.full(6, 0.1))
    for names, count in ((arm.names[:3], 0), (arm.names, 1), (arm.names[:3], 1), (arm.names, 2)):
        driven.add_joint_state(names, np.zeros(len(names)), [], 0.4)
        assert len(driven.sent) == count
    two = teaching.ViewCollector(
        arm, CameraRig([FeatureObserver(arm, name="left"), FeatureObserver(arm, name="right")]))
    two.add_joint_state(arm.names, np.zeros(6), [], 0.0)
    two.add_image(0.0, lambda *_: pytest.fail("alone"), "left")
    assert two.reason == "no image of camera right with the same stamp arrives"


GEOMETRY = ["--geometry", str(CONFIG / "goal_2016.yaml"), "--urdf", str(URDF)]


def test_the_command_line_that_is_written_works(tmp_path, capsys):
    one, two = tmp_path / "my goal.yaml", tmp_path / "two.yaml"
    least = ["--images", "1", "--timeout", "1e-3", "--depth", "1e-3"]
    arguments = [*GEOMETRY, *least, str(one)]
    assert main(arguments) == 0
    line = one.read_text().splitlines()[1]
    assert line.startswith("# Made by: teach ")
    again = shlex.split(line.removeprefix("# Made by: teach "))
    assert again == arguments
    assert main([*again[:-1], str(two)]) == 0
    a, b = Goal.load(one), Goal.load(two)
    said = f"wrote {two}: depth {b.depth:.4f} m, area {b.moments.m00:.6f}"
    assert capsys.readouterr().out.splitlines()[1] == said
    np.testing.assert_array_equal(a.moments.mu_array, b.moments.mu_array)
    np.testing.assert_allclose(a.moments.mu_array, the_goal("2016").moments.mu_array, atol=1e-15)
    with pytest.raises(SystemExit):
        main(["--help"])
    said = capsys.readouterr().out
    assert said.startswith("usage: teach ") and "\nexample: rosrun" in said
    # each argument is explained
    assert re.findall(r"^  (\S+(?: \S+)?)\n(?! {10})", said, re.MULTILINE) == []


def test_files_are_read_and_written_in_utf_8_wherever_it_runs(tmp_path, monkeypatch):
    text_encoding, told = io.text_encoding, []
    monkeypatch.setattr(io, "text_encoding", lambda name, level=2: told.append(name) or (
        text_encoding(name, level)))  # fmt: skip
    assert main([*GEOMETRY, str(tmp_path / "größe.yaml")]) == 0
    assert len(told) >= 2 and set(told) == {"utf-8"}
    assert "größe.yaml" in (tmp_path / "größe.yaml").read_bytes().decode("utf-8")
    (latin := tmp_path / "robot.urdf").write_bytes("<!-- größe -->".encode("latin-1"))
    with pytest.raises(ConfigurationError, match="cannot read the robot description .*robot.urdf"):
        make_goal_from_geometry(CONFIG / "goal_2016.yaml", latin)


@pytest.mark.parametrize(("arguments", "words"), [
    (["--geometry", "/dev/zero", "--urdf", str(URDF)], "not a regular file"),
    (GEOMETRY[:2], "needs --urdf"),
    ([*GEOMETRY[:2], "--urdf", "/none"], "cannot read"),
    (["--depth", "0"], "--depth"),
    (["--images", "0"], "--images and --timeout have to be above 0"),
    (["--timeout", "0"], "--images and --timeout have to be above 0"),
    (GEOMETRY, "No such file"),
])  # fmt: skip
def test_what_cannot_be_taught_is_one_line(arguments, words, tmp_path, capsys):
    assert main([*arguments, str(tmp_path / "no" / "x.yaml")]) == 1
    said = capsys.readouterr().err
    assert said.startswith("teach: ") and words in said and said.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_moments_of_a_model_are_taught_with_the_plane_of_its_outline():
    box = make_target("box", (0.08, 0.05, 0.06))
    arm, q = the_arm(), the_goal("2016").get_joints(the_arm().names)
    pose = arm.pose(q)
    place = [pose[0, 3], pose[1, 3], pose[2, 3] - 0.3, 0.0, 0.0, 0.2]  # below the camera
    settings = ControllerSettings.from_mapping(
        {"scheme": "moments", "model": str(box.path), "model_start": {"pose": place}})
    scheme = settings.make_scheme()
    rig = settings.make_camera_rig({"camera": arm}, scheme)
    outline = box.outline(inverse(matrix_from_xyz_rpy(place[:3], place[3:])) @ pose)
    joints = arm.read_joints(arm.names, q)
    view = rig.control.observe_exact_features(0.0, CAMERA, joints, contour=outline)
    goal = teaching.make_mean_goal([view], scheme, arm, "mine")
    # the plane of its upper side, 0.27 m below the camera: 1/Z = A x + B y + C
    assert goal.plane == pytest.approx(pose[2, :3] / -0.27, abs=1e-6)
    assert goal.depth == pytest.approx(1.0 / goal.plane.C)
