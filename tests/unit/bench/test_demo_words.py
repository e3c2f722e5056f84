"""Command line of the demo: arguments are accepted, or refused in one line before any start."""

import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from aras_visual_servo_bench.ros import demo_arguments
from aras_visual_servo_bench.ros.demo_arguments import LAUNCH_FILES, parse

WORLD, LOOP = LAUNCH_FILES
LAUNCH = Path(__file__).parents[3] / "src/aras_visual_servo_gazebo/launch"


def refuse(words, capsys):
    with pytest.raises(SystemExit, match="^2$"):
        parse(words)
    usage, _, told = capsys.readouterr().err.partition("demo: error: ")
    assert usage.startswith("usage: demo") and told.count("\n") == 1
    return told


def test_a_target_s_place_is_the_launch_file_s():
    told = re.search(r'name="target_place" default="([^"]*)"', (LAUNCH / WORLD).read_text())[1]
    words = told.split()
    given = dict(zip(words[::2], map(float, words[1::2]), strict=True))
    assert tuple(given.get(f"-{way}", 0.0) for way in "xyzRPY") == demo_arguments.TARGET_POSE


@pytest.mark.parametrize(("words", "told"), [
    (["--scheme", "momments"], "unknown scheme 'momments': did you mean 'moments'?"),
    (["--scheme", "my_module:MyScheme"], "my_module"),
    (["--law", "proportionel"], "did you mean 'proportional'?"),
    (["--gain", "5000"], "must be <= 1000 1/s"), (["--gain", "0"], "be above 0"),
    (["--camera", "pinhole"], "camera 'pinhole' is no preset: use one of calibrated, fisheye"),
    (["--out", "/dev/null/x"], "cannot make /dev/null/x: Not a directory"),
    (["--goal", "2017"], "unknown goal '2017': did you mean '201"),
    (["--start", "2017"], "'2017' must be 6 finite numbers"),
    (["--timeout", "0"], "--timeout must be above 0"), (["--none"], "unrecognized arguments: --n"),
    (["--target", "l_shap"], "'l_shap', which is not a target: did you mean 'l_shape'"),
    (["--target", "circle", "--scheme", "points"], "target 'circle' has no corners"),
    (["--target", "poster", "--target-size", "3 1"], "must be <= 2 m, the size of the table"),
    (["--target-size", "0 1"], "two lengths above 0 m"),
    (["--urdf", "/none.urdf"], "there is no file /none.urdf"),
    (["gain:=2"], "gain:= is set by an option"), (["none"], "not an argument: use NAME:=VALUE"),
    (["gians:=x"], "the launch files have no argument 'gians': did you mean 'gains'?"),
])  # fmt: skip
def test_what_cannot_be_is_told_with_what_would_be_right(words, told, capsys):
    assert told in refuse(words, capsys)


def test_other_arguments_go_to_the_launch_file_that_has_them():
    usual = parse([])
    assert (usual.taught, usual.tracker) == (None, "outline")
    assert usual.further == {WORLD: {}, LOOP: {}}
    further = parse(["joint_friction:=false", "layout:=moments", "gains:=/mine.yaml"]).further
    assert further == {
        WORLD: {"joint_friction": "false", "gains": "/mine.yaml"}, LOOP: {"layout": "moments"},
    }  # fmt: skip
    for file, options in LAUNCH_FILES.items():
        declared = {arg.get("name") for arg in ElementTree.parse(LAUNCH / file).iter("arg")}
        assert options <= declared, file


def test_before_another_target_the_goal_is_taught_where_the_shipped_one_has_the_camera():
    words = ["--target", "l_shape", "--target-size", "0.06 0.06"]
    still, aside = parse(words).taught, parse([*words, "--camera-xyz", "0 .03 0"]).taught
    assert still.moments.area == pytest.approx(0.64 * (0.06 / still.depth) ** 2, rel=0.02)
    assert still.depth == pytest.approx(0.192, abs=1e-3)  # 2016's
    moved = np.linalg.inv(still.world_T_camera) @ aside.world_T_camera
    assert np.linalg.norm(moved[:3, 3]) == pytest.approx(0.03, abs=1e-6)


def test_dots_are_taught_by_their_tracker_and_a_goal_of_ones_own_is_taken_as_it_is(tmp_path):
    dots = parse(["--target", "four_dots", "--scheme", "numbered_points"])
    assert dots.tracker == "dots"
    assert np.shape(dots.taught.features["numbered_points"]["points"]) == (4, 2)
    file = tmp_path / "goal.yaml"
    file.write_text(dots.taught.to_yaml())
    assert parse(["--target", "four_dots", "--goal", str(file)]).taught is None


def test_another_robot_has_joints_of_its_own(tmp_path, capsys):
    urdf = tmp_path / "arm.urdf"
    urdf.write_text("<robot name='arm'/>")
    assert parse(["--urdf", str(urdf), "--start=0 0 0 0 0 0 0"]).urdf == urdf
    assert "6 finite numbers" in refuse(["--start=0 0 0 0 0 0 0"], capsys)
    assert parse(["--start", "none"]).start == "none"


def test_results_go_into_a_folder_and_without_a_display_the_demo_goes_on_without_rviz(
    tmp_path, monkeypatch, capsys
):  # fmt: skip
    monkeypatch.chdir(tmp_path)
    given = parse(["--out", "a/b", "--timeout", "0.01"])
    assert parse([]).out == Path("out") and (given.out, given.timeout) == (Path("a/b"), 0.01)
    assert (tmp_path / "a/b").is_dir()
    monkeypatch.delenv("DISPLAY", raising=False)
    assert parse(["--rviz"]).rviz is False
    assert "DISPLAY is not set: continuing without rviz" in capsys.readouterr().err
    monkeypatch.setenv("DISPLAY", ":0")
    assert parse(["--rviz"]).rviz is True
    assert not capsys.readouterr().err
