"""Programs that launch files call for descriptions of the robot, a target, or a bag's robot."""

import argparse
import importlib.machinery
import importlib.util
import json
import os
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import cv2
import numpy as np
import pytest
from robot_figures import PACKAGE

PROGRAMS = PACKAGE.parent / "aras_visual_servo_bench" / "scripts"
TARGETS = PACKAGE / "targets"

SHIPPED = (PACKAGE / "robots" / "aras_visual_servo.urdf").read_text()
MAKER = "rosrun aras_visual_servo_bench target_files"
# A rosrun whose target_files says what it was asked for in the place of a description.
ROSRUN = f"""#!{sys.executable}
import pathlib, sys
words = sys.argv[3:]
if words[0] == "bad":
    print("one line"); print("target_files: no such outline"); sys.exit(2)
if words[0] == "mute":
    sys.exit(1)
if words[0] == "loud":
    print("of no use"); print("target_files: a\\nb", file=sys.stderr); sys.exit(1)
folder = pathlib.Path(words[words.index("--out") + 1])
folder.mkdir(parents=True, exist_ok=True)
(folder / "target.urdf").write_text(repr(words))
"""


def program(name: str):
    """A program of the package as a module."""
    loader = importlib.machinery.SourceFileLoader(name, str(PROGRAMS / name))
    made = importlib.util.module_from_spec(importlib.util.spec_from_loader(name, loader))
    loader.exec_module(made)
    return made


def told(made, monkeypatch, capsys, *words: str) -> tuple[int, str, str]:
    """Run a program; return its exit status, output and error output."""
    monkeypatch.setattr(sys, "argv", [made.__name__, *words])
    return made.main(), *capsys.readouterr()


@pytest.fixture
def target(monkeypatch, tmp_path_factory):
    folder = tmp_path_factory.mktemp("bin")
    (folder / "rosrun").write_text(ROSRUN)
    (folder / "rosrun").chmod(0o755)
    monkeypatch.setenv("PATH", str(folder), prepend=os.pathsep)
    return program("target_description")


@pytest.fixture
def describe(target):
    """Describe one of the shipped targets, or another one."""
    return lambda name, *more: target.describe(name, target.find_files(TARGETS), *more)


def test_targets_that_ship_are_told_as_they_are_and_made_in_other_sizes(target, describe, tmp_path):
    assert {"aras", "four_dots", "l_shape"} <= set(target.find_files(TARGETS))
    shipped = (PACKAGE / "targets" / "four_dots.urdf").read_text()
    assert describe("four_dots", None, tmp_path) == shipped
    seen = set()
    for name, size in (("four_dots", (0.2, 0.15)), ("four_dots", (0.15, 0.2)),
                       ("box", (0.08, 0.05, 0.03)), ("l_shape", (0.2, 0.15))):  # fmt: skip
        words = eval(describe(name, size, tmp_path))
        folder = words[words.index("--out") + 1]
        assert folder.startswith(f"{tmp_path}/")
        lengths = [str(length) for length in size]
        assert words == [name, "--name", "target", "--out", folder, "--size", *lengths]
        seen.add(folder)
    assert len(seen) == 4


def test_a_target_of_a_file(describe, tmp_path):
    urdf, outline = tmp_path / "mine.urdf", tmp_path / "mine.svg"
    urdf.write_text("<robot/>")
    outline.write_text("<svg/>")
    other = tmp_path / "mine.xml"
    other.write_text("<robot name='x'/>")
    assert describe(str(other), (0.1, 0.2), tmp_path) == "<robot name='x'/>"
    mesh = tmp_path / "MINE.STL"
    mesh.touch()
    sized = eval(describe(str(mesh), (0.3, 0.2, 0.1), tmp_path))
    assert sized[-4:] == ["--size", "0.3", "0.2", "0.1"]
    assert eval(describe(str(mesh), None, tmp_path, 0.001))[-2:] == ["--scale", "0.001"]
    assert describe(str(urdf), None, tmp_path) == "<robot/>"
    words = eval(describe(str(outline), None, tmp_path))
    assert words[0] == str(outline) and "--size" not in words  # its own


@pytest.mark.parametrize("name", ["cross", "my_package.shapes:Cross"])
def test_a_shape_that_does_not_ship_is_made(describe, tmp_path, name):
    words = eval(describe(name, None, tmp_path))
    assert words[0] == name and "--size" not in words
    assert eval(describe(name, (0.3, 0.2, 0.1), tmp_path))[-3:] == ["0.3", "0.2", "0.1"]


def test_a_picture_lies_upright_on_a_plane_of_its_size(target, describe, tmp_path):
    path = tmp_path / "photo.png"
    cv2.imwrite(str(path), np.zeros((3, 4, 3), np.uint8))
    robot = ElementTree.fromstring(describe(str(path), (0.2, 0.15), tmp_path))
    assert robot.get("name") == "target" and robot.find("gazebo/static").text == "true"
    mesh = Path(robot.find("link/visual/geometry/mesh").get("filename").removeprefix("file://"))
    lines = [line.split() for line in mesh.read_text().splitlines()]
    v = np.array([words[1:] for words in lines if words[0] == "v"], float)
    vt = np.array([words[1:] for words in lines if words[0] == "vt"], float)
    material = mesh.with_suffix(".mtl").read_text().split()
    assert ["mtllib", "target.mtl"] in lines and f"usemtl {material[1]}".split() in lines
    assert material[2:] == ["Kd", "1", "1", "1", "map_Kd", str(path)]
    faces = [[tuple(map(int, corner.split("/"))) for corner in words[1:]]
             for words in lines if words[0] == "f"]  # fmt: skip
    area = np.zeros(3)
    for face in faces:
        a, b, c = (v[i - 1] for i, _ in face)
        area += 0.5 * np.cross(b - a, c - a)
        for i, j in face:  # x is to the right in the picture and y up
            assert vt[j - 1] == pytest.approx([0.5 + v[i - 1, 0] / 0.2, 0.5 + v[i - 1, 1] / 0.15])
    assert area == pytest.approx([0.0, 0.0, 0.2 * 0.15])
    again = ElementTree.fromstring(describe(str(path), (0.2, 0.15), tmp_path))
    assert ElementTree.tostring(again) == ElementTree.tostring(robot)
    small = ElementTree.fromstring(describe(str(path), None, tmp_path / "new" / "folder"))
    plane = Path(small.find("link/visual/geometry/mesh").get("filename").removeprefix("file://"))
    assert "v 0.05 0.05 0" in plane.read_text().splitlines()
    assert small.find("link/visual/geometry/mesh").get("filename") != f"file://{mesh}"


@pytest.mark.parametrize(("name", "size", "words"), [
    ("box", None, "a box has three lengths"), ("box", (0.1, 0.1), "a box has three lengths"),
    ("four_dots", (0.1, 0.1, 0.1), "target 'four_dots' has two lengths"),
    ("aras", (0.1, 0.1), "target 'aras' has one size"),
    ("/nowhere/photo.png", None, "there is no file /nowhere/photo.png"),
    (__file__, None, "is not a readable image"),
])  # fmt: skip
def test_what_is_no_target_is_named(describe, tmp_path, name, size, words):
    with pytest.raises(ValueError) as refused:
        describe(name, size, tmp_path)
    assert words in str(refused.value)


def test_what_cannot_be_made_is_told_in_its_makers_words(target, describe, tmp_path, monkeypatch):
    for name, words in (("bad", "no such outline"), ("mute", f"{MAKER} failed"),
                        ("loud", "b")):  # fmt: skip
        with pytest.raises(ValueError) as refused:
            target.make(name, (0.1, 0.1), tmp_path)
        assert str(refused.value) == words

    def slow(_command, timeout, **_more):
        raise subprocess.TimeoutExpired("maker", timeout)

    monkeypatch.setenv("PATH", "/nowhere")
    with pytest.raises(ValueError, match=f"box needs {MAKER}, which makes its mesh"):
        describe("box", (0.1, 0.2, 0.3), tmp_path)
    monkeypatch.setattr(subprocess, "run", slow)
    with pytest.raises(ValueError, match=f"box needs {MAKER}, .*timed out after 120.0 s"):
        describe("box", (0.1, 0.2, 0.3), tmp_path)


def test_a_target_on_the_command_line(target, monkeypatch, capsys):
    sizes = [target.parse_size(t) for t in (" ", "0.1 2", "1 .5 .1")]
    assert sizes == [None, (0.1, 2), (1, 0.5, 0.1)]
    for text in ("0.1", "0.1 0", "0.1 inf", "a b", "1 1 1 1", "nan 1"):
        with pytest.raises(argparse.ArgumentTypeError, match="must be two lengths"):
            target.parse_size(text)
    shipped, words = (TARGETS / "l_shape.urdf").read_text(), f"--targets={TARGETS}"
    assert told(target, monkeypatch, capsys, "l_shape", "--size=", words) == (0, shipped + "\n", "")
    status, printed, said = told(
        target, monkeypatch, capsys, "bad", "--size", "0.1 0.1", words)
    assert (status, printed, said) == (1, "", "target_description: no such outline\n")


@pytest.fixture
def adapt():
    return program("adapt_description")


def test_a_robot_is_told_with_its_camera_moved_and_without_friction(adapt, monkeypatch, capsys):
    path = str(PACKAGE / "robots" / "aras_visual_servo.urdf")
    assert told(adapt, monkeypatch, capsys, path, "--xyz=", "--rpy=") == (0, SHIPPED + "\n", "")
    status, text, _ = told(adapt, monkeypatch, capsys, path, "--xyz=0 0.03 1e-3", "--rpy=0.2 0 -1",
                           "--joint-friction=False")  # fmt: skip
    before, after = ElementTree.fromstring(SHIPPED), ElementTree.fromstring(text)
    assert status == 0 and after.find("link[@name='camera_mount']") is not None
    joints = {joint.get("name"): joint for joint in after.findall("joint")}
    added = joints.pop("camera_mount_joint")
    assert added.get("type") == "fixed"
    assert [(part.tag, part.attrib) for part in added] == [
        ("parent", {"link": "camera_mount"}), ("child", {"link": "camera_link"}),
        ("origin", {"xyz": "0.0 0.03 0.001", "rpy": "0.2 0.0 -1.0"}),
    ]  # fmt: skip
    assert joints["camera_joint"].find("child").get("link") == "camera_mount"
    for joint in before.findall("joint"):
        found = joints.pop(joint.get("name"))
        for part in joint:
            wanted = dict(part.attrib)
            if part.tag == "dynamics":
                wanted["friction"] = "0"
            if joint.get("name") == "camera_joint" and part.tag == "child":
                continue
            assert found.find(part.tag).attrib == wanted
    assert not joints
    assert len(after.findall("link")) == len(before.findall("link")) + 1


@pytest.mark.parametrize(("text", "words"), [
    ("0 0", "'0 0' must be three finite numbers"), ("0 0 nan", "must be three finite numbers"),
    ("0 0 x", "must be three finite numbers"),
])  # fmt: skip
def test_a_place_is_three_finite_numbers(adapt, text, words):
    with pytest.raises(argparse.ArgumentTypeError, match=words):
        adapt.parse_vector(text)
    values = [adapt.parse_bool(word) for word in ("True", "1", "false", "0")]
    assert values == [True, True, False, False]
    with pytest.raises(argparse.ArgumentTypeError, match="'yes' must be true or false"):
        adapt.parse_bool("yes")


def test_a_description_that_cannot_be_adapted_is_named(adapt, tmp_path, monkeypatch, capsys):
    joint = '<joint><child link="camera_link"/></joint>'
    for text, words in (("<robot", "unclosed token"), ("<robot/>", "0 joints carry camera_link"),
                        (f"<robot>{joint}{joint}</robot>", "2 joints carry camera_link")):
        path = tmp_path / "mine.urdf"
        path.write_text(text)
        status, printed, said = told(adapt, monkeypatch, capsys, str(path), "--xyz=0 0 1")
        assert (status, printed) == (1, "")
        assert said.startswith(f"adapt_description: {path}: {words}")


def test_a_bags_description_is_the_last_that_it_tells(tmp_path, capsys):
    rosbag, messages = pytest.importorskip("rosbag"), pytest.importorskip("std_msgs.msg")
    recorded, path = program("recorded_description"), str(tmp_path / "run.bag")
    with rosbag.Bag(path, "w") as bag:
        for robot in ("first", "last"):
            parameters = {"robot_description": f"<{robot}/>"}
            if robot == "first":
                parameters["target_description"] = "<target/>"
            text = json.dumps({"parameters": parameters})
            bag.write("/mine/experiment", messages.String(text))
        bag.write("/mine/other", messages.String("{}"))
    empty = str(tmp_path / "empty.bag")
    rosbag.Bag(empty, "w").close()
    robot = str(PACKAGE / "robots" / "aras_visual_servo.urdf")
    for words, printed in (([path, robot], "<last/>"), ([path, "--target"], "<target/>"),
                           ([empty, robot], SHIPPED), ([empty, "--target"], "")):  # fmt: skip
        assert recorded.main(words) == 0
        assert capsys.readouterr() == (printed, "")
    assert recorded.main(["/nowhere.bag", "--target"]) == 0
    assert capsys.readouterr() == ("", "")
    assert recorded.main(["/nowhere.bag", robot]) == 0
    said = capsys.readouterr()
    assert said.out == SHIPPED and said.err.startswith("/nowhere.bag: ")
    assert said.err.endswith(f": showing the robot of {robot}\n")
