"""Parameters of the controller: each is listed once, checked, and used."""

import re
import sys
from dataclasses import fields, replace
from pathlib import Path

import loop_rig
import numpy as np
import pytest
import yaml
from loop_rig import PACKAGE

from aras_visual_servo_camera.trackers import TRACKERS
from aras_visual_servo_controller import ConfigurationError, Need, kinematics
from aras_visual_servo_controller.goals.starts import find_start_joints
from aras_visual_servo_controller.records.state import ServoSettings
from aras_visual_servo_controller.settings import ControllerSettings

URDF = loop_rig.URDF.read_text()


def of(**given):
    return ControllerSettings.from_mapping(given, PACKAGE)


@pytest.fixture(scope="module")
def arm():
    return ControllerSettings(package=PACKAGE).make_arm(URDF)


def test_the_laboratory_s_robot_brings_its_own_parameters(arm):
    settings = of(max_velocity=1.5).for_robot("aras_visual_servo", {"max_velocity": 1.5})
    assert settings.start == "2016" and settings.posture == {"J1": 0.0}
    assert settings.max_velocity == 1.5  # what was given comes before
    assert settings.controllers["J5"] == "joint5_position_controller"
    loop = settings.make_servo(arm)
    start = [-0.1, 0.0, *np.radians([20.0, -15.0, -5.0, 10.0])]
    assert loop.settings.start == pytest.approx(start)
    assert loop.differential_ik.elbows[0].bend_side == -1.0
    assert len(loop.differential_ik.tasks) == 2
    assert loop.differential_ik.limits.velocity.tolist() == [1.5] * 6
    assert loop.goal.depth == pytest.approx(0.19289, abs=1e-4)
    assert {"start": settings.start, "desired": settings.desired}.items() <= vars(
        replace(of(gain=3.0).for_robot("aras_visual_servo"), desired="auto")).items()
    by_itself = of(max_velocity=1.5, gain=3.0).for_robot("aras_visual_servo")
    assert by_itself == replace(settings, gain=3.0)  # what is not as by default was given
    assert of().for_robot("another") == of() == of().for_robot("")
    assert of().for_robot("../starts") == of()


def test_corners_of_a_shipped_goal_are_those_of_its_target(arm):
    goal = of(scheme="points", desired="2016").make_servo(arm).goal
    found = np.array(goal.features["points"]["points"])
    exact = goal.target.compute_outline(goal.world_T_camera)
    nearest = np.linalg.norm(found[:, None] - exact[None], axis=2).min(axis=1)
    assert len(found) == 8  # a square with a patch at a side
    assert nearest.max() < 2e-3  # edges of plates that are seen are no corners, as in pictures
    held = of(scheme="moments", desired="2016").make_servo(arm).goal
    assert not held.features and goal.moments.m00 == held.moments.m00
    for scheme in ("segments", "polar_points", "pose", "partitioned"):
        assert of(scheme=scheme, desired="2016").make_servo(arm).goal.features


def test_the_goal_follows_the_start():
    for given, year in (({"start": "2015"}, 2015), ({"start": 2016}, 2016),
                        ({"start": [0.0] * 6}, 2016), ({"start": "2015", "desired": "2016"}, 2016)):
        assert of(**given).find_goal_file().name == f"goal_{year}.yaml"
    assert of(desired="~/mine.yaml").find_goal_file() == Path("~/mine.yaml").expanduser()


ABOVE_0 = ("hold", "approach_speed", "watchdog", "wall_watchdog", "scheme_timeout", "stop_time",
           "model_scale")  # fmt: skip
AT_LEAST_0 = ("smoothing", "continuous_start", "ramp", "duration", "hold_gain", "posture_gain",
              "lag", "delay", "listeners")  # fmt: skip
LEAST = dict.fromkeys(AT_LEAST_0, 0.0) | {"image_timeout": 0.1, "joint_timeout": 0.1}
MOST = {"smoothing": 10.0, "hold_gain": 1000.0, "posture_gain": 1000.0, "approach_speed": 1.0,
        "stop_time": 10.0}  # fmt: skip
# Of settings of the loop, which may be made without parameters.
LOOP_LEAST = ("arrived", "push", "settle", "lag", "delay", "watchdog_images", "lead", "stiffness",
              "damping")  # fmt: skip
LOOP_ABOVE_0 = ("hold", "approach_speed", "longest_step", "watchdog", "stop_time",
                "resolve_period", "duration")  # fmt: skip


def test_every_number_has_its_bound_and_takes_what_lies_at_it():
    numbers = {f.name for f in fields(ControllerSettings) if isinstance(f.default, float)}
    by_others = {"lead", "stiffness", "damping"}  # the loop refuses them
    assert numbers - by_others == {*ABOVE_0, *LEAST}
    loop_most = [("approach_speed", 1.0), ("stop_time", 10.0)]
    for make, bounds in (
        (of, [*((name, 1e-6, 0.0, "must be > 0") for name in ABOVE_0),
              *((name, at, at - 1e-6, f"must be >= {at:g}") for name, at in LEAST.items()),
              *((name, at, 1.01 * at, f"must be <= {at:g}") for name, at in MOST.items())]),
        (ServoSettings, [*((name, 0.0, -1e-6, "") for name in LOOP_LEAST),
                         *((name, 1e-6, 0.0, "") for name in LOOP_ABOVE_0),
                         *((name, most, 1.01 * most, "") for name, most in loop_most)]),
    ):  # fmt: skip
        for name, edge, beyond, words in bounds:
            assert getattr(make(**{name: edge}), name) == edge
            with pytest.raises(ConfigurationError, match=f"{name}.*{words}"):
                make(**{name: beyond})


@pytest.mark.parametrize(("given", "words"), [
    ({"gian": 3.0}, "unknown parameter ~gian: did you mean 'gain'"),
    ({"gain": 0.0}, "~gain is 0.0, must be > 0"),
    ({"scheme": ""}, "~scheme is '', must be a text"),
    ({"max_velocity": "high"}, "~max_velocity is 'high', must be a number, a list"),
    ({"joints": "J1"}, "~joints is 'J1', must be a list"),
    ({"package": "/"}, "unknown parameter ~package"),
    ({"namespace": "my robot"}, "~namespace is 'my robot', which is not a ROS graph name"),
    ({"segmentation": {"component": "mask"}}, "~segmentation.component 'mask' is for the cam"),
    ({"desired": "2016", "scheme": "luminance"},
     "goal_2016.yaml holds no image of luminance.*teach"),
    ({"desired": "2016", "scheme": "numbered_points", "tracker": "dots"},
     "goal_2016.yaml holds no points of the feature.*teach"),
    ({"gain": 1e6}, "law proportional: gain is 1000000.0, must be <= 1000 1/s"),
    ({"law": "adaptive", "gain": 2.0}, "law 'adaptive' takes no 'gain': use one of"),
    ({"start": "2017"}, "~start is '2017': did you mean '201"),
    ({"start": [0.0] * 5}, "a finite number for each of gantry, J1"),
    ({"start": [0, 0, 0, 2.5, 0, 0]}, "outside the joint's limits"),
    ({"start": {"xyz": [0, 0, 5], "rpy": [3.1, 0, 0]}}, "out of the arm's reach"),
    ({"law_options": {1: 2.0}}, "takes no '1'"),
    ({"law_options": {"name": "pi"}}, "law 'proportional' takes no 'name'"),
    ({"law_options": {"ramp": 0.1}}, "set ~ramp instead"),
    ({"weights": [0.0]}, "at least one weight must be above 0"),
    ({"desired": "/nowhere.yaml"}, "cannot read the goal /nowhere.yaml:"),
    ({"desired": "no/where"}, "cannot read the goal no/where:"),
    ({"desired": "2017"}, "unknown goal '2017': did you mean '201"),
    ({"desired": "pose"}, "unknown goal 'pose': use one of 2015, 2016 .or the path of a YAML"),
    ({"posture": {"J4": 0.0}}, "unknown joint J4"),
    ({"posture": {"J1": 9.0}}, "posture: J1 is 9.0, must be a number within its limits"),
    ({"posture": {"J1": -9.0}}, "posture: J1 is -9.0"),
    ({"elbow": 0.5}, "side of the elbow J3 is 0.5: use -1 or 1"),
    ({"elbow": [1, 1]}, "~elbow is .1.0, 1.0., must be -1 or 1, or"),
    ({"controllers": {"J9": "x"}}, "~controllers has the unknown joint J9: use one of"),
    ({"controllers": {"J1": ""}}, "~controllers: the value for J1 is '', must be the name"),
    ({"elbow": {"J2": 1}}, "J2 is not an elbow"),
    ({"max_velocity": 9.0}, "beyond the robot's own"),
    ({"lead": {"J4": 0.1}}, "~lead has the unknown joint J4"),
    ({"output": "torque"}, "~output is 'torque': use one of position, velocity, effort"),
    ({"lead": -0.01}, "~lead is -0.01, must be >= 0 m, rad"),
    ({"stiffness": [1.0, 2.0]}, "stiffness is .1.0, 2.0., must be one number, or a number for "
                                "each"),
    ({"camera_frame": "camera"}, "did you mean 'camera_link'"),
])  # fmt: skip
def test_what_cannot_be_built_is_named(given, words):
    with pytest.raises(ConfigurationError, match=words):
        settings = of(**given)
        settings.make_servo(settings.make_arm(URDF))


# A slide and a turn whose limits exclude zero; the turn reaches most angles twice.
TWO_JOINTS = """<robot name="two">
<link name="a"/><link name="b"/><link name="camera_optical_frame"/>
<joint name="j" type="prismatic"><parent link="a"/><child link="b"/><axis xyz="1 0 0"/>
  <limit lower="0.2" upper="1" velocity="1" effort="1"/></joint>
<joint name="k" type="revolute"><parent link="b"/><child link="camera_optical_frame"/>
  <axis xyz="1 0 0"/><limit lower="-7" upper="-0.3" velocity="1" effort="1"/></joint></robot>"""


@pytest.mark.parametrize(("start", "words"), [
    ("nowhere", r"is 'nowhere': .* \(or a number for each of j, k\)$"),
    ("0.5", r"is '0.5': .* \(or a number for each of j, k\)$"),
    ("0.5 fast", "fast.*, must be a finite number"),
    ("0.5 1 2", r"is \(0.5, 1.0, 2.0\), must be a name, none, {xyz, rpy} of the camera, or a f"),
    ([0.5], r"is \[0.5\], must be a name, none, {xyz, rpy} of the camera, or a finite number f"),
    (0.5, "is 0.5, must be a name, none"),
    ({"j": 0.5}, "is '{'j': 0.5}', which has no value for k: give"),
    ({"j": 0.5, "k": 0.1, "l": 2.0}, "is .*, which has a value for l: the joints of this"),
    ("2016", "has a value for gantry: .* are j, k; give values for these, or set ~start"),
])  # fmt: skip
def test_a_start_that_is_none_of_this_arm_is_told(start, words):
    with pytest.raises(ConfigurationError, match=f"parameter ~start.*{words}"):
        find_start_joints(start, kinematics.Arm.from_urdf(TWO_JOINTS), PACKAGE)


def test_a_start_of_two_joints_is_taken_as_words_or_by_name_or_by_the_camera_s_pose():
    arm = kinematics.Arm.from_urdf(TWO_JOINTS)
    assert find_start_joints("none", arm, PACKAGE) is None
    for start in ("0.5 -0.4", "0.5, -0.4", "[0.5,-0.4]", (0.5, -0.4), {"k": -0.4, "j": 0.5}):
        found = find_start_joints(start, arm, PACKAGE)
        assert isinstance(found, np.ndarray) and found.tolist() == [0.5, -0.4]
    pose = {"xyz": [0.6, 0.0, 0.0], "rpy": [-0.5, 0.0, 0.0]}
    for near, turn in ((None, -0.5), (np.array([0.7, -6.5]), -0.5 - 2.0 * np.pi)):
        found = find_start_joints(pose, arm, PACKAGE, near)  # else what is nearest to zero
        assert found == pytest.approx([0.6, turn], abs=1e-6)


@pytest.mark.parametrize(("given", "read", "expected"), [
    ({"law": "adaptive", "law_options": {"zero": 6.0}, "continuous_start": 3.0},
     lambda loop: (loop.scheme.law.mu, loop.scheme.law.law.zero, loop.scheme.law.law.slope),
     (3.0, 6.0, 30.0)),
    ({"law": "diagonal", "law_options": {"values": [1, 2, 3, 4]}},
     lambda loop: loop.scheme.law.values, (1.0, 2.0, 3.0, 4.0)),
    ({"interaction": "mean", "smoothing": 0.25, "law": "adaptive"},
     lambda loop: (loop.scheme.interaction, loop.scheme.smoothing, loop.scheme.law.zero),
     ("mean", 0.25, 5.0)),
    ({"hold_gain": 2.5}, lambda loop: loop.differential_ik.settings.hold_gain, 2.5),
    # what is said for one joint leaves the others theirs
    ({"lead": {"J1": 0.1}}, lambda loop: loop.settings.lead, (0.05, 0.1, 0.05, 0.05, 0.05, 0.05)),
    ({"stiffness": {"J2": 3.0}}, lambda loop: loop.settings.stiffness, (0, 0, 3.0, 0, 0, 0)),
    ({"duration": 2.5}, lambda loop: loop.settings.duration, 2.5),
    ({}, lambda loop: (loop.settings.duration, *kinds(loop)),
     (np.inf, kinematics.JointLimitAvoidance)),
    ({"limit_avoidance": False}, lambda loop: kinds(loop), ()),
    ({"posture": {"J1": 0.1}, "posture_gain": 2.0}, lambda loop: kinds(loop),
     (kinematics.PostureTask, kinematics.JointLimitAvoidance)),
    ({"singularity_avoidance": True}, lambda loop: kinds(loop),
     (kinematics.JointLimitAvoidance, kinematics.SingularityAvoidance)),
    ({"elbow": 1}, lambda loop: loop.differential_ik.elbows[0].bend_side, 1.0),
])  # fmt: skip
def test_the_loop_gets_what_is_given(arm, given, read, expected):
    assert read(of(**given, start="none").make_servo(arm)) == expected


def kinds(loop):
    return tuple(type(task) for task in loop.differential_ik.tasks)


def test_of_joints_that_are_not_used_the_robot_s_parameters_say_nothing(arm):
    some = ["gantry", "J1", "J2", "J3"]
    settings = of(joints=some, start="none").for_robot("aras_visual_servo", ("joints", "start"))
    assert settings.max_velocity == {"gantry": 1.0, "J1": 2.0, "J2": 2.0, "J3": 2.0}
    assert settings.posture == {"J1": 0.0} and set(settings.controllers) == set(some)
    part = settings.make_arm(URDF)
    assert settings.make_limits(part).velocity.tolist() == [1.0, 2.0, 2.0, 2.0]
    assert settings.make_differential_ik(part, settings.make_limits(part)).elbows == ()
    with pytest.raises(ConfigurationError, match="joint J9 is not an elbow"):
        replace(settings, elbow={"J9": 1}).make_differential_ik(part, settings.make_limits(part))
    whole = of(joints=list(arm.names), start="none").for_robot("aras_visual_servo", ("joints",))
    assert whole.make_differential_ik(arm, whole.make_limits(arm)).elbows[0].bend_side == -1.0
    one = of(joints=["J2"]).for_robot("aras_visual_servo", ("joints",))
    assert (one.posture, one.elbow) == ({}, None)


def test_an_arm_whose_speed_nothing_limits_is_not_moved():
    urdf = re.sub(r'( name="J2"(?:.|\n)*?<limit[^>]*?) velocity="[^"]*"', r"\1", URDF, count=1)
    urdf = urdf.replace('name="J2" type="revolute"', 'name="J2" type="continuous"')
    settings = of(start="none", max_velocity={"J1": 1.0})
    arm = settings.make_arm(urdf)
    assert np.isinf(arm.velocity).tolist() == [False, False, True, False, False, False]
    with pytest.raises(ConfigurationError, match="J2 has no speed limit: .* ~max_veloc"):
        settings.make_servo(arm)
    replace(settings, max_velocity={"J2": 1.0}).make_servo(arm)


def test_a_user_s_own_law_takes_the_gain_that_is_given(tmp_path, monkeypatch):
    (tmp_path / "own_law.py").write_text(
        "from aras_visual_servo_controller.laws import Law\n"
        "class Plain(Law):\n"
        "    def desired_error_rate(self, error, L, rotated_error, t, dt): return -error\n"
        "class Fast(Plain):\n"
        "    gain: float = 8.0\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    assert of(law="own_law:Fast").make_law().gain == 8.0
    assert of(law="own_law:Fast", gain=3.0).make_law().gain == 3.0
    assert of(law="own_law:Fast", gain=3.0, ramp=0.1).make_law().law.gain == 3.0
    assert of(law="own_law:Plain").make_law().list_tunable_parameters() == {}
    for settings, words in (
        (of(law="own_law:Plain", gain=3.0), r"'own_law:Plain' takes no 'gain'"),
        (ControllerSettings(law_options={1: 2.0}), "~law_options: 1 is not a parameter of a law$"),
    ):
        with pytest.raises(ConfigurationError, match=words):
            settings.make_law()


def test_defaults_of_the_loop_are_those_of_its_parameters():
    plain, loop = vars(ControllerSettings()), vars(ServoSettings())
    shared = plain.keys() & loop.keys()
    assert shared >= {"hold", "lead", "watchdog", "output", "start", "duration"}
    # of a run without end one says 0, the other inf
    assert all(plain[name] == loop[name] for name in shared - {"start", "duration"})


def test_trackers_by_name_and_their_options(tmp_path, monkeypatch):
    (tmp_path / "their_tracker.py").write_text(
        "from aras_visual_servo_controller import Tracker\n\n\n"
        "class Ring(Tracker):\n"
        "    hold: float = 0.25\n\n"
        "    def find(self, grey):\n"
        "        raise NotImplementedError\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    dots, ring = "aras_visual_servo_camera.trackers.dots:DotTracker", "their_tracker:Ring"
    assert of().make_tracker() is None and type(of(tracker=dots).make_tracker()) is TRACKERS["dots"]
    for given, name, expected in (
        ({"tracker": "dots", "tracker_options": {"count": 3}}, "count", 3),
        # `hold` is also a parameter of the controller, which does not concern the tracker
        ({"tracker": ring}, "hold", 0.25),
        ({"tracker": ring, "tracker_options": {"hold": 4}}, "hold", 4),
    ):
        assert getattr(of(**given).make_tracker(), name) == expected
    for given, number in (({"marker": "DICT_5X5_100:5"}, 5), ({}, 7)):
        marker = of(tracker="marker", **given).make_tracker("DICT_5X5_100:7")
        assert marker.choice.number == number
    for given, words in (
        ({"tracker": "dotts"}, "did you mean 'dots'"),
        ({"tracker": "math:pi"}, "derived from Tracker"),
        ({"tracker": "model"}, "model_start must define the start pose"),
        ({"scheme": "points+model@left"}, "model_start must define the start pose"),
        ({"tracker": "dots", "tracker_options": {"cuont": 3}}, "did you mean 'count'"),
        ({"tracker": "dots", "tracker_options": {"count": 0}}, "count is 0, must be >= 1"),
        ({"tracker": "marker", "tracker_options": {"marker": "5"}}, "set ~marker instead"),
        ({"tracker_options": {"count": 3}}, "'outline' has no options"),
    ):  # fmt: skip
        with pytest.raises(ConfigurationError, match=words):
            of(**given).make_tracker()
    sys.modules.pop("their_tracker")


def test_controllers_of_joints_that_are_not_used_may_be_named():
    settings = of(joints=["J1", "J2"], controllers={"J5": "wrist"})
    assert settings.make_arm(URDF).names == ("J1", "J2")
    with pytest.raises(ConfigurationError, match="has the unknown joint J9: use one of .*J5"):
        of(joints=["J1", "J2"], controllers={"J9": "wrist"}).make_arm(URDF)


def test_a_start_by_a_pose_is_looked_for_from_the_posture_at_the_goal(arm, tmp_path):
    """J6 turns several times; a turn more at the goal is one more at the start."""
    goal = yaml.safe_load((PACKAGE / "config/goal_2016.yaml").read_text())
    goal["joints"]["J6"] += 2.0 * np.pi
    (tmp_path / "goal.yaml").write_text(yaml.safe_dump(goal))
    pose, starts = {"xyz": [0.1, 0.02, 0.8], "rpy": [np.pi, 0.0, 0.5]}, []
    for desired in ("2016", str(tmp_path / "goal.yaml")):
        starts.append(of(start=pose, desired=desired).make_servo(arm).settings.start)
    assert np.subtract(*starts[::-1])[5] == pytest.approx(2.0 * np.pi, abs=1e-3)


def test_each_camera_s_observer_knows_what_it_needs_and_its_goal_s_plane(arm):
    settings = of(scheme="points@left+area@right", cameras={"left": {}, "right": {}})
    scheme, pose, arms = settings.make_scheme(), arm.pose(np.zeros(6)), {"left": arm, "right": None}
    made = settings.make_camera_rig(arms, scheme)
    assert [o.needs for o in made.observers.values()] == [{Need.CORNERS}, {Need.MOMENTS}]
    assert made.control.arm is arm and made.observers["right"].arm is None
    assert made.control.compute_plane is None
    goal = of(desired="2016").load_goal().for_cameras({"left": arm})
    made = replace(settings, depth_image=True).make_camera_rig(arms, scheme, goal)
    assert made.control.needs == {Need.CORNERS, Need.DEPTH}
    assert made.control.compute_plane(pose) == goal.compute_plane(pose) is not None
    assert made.observers["right"].compute_plane is None
    assert made.observers["right"].needs == {Need.MOMENTS, Need.DEPTH}
