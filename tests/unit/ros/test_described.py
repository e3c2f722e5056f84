"""Description of a run in a bag: it is read as far as possible; a note describes the rest."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from run_messages import ARM, JOINTS

from aras_visual_servo_bench.errors import BenchError
from aras_visual_servo_bench.recording.recorded_experiment import RecordedExperiment, find_preset

CONFIG = Path(__file__).parents[3] / "src/aras_visual_servo_controller/config"
GOAL = (CONFIG / "goal_2015.yaml").read_text()


def of(loop=None, simulator=None, **more):
    given = {"controller": "/servo", "parameters": {
        "servo": {"scheme": "points", "gains": {"gain": 2.0}, **(loop or {})},
        "gazebo": simulator or {}, "robot_description": ARM}, **more}
    return RecordedExperiment.from_text(json.dumps(given))


@pytest.mark.parametrize(("text", "why"), [
    ("", "the bag is from an older version or from another recorder"), ("{", "cannot be read"),
    ("[]", "there are no parameters of the"), ("{}", "there are no parameters of the"),
    ('{"parameters": {}, "goals": []}', "the entry 'goals' is not a mapping"),
    ('{"parameters": {}, "versions": []}', "the entry 'versions' is not a mapping"),
    ('{"parameters": {}, "launch": {}}', "the entry 'launch' is not a list")])
def test_a_description_that_is_none_is_a_note(text, why):
    found = RecordedExperiment.from_text(text)
    assert len(found.notes) == 1 and why in found.notes[0]
    assert found.settings is found.arm is found.goal is None and found.make_yaml() == ""
    assert [len(one) for one in found.read_limits()] == 3 * [0] and found.describe_settings() == {}
    with pytest.raises(BenchError, match=why):
        found.make_experiment()
    assert len(found.notes) == 1


def test_what_the_loop_was_set_to_is_read():
    found = of({"desired": "2015", "gain": 2.5}, goals={"goal_2015.yaml": GOAL})
    assert "gains" not in found.controller and found.urdf == ARM
    assert (found.settings.scheme, found.settings.gain) == ("points", 2.5)
    assert found.arm.names == JOINTS
    lower, upper, velocity = found.read_limits()
    np.testing.assert_allclose([lower, upper, velocity], [[-0.5, -1.5], [0.7, 2.0], [0.3, 1.9]])
    assert not found.notes
    named = of({"description": "robo"})
    assert named.urdf == "" and named.arm is None and not named.notes
    broken = of({"description": "robo"})
    broken.content["parameters"]["robo"] = "<robot name='x'/>"
    assert broken.arm is None and broken.notes[0].startswith("the recorded description cannot be")
    assert [len(one) for one in broken.read_limits()] == [0, 0, 0] and len(broken.notes) == 1
    endless = of()
    unlimited = ARM.replace('<limit lower="-1.5" upper="2" effort="5" velocity="1.9"/>', "")
    endless.content["parameters"]["robot_description"] = unlimited.replace("revolute", "continuous")
    assert [len(one) for one in endless.read_limits()] == [0, 0, 0]
    assert endless.notes[0].startswith(
        "the recorded limits cannot be used: elbow has no speed limit")
    wrong = of({"gain": "high"})
    assert wrong.settings is None and wrong.arm is None and wrong.goal is None
    assert len(wrong.notes) == 1 and "the recorded parameters cannot be used: " in wrong.notes[0]


def test_the_recorded_goal_is_the_loop_s():
    found = of({"desired": "2015", "description": "none"}, goals={"goal_2015.yaml": GOAL})
    assert found.goal.joints["J2"] == yaml.safe_load(GOAL)["joints"]["J2"] and not found.notes
    assert of({"desired": "2015"}).goal is None
    missing = of({"desired": "2016"}, goals={"goal_2015.yaml": GOAL})
    assert missing.goal is None and missing.notes == ["the goal goal_2016.yaml was not recorded"]
    bad = of({"desired": "2015"}, goals={"goal_2015.yaml": "joints: 3"})
    assert bad.goal is None and bad.notes[0].startswith("the recorded goal cannot be used: ")


def test_units_of_features_are_the_scheme_s():
    found = of({"description": "none"})
    units, tolerances = found.read_features("theta_u", 3)
    assert len(units) == len(tolerances) == 3 and set(units) == {"rad"}
    assert found.read_features("theta_u", 4) == ((), ())
    assert "'theta_u' has other features" in found.notes[-1]
    assert found.read_features("nonsense", 4) == ((), ())
    assert "units of the features are unknown: unknown scheme" in found.notes[-1]
    taught = of({"desired": "2015", "description": "none"}, goals={"goal_2015.yaml": GOAL})
    aside, away = 0.0025 * taught.goal.distance, 0.005 * taught.goal.distance
    assert taught.read_features("moments", 4)[1] == pytest.approx((aside, aside, away, 0.005))


def test_a_run_s_experiment_says_what_differs():
    launch = [["p", "a.launch", "camera:=noisy", "camera_xyz:=0 0.1 0"],
              ["p", "b.launch", "camera:=wide", "joint_friction:=False", "camera_rpy:="]]
    found = of({"law": "pi", "gain": 2.5, "start": "0.1 0 0.2 0 0 0.3", "desired": "2015",
                "duration": 4, "listeners": 2, "stop_time": 0.3}, {"seed": 7}, launch=launch)
    assert found.arguments == {"camera": "wide", "camera_xyz": "0 0.1 0", "camera_rpy": "",
                               "joint_friction": "False"}
    wanted = {"scheme": "points", "law": "pi", "gain": 2.5, "start": [0.1, 0.0, 0.2, 0.0, 0.0, 0.3],
              "goal": "2015", "camera": "wide", "camera_xyz": [0.0, 0.1, 0.0], "friction": False,
              "seed": 7, "duration": 4.0, "controller_parameters": {"stop_time": 0.3}}
    assert found.make_mapping() == wanted and yaml.safe_load(found.make_yaml()) == wanted
    assert found.make_yaml().startswith("scheme: points\nlaw: pi\n")  # as people write it
    assert "\nstart: [0.1, 0.0, 0.2, 0.0, 0.0, 0.3]\n" in found.make_yaml()
    assert found.make_experiment().seed == 7
    words = found.describe_settings()
    assert (words["law"], words["seed"], words["camera_xyz"]) == ("pi", "7", "0 0.1 0")
    assert words["launched by"] == "; ".join(" ".join(one) for one in launch)
    assert "camera_rpy" not in words and "duration" not in words
    assert of({"start": "2015"}).make_mapping()["start"] == "2015"
    assert of({"start": "0.1 -0.2"}).make_mapping()["start"] == [0.1, -0.2]
    wide = yaml.safe_load((CONFIG.parents[1] / "aras_visual_servo_gazebo/config/cameras/wide.yaml")
                          .read_text())
    assert of({}, {"cameras": {"labrob": {"camera": wide}}}).make_mapping()["camera"] == "wide"
    assert find_preset({**wide, "width": 5}) == {**wide, "width": 5}
    bad = of({"gain": "high", "start": "2015"})
    with pytest.raises(BenchError, match="the bag's run cannot be repeated as an experiment: "):
        bad.make_mapping()
    assert bad.make_yaml() == "" and "cannot be repeated as an experiment: " in bad.notes[0]
    assert bad.describe_settings() == {"scheme": "points", "start": "2015"}


def test_the_files_of_a_run():
    hostile = ("../evil.yaml", "x/y.yaml", "/x.yaml", "..", "\n.yaml", ".bashrc", "b.txt",
               "a.yaml/../../x")
    found = of(goals={"mine.yaml": "a: 1", **dict.fromkeys(hostile, "")},
               launch=[["p", "a.launch", "x:=1"], ["q"]], versions={"numpy": "2.1", "ros": "1"})
    files = found.collect_files()
    assert set(files) == {"mine.yaml", "parameters.yaml", "robot.urdf", "launch.txt",
                          "versions.txt"}
    assert files["launch.txt"] == "roslaunch p a.launch x:=1\nroslaunch q\n"
    assert files["versions.txt"] == "numpy 2.1\nros 1\n" and files["robot.urdf"] == ARM
    assert yaml.safe_load(files["parameters.yaml"]) == found.content["parameters"]
    assert found.notes == [f"the goal {name!r} is omitted: it is not a file name"
                           for name in hostile]
