"""Programs that launch files call for descriptions of the robot, a target, or a bag's robot."""

import argparse
import importlib.machinery
import importlib.util
import json
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import cv2
import numpy as np
import pytest
from robot_figures import PACKAGE

from aras_visual_servo_base.meshes import files
from aras_visual_servo_bench.errors import ExperimentError

PROGRAMS = PACKAGE.parent / "aras_visual_servo_bench" / "scripts"
TARGETS = PACKAGE / "targets"

SHIPPED = (PACKAGE / "robots" / "aras_visual_servo.urdf").read_text()


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
def target():
    return program("target_description")


@pytest.fixture
def describe(target):
    """Describe one of the shipped targets, or another one."""
    return lambda name, *more: target.describe(name, target.find_files(TARGETS), *more)


def measure(urdf: str) -> list[float]:
    """Return the lengths of the described target's mesh along x, y and z, m."""
    mesh = ElementTree.fromstring(urdf).find("link/visual/geometry/mesh")
    path = Path(mesh.get("filename").removeprefix("file://"))
    corners = np.concatenate([part.positions for part in files.read(str(path))])
    scale = [float(factor) for factor in mesh.get("scale", "1 1 1").split()]
    return (np.ptp(corners, axis=0) * scale).tolist()


def test_targets_that_ship_are_told_as_they_are_and_made_in_other_sizes(target, describe, tmp_path):
    assert {"aras", "four_dots", "l_shape"} <= set(target.find_files(TARGETS))
    shipped = (PACKAGE / "targets" / "four_dots.urdf").read_text()
    assert describe("four_dots", None, tmp_path) == shipped
    made = {}
    for name, size in (("four_dots", (0.2, 0.15)), ("four_dots", (0.15, 0.2)),
                       ("box", (0.08, 0.05, 0.03)), ("l_shape", (0.2, 0.15))):  # fmt: skip
        made[name, size] = describe(name, size, tmp_path)
    for (_, size), urdf in made.items():  # none of them has replaced the files of another one
        assert measure(urdf) == pytest.approx([*size, 0.0][:3]) and f"{tmp_path}/" in urdf


def test_a_target_of_a_file(describe, tmp_path):
    urdf, outline, mesh = (tmp_path / f"mine.{suffix}" for suffix in ("urdf", "svg", "OBJ"))
    urdf.write_text("<robot/>")
    other = tmp_path / "mine.xml"
    other.write_text("<robot name='x'/>")
    assert describe(str(other), (0.1, 0.2), tmp_path) == "<robot name='x'/>"
    assert describe(str(urdf), None, tmp_path) == "<robot/>"
    mesh.write_text("v 0 0 0\nv 40 0 0\nv 0 50 0\nv 0 0 60\n"
                    "f 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n")  # fmt: skip
    assert measure(describe(str(mesh), (0.3, 0.2, 0.1), tmp_path)) == pytest.approx([0.3, 0.2, 0.1])
    by_factor = describe(str(mesh), None, tmp_path, 0.001)
    assert measure(by_factor) == pytest.approx([0.04, 0.05, 0.06])
    outline.write_text('<svg width="30cm" height="20cm"><rect width="30cm" height="20cm"/></svg>')
    assert measure(describe(str(outline), None, tmp_path)) == pytest.approx([0.3, 0.2, 0.0])


def test_a_shape_that_does_not_ship_is_made(target, describe, tmp_path, monkeypatch, capsys):
    """What it prints is not part of the description."""
    (tmp_path / "my_shapes.py").write_text(
        "from aras_visual_servo_bench.targets.shapes import OutlineShape\n"
        "print('loading')\n"
        "class Cross(OutlineShape):\n"
        "    corners = ((-0.5, -0.5), (0.5, -0.5), (0.0, 0.5))\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    status, printed, said = told(
        target, monkeypatch, capsys, "my_shapes:Cross", f"--targets={TARGETS}")
    assert (status, said) == (0, "loading\n") and printed.startswith("<?xml")
    for size, lengths in ((None, [0.1, 0.1, 0.0]), ((0.3, 0.2), [0.3, 0.2, 0.0])):
        assert measure(describe("my_shapes:Cross", size, tmp_path)) == pytest.approx(lengths)


def test_a_picture_lies_upright_on_a_plane_of_its_size(describe, tmp_path):
    path, picture = tmp_path / "photo.png", np.arange(36, dtype=np.uint8).reshape(3, 4, 3)
    cv2.imwrite(str(path), picture)
    urdf = describe(str(path), (0.2, 0.15), tmp_path)
    robot = ElementTree.fromstring(urdf)
    assert robot.get("name") == "target" and robot.find("gazebo/static").text == "true"
    file = robot.find("link/visual/geometry/mesh").get("filename").removeprefix("file://")
    (mesh,) = files.read(file)
    assert (cv2.imread(mesh.texture) == picture).all() and mesh.rgba[:3] == (1.0, 1.0, 1.0)
    # x is to the right in the picture and y up
    np.testing.assert_allclose(mesh.uv, 0.5 + mesh.positions[:, :2] / (0.2, 0.15), atol=1e-6)
    np.testing.assert_array_equal(mesh.normals, [[0.0, 0.0, 1.0]] * len(mesh.normals))
    assert measure(urdf) == pytest.approx([0.2, 0.15, 0.0])
    assert describe(str(path), (0.2, 0.15), tmp_path) == urdf
    small = describe(str(path), None, tmp_path / "new" / "folder")
    assert measure(small) == pytest.approx([0.1, 0.1, 0.0]) and file not in small


@pytest.mark.parametrize(("name", "size", "words"), [
    ("box", None, "a box has three lengths"), ("box", (0.1, 0.1), "a box has three lengths"),
    ("four_dots", (0.1, 0.1, 0.1), "target 'four_dots' has two lengths"),
    ("aras", (0.1, 0.1), "target 'aras' has one size"),
    ("/nowhere/photo.png", None, "there is no file /nowhere/photo.png"),
    (__file__, None, "is not a readable image"), ("four_dot", None, "did you mean 'four_dots'"),
    ("my_package.shapes:Cross", None, "my_package"),
])  # fmt: skip
def test_what_is_no_target_is_named(describe, tmp_path, name, size, words):
    with pytest.raises(ExperimentError) as refused:
        describe(name, size, tmp_path)
    assert words in str(refused.value)


def test_a_target_on_the_command_line(target, monkeypatch, capsys):
    sizes = [target.parse_size(t) for t in (" ", "0.1 2", "1 .5 .1")]
    assert sizes == [None, (0.1, 2), (1, 0.5, 0.1)]
    for text in ("0.1", "0.1 0", "0.1 inf", "a b", "1 1 1 1", "nan 1"):
        with pytest.raises(argparse.ArgumentTypeError, match="must be two lengths"):
            target.parse_size(text)
    shipped, words = (TARGETS / "l_shape.urdf").read_text(), f"--targets={TARGETS}"
    assert told(target, monkeypatch, capsys, "l_shape", "--size=", words) == (0, shipped + "\n", "")
    status, printed, said = told(
        target, monkeypatch, capsys, "/bad.svg", "--size", "0.1 0.1", words)
    assert (status, printed) == (1, "")
    assert said.startswith("target_description: there is no file /bad.svg")


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


def test_a_place_is_three_finite_numbers(adapt):
    for text in ("0 0", "0 0 nan", "0 0 x"):
        with pytest.raises(argparse.ArgumentTypeError, match=f"'{text}' must be three finite numb"):
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
