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
from aras_visual_servo_controller.errors import ConfigurationError
from aras_visual_servo_controller.features import Feature
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.kinematics import Arm
from aras_visual_servo_controller.kinematics.joint_sample import JointSample
from aras_visual_servo_controller.loop.teaching import (
    ViewCollector,
    average_entries,
    complete_by_geometry,
    make_mean_goal,
)
from aras_visual_servo_controller.observation.camera_rig import CameraRig
from aras_visual_servo_controller.observation.feature_observer import FeatureObserver
from aras_visual_servo_controller.records.state import ServoSettings
from aras_visual_servo_controller.ros.teach_goal import main, make_goal_from_geometry
from aras_visual_servo_controller.schemes import create_scheme
from aras_visual_servo_controller.settings import ControllerSettings


def view_at(observer, stamp, joints):
    outline = the_goal("2016").target.compute_outline(the_arm().pose(joints.positions))
    return observer.observe_exact_features(stamp, CAMERA, joints, contour=outline)


def test_the_pose_is_driven_to_and_what_was_seen_is_stored():
    fast = re.sub(r'velocity="[^"]*"', 'velocity="4"', URDF.read_text())
    arm, scheme = Arm.from_urdf(fast), create_scheme("moments+points")
    wanted = the_goal("2016").get_joints(arm.names)
    sent, q = [], np.zeros(6)
    teacher = ViewCollector(
        arm, CameraRig([FeatureObserver(arm, scheme.needs)]), wanted, sent.append
    )
    sag = np.array([0.0, 0.0, 0.002, -0.003, 0.0, 0.004])  # where the joints really come to rest
    for i in range(600):
        t = 20.0 + 0.01 * i
        teacher.add_joint_state(arm.names, q, np.zeros(6), t)
        if sent:
            q = sent[-1] + sag if np.abs(sent[-1] - wanted).max() < 0.02 else sent[-1]
        teacher.add_image(
            t, lambda joints, commands, t=t: view_at(teacher.camera_rig.control, t, joints)
        )
    assert teacher.is_ready
    assert len(teacher.views) > 50
    # slowly, of joints that could be faster
    assert np.abs(np.diff(sent, axis=0)).max() == pytest.approx(0.3 * 0.01, rel=0.01)
    goal = make_mean_goal(teacher.views, scheme, arm, "mine", target_goal=the_goal("2016"))
    stored = goal.get_joints(arm.names)
    np.testing.assert_allclose(stored, teacher.views[-1].joints.positions, atol=2e-3)
    assert np.abs(stored - wanted).max() > 1e-3  # not the nominal ones
    assert goal.moments.order == 6
    assert len(goal.features["points"]["points"]) >= 8
    np.testing.assert_allclose(goal.world_T_camera, arm.pose(stored), atol=1e-12)
    scheme.check(goal.for_arm(arm))


def test_at_the_pose_without_images_it_is_images_that_are_missed():
    arm, sent, reasons = the_arm(), [], []
    wanted = the_goal("2016").get_joints(arm.names)
    teacher = ViewCollector(arm, CameraRig([FeatureObserver(arm)]), wanted, sent.append)
    for i in range(600):
        teacher.add_joint_state(arm.names, sent[-1] if sent else np.zeros(6), np.zeros(6), 0.01 * i)
        reasons.append(teacher.reason)
    assert teacher.is_ready
    assert "moving to" in reasons[0] and reasons[-1] == "no images arrive"


def test_views_of_an_arm_that_was_moved_away_from_the_pose_do_not_count():
    arm, sent = the_arm(), []
    wanted = the_goal("2016").get_joints(arm.names)
    teacher = ViewCollector(arm, CameraRig([FeatureObserver(arm)]), wanted, sent.append)

    def step(t, q):
        teacher.add_joint_state(arm.names, q, np.zeros(6), t)
        teacher.add_image(
            t, lambda joints, commands: view_at(teacher.camera_rig.control, t, joints)
        )

    for i in range(600):
        step(0.01 * i, sent[-1] if sent else np.zeros(6))
    assert teacher.is_ready and teacher.views
    count = len(sent)
    step(6.0, wanted + 0.1 * np.eye(6)[5])
    assert not teacher.is_ready and not teacher.views
    for i in range(600):
        step(6.01 + 0.01 * i, sent[-1])
    assert teacher.is_ready and teacher.views
    assert np.abs(np.diff(sent[count:], axis=0)).max() < 0.01


def test_a_joint_that_hangs_is_pushed_by_the_time_that_passed_and_rests_a_second():
    """Not by how many joint states came: a gap counts as 0.1 s, a way back as none."""
    arm, sent = the_arm(), []
    wanted = the_goal("2016").get_joints(arm.names)
    teacher = ViewCollector(arm, CameraRig([FeatureObserver(arm)]), wanted, sent.append)
    hangs = wanted - [0.0, 0.0, 0.02, 0.0, 0.0, 0.03]
    for stamp in (5.0, 5.5, 5.51, 5.51, 5.4, 5.43, 9.0):
        teacher.add_joint_state(arm.names, hangs, np.zeros(6), stamp)
    pushes = np.outer([0.01, 0.0, 0.0, 0.03], ServoSettings.push * (wanted - hangs))
    np.testing.assert_allclose(np.diff(sent[1:-1], axis=0), pushes, atol=1e-12)
    assert sent[-1].max() - wanted.max() < 0.1 and "waiting" in teacher.reason
    for stamp, there in ((10.0, False), (10.99, False), (11.0, True)):
        teacher.add_joint_state(arm.names, wanted, np.zeros(6), stamp)
        assert teacher.is_ready is there


def test_what_a_users_feature_keeps_of_the_plane_is_told_by_the_target_s_geometry():
    class Own(Feature):
        names, tolerances, needs = ("x",), (1.0,), frozenset()

        def measure(self, observation, goal):
            raise NotImplementedError

        def check(self, goal):
            if "own" not in goal.features:
                raise ConfigurationError("to be taught")

        def teach(self, observation):
            seen.append(observation)
            return {"own": {"plane": list(observation.plane), "stamp": observation.stamp}}

    goal, seen = replace(the_goal("2016").for_arm(the_arm()), camera=CAMERA), []
    known = complete_by_geometry(goal, Own())
    outline = goal.target.compute_outline(goal.world_T_camera)
    assert abs(len(seen[0].contour) - 400) <= len(outline)
    away = np.linalg.norm(seen[0].contour[:, None] - outline, axis=2)
    assert away.min(axis=0) == pytest.approx(0.0, abs=1e-12)  # it goes through each corner
    np.testing.assert_allclose(seen[0].corners, find_corners(seen[0].contour))
    np.testing.assert_array_equal(seen[0].world_T_camera, goal.world_T_camera)
    assert seen[0].camera is CAMERA
    for unknown in (replace(goal, target=None), replace(goal, world_T_camera=None)):
        assert complete_by_geometry(unknown, Own()) is unknown
    assert known.features["own"] == {"plane": list(goal.plane), "stamp": 0.0}
    assert complete_by_geometry(known, Own()) is known  # it holds that already


def test_views_are_averaged():
    arm, scheme = the_arm(), create_scheme("moments")
    observer = FeatureObserver(arm, scheme.needs)
    q = the_goal("2016").get_joints(arm.names)
    views = []
    for i, off in enumerate((-0.001, 0.003, 0.004)):
        views.append(view_at(observer, float(i), JointSample.from_values(i, arm.names, q + off)))
    goal = make_mean_goal(views, scheme, arm, "mine", depth=0.2)
    np.testing.assert_allclose(goal.get_joints(arm.names), q + 0.002)
    np.testing.assert_allclose(goal.world_T_camera, arm.pose(q + 0.002), atol=1e-12)
    expected = np.mean([v.moments.mu_array for v in views], axis=0)
    np.testing.assert_allclose(goal.moments.mu_array, expected)
    numbers = np.array([np.arange(20.0), np.arange(20.0) ** 2, np.ones(20)])
    kernels = [replace(v, kernel=one) for v, one in zip(views, numbers, strict=True)]
    found = make_mean_goal(kernels, scheme, arm, "mine", depth=0.2).kernel.features
    np.testing.assert_allclose(found, numbers.mean(axis=0)[16:])
    assert average_entries([{"a": [1.0, 2.0], "b": "x"}, {"a": [3.0, 2.0], "b": "y"}]) == {
        "a": [2.0, 2.0], "b": "y",
    }  # fmt: skip
    assert average_entries([[1.0], [1.0, 2.0]]) == [1.0, 2.0]
    lacking = [{"a": 1.0}, {"a": 3.0, "b": 5.0}, {"a": 8.0, "b": 6.0}]
    assert average_entries(lacking) == {"a": 4.0, "b": 5.5}
    nested = average_entries([{"p": {"q": [[1, 2]]}}, {"p": {"q": [[3, 6]]}}])
    assert nested == {"p": {"q": [[2.0, 4.0]]}}
    assert average_entries([None, "last"]) == "last"
    with pytest.raises(ConfigurationError, match="no valid view"):
        make_mean_goal([], scheme, arm, "mine", depth=0.2)


def test_bad_views_and_bad_joints_are_not_kept():
    arm = the_arm()
    teacher = ViewCollector(arm, CameraRig([FeatureObserver(arm)]))
    teacher.add_image(0.0, lambda *_: pytest.fail("not there yet"))
    teacher.add_joint_state(arm.names[:3], [0.0] * 3, [], 0.0)
    assert "lack" in teacher.reason
    teacher.add_joint_state(arm.names, np.zeros(6), [], 0.0)
    teacher.add_image(
        0.1, lambda joints, _: lost(view_at(teacher.camera_rig.control, 0.1, joints), "gone")
    )
    assert (teacher.views, teacher.reason, teacher.refused_count) == ([], "gone", 1)
    for _ in range(3):
        gone = lambda joints, _: lost(view_at(teacher.camera_rig.control, 0.2, joints), "gone")  # noqa: E731
        teacher.add_image(0.2, gone)
    assert teacher.refused_count == 4
    teacher.add_joint_state(arm.names, the_goal("2016").get_joints(arm.names), [], 0.3)
    teacher.add_image(0.3, lambda joints, _: view_at(teacher.camera_rig.control, 0.3, joints))
    assert (len(teacher.views), teacher.refused_count) == (1, 0)
    sent = []
    driven = ViewCollector(arm, teacher.camera_rig, np.full(6, 0.1), sent.append)
    for names, count in ((arm.names[:3], 0), (arm.names, 1), (arm.names[:3], 1), (arm.names, 2)):
        driven.add_joint_state(names, np.zeros(len(names)), [], 0.4)
        assert len(sent) == count
    two = ViewCollector(
        arm, CameraRig([FeatureObserver(arm, name="left"), FeatureObserver(arm, name="right")])
    )
    two.add_joint_state(arm.names, np.zeros(6), [], 0.0)
    two.add_image(0.0, lambda *_: pytest.fail("alone"), "left")
    assert two.reason == "no image of camera right with the same stamp arrives"


def test_the_command_line_that_is_written_works(tmp_path, capsys):
    one, two = tmp_path / "my goal.yaml", tmp_path / "two.yaml"
    least = ["--images", "1", "--timeout", "1e-3", "--depth", "1e-3"]
    given = ["--geometry", str(CONFIG / "goal_2016.yaml"), "--urdf", str(URDF)]
    arguments = [*given, *least, str(one)]
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


def test_files_are_read_and_written_in_utf_8_wherever_it_runs(tmp_path, monkeypatch):
    text_encoding, told = io.text_encoding, []
    monkeypatch.setattr(io, "text_encoding", lambda name, level=2: told.append(name) or (
        text_encoding(name, level)))  # fmt: skip
    given = ["--geometry", str(CONFIG / "goal_2016.yaml"), "--urdf", str(URDF)]
    assert main([*given, str(tmp_path / "größe.yaml")]) == 0
    assert len(told) >= 2 and set(told) == {"utf-8"}
    assert "größe.yaml" in (tmp_path / "größe.yaml").read_bytes().decode("utf-8")
    (latin := tmp_path / "robot.urdf").write_bytes("<!-- größe -->".encode("latin-1"))
    with pytest.raises(ConfigurationError, match="cannot read the robot description .*robot.urdf"):
        make_goal_from_geometry(CONFIG / "goal_2016.yaml", latin)


def test_its_help_says_what_each_argument_is(capsys):
    with pytest.raises(SystemExit):
        main(["--help"])
    said = capsys.readouterr().out
    assert said.startswith("usage: teach ") and "\nexample: rosrun" in said
    assert re.findall(r"^  (\S+(?: \S+)?)\n(?! {10})", said, re.MULTILINE) == []


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--geometry", "/dev/zero", "--urdf", str(URDF)], "not a regular file"),
        (["--geometry", str(CONFIG / "goal_2016.yaml")], "needs --urdf"),
        (["--geometry", str(CONFIG / "goal_2016.yaml"), "--urdf", "/none"], "cannot read"),
        (["--depth", "0"], "--depth"),
        (["--images", "0"], "--images and --timeout have to be above 0"),
        (["--timeout", "0"], "--images and --timeout have to be above 0"),
        (["--geometry", str(CONFIG / "goal_2016.yaml"), "--urdf", str(URDF)], "No such file"),
    ],
)
def test_what_cannot_be_taught_is_one_line(arguments, words, tmp_path, capsys):
    assert main([*arguments, str(tmp_path / "no" / "x.yaml")]) == 1
    said = capsys.readouterr().err
    assert said.startswith("teach: ")
    assert words in said
    assert said.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_view_that_cannot_be_taught_is_refused_with_its_reason():
    arm = the_arm()
    teacher = ViewCollector(arm, CameraRig([FeatureObserver(arm)]))
    teacher.add_joint_state(arm.names, np.zeros(6), np.zeros(6), 0.0)

    def look(joints, commands):
        raise TrackingModelError("the visible outline of it")

    teacher.add_image(0.0, look)
    teacher.add_image(0.1, look)
    assert (teacher.views, teacher.refused_count) == ([], 2)
    assert teacher.reason == "the visible outline of it"


def test_moments_of_a_model_are_taught_with_the_plane_of_its_outline():
    box = make_target("box", (0.08, 0.05, 0.06))
    arm, q = the_arm(), the_goal("2016").get_joints(the_arm().names)
    pose = arm.pose(q)
    place = [pose[0, 3], pose[1, 3], pose[2, 3] - 0.3, 0.0, 0.0, 0.2]  # below the camera
    given = {"scheme": "moments", "model": str(box.path), "model_start": {"pose": place}}
    settings = ControllerSettings.from_mapping(given)
    scheme = settings.make_scheme()
    rig = settings.make_camera_rig({"camera": arm}, scheme)
    outline = box.outline(inverse(matrix_from_xyz_rpy(place[:3], place[3:])) @ pose)
    joints = arm.read_joints(arm.names, q)
    view = rig.control.observe_exact_features(0.0, CAMERA, joints, contour=outline)
    goal = make_mean_goal([view], scheme, arm, "mine")
    upper = pose[2, 3] - 0.3 + 0.03
    assert goal.plane == pytest.approx(goal_plane(pose, upper), abs=1e-6)
    assert goal.depth == pytest.approx(1.0 / goal.plane.C)


def goal_plane(pose, height):
    """Return the plane z = height in the camera frame, 1/Z = A x + B y + C."""
    return pose[2, :3] / (height - pose[2, 3])
