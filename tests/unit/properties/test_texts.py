"""Damaged files are read, or refused in one line; no other error is raised.

Shipped files with pieces taken out, doubled and replaced. What is read once more is the same.
"""

from pathlib import Path

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.description.sdf import read_sdf
from aras_visual_servo_base.errors import DescriptionError
from aras_visual_servo_base.meshes import files
from aras_visual_servo_base.yaml_files import parse_yaml
from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_controller.errors import ConfigurationError
from aras_visual_servo_controller.goals.goal import Goal

SOURCES = Path(__file__).parents[3] / "src"
GAZEBO = SOURCES / "aras_visual_servo_gazebo"
WORLDS = Path(__file__).parents[2] / "worlds"
WORDS = st.sampled_from([
    "", "0", "-1", "1e400", "nan", "inf", "<", ">", "</link>", "<joint/>", 'name="J1"', "&amp;",
    "&x;", "\x00", "é", "\n", ": ", "- ", "{", "]", "'", "*a", "&a ", "!!python/name:os.system ",
    "v", "f 1 2 3\n", "f 9 9 9\n", "usemtl x\n", "mtllib ../../etc/passwd\n", "1 1 1",
]) | st.text(max_size=4)  # fmt: skip


@st.composite
def damaged(draw, whole):
    """A text with up to four pieces taken out, doubled or replaced."""
    for _ in range(draw(st.integers(1, 4))):
        first = draw(st.integers(0, len(whole)))
        last = min(first + draw(st.integers(0, 60)), len(whole))
        piece = draw(st.just("") | st.just(2 * whole[first:last]) | WORDS)
        whole = whole[:first] + piece + whole[last:]
    return whole


def is_one_line(error):
    text = str(error)
    assert text and "\n" not in text and len(text) < 1000, text


def found(package):
    return str(SOURCES / package)


@settings(max_examples=40)
@given(damaged((GAZEBO / "robots/aras_visual_servo.urdf").read_text()))
def test_a_robot(text):
    try:
        robot = parse_urdf(text, found)
    except DescriptionError as error:
        is_one_line(error)
    else:
        assert robot.root in robot.links


@settings(max_examples=60)
@given(st.sampled_from(["arm_cell", "storeroom"]).flatmap(
    lambda name: damaged((WORLDS / f"{name}.world").read_text())))  # fmt: skip
def test_a_world(text):
    try:
        content = read_sdf(text, found)
    except DescriptionError as error:
        is_one_line(error)
    else:
        assert all(model.root in model.links for model in content.models)


@settings(max_examples=60)
@given(damaged((SOURCES / "aras_visual_servo_controller/config/goal_2015.yaml").read_text()))
def test_a_goal(text):
    try:
        goal = Goal.from_mapping(parse_yaml(text, "goal", ConfigurationError) or {})
    except ConfigurationError as error:
        is_one_line(error)
        return
    again = Goal.from_mapping(parse_yaml(goal.to_yaml(), "goal", ConfigurationError))
    np.testing.assert_allclose(again.world_T_camera, goal.world_T_camera, atol=1e-9)
    assert (again.joints, again.depth) == (goal.joints, goal.depth)


@settings(max_examples=60)
@given(damaged("plant: free\ngain: 2.0\ntarget:\n  shape: [[0, 0], [0.1, 0]]\nlag: 1e-2\n"))
def test_yaml(text):
    try:
        parse_yaml(text, "experiment.yaml", ExperimentError)
    except ExperimentError as error:
        is_one_line(error)
        assert "experiment.yaml" in str(error)


@settings(max_examples=60)
@given(name=st.sampled_from(["targets/l_shape.obj", "targets/heptagon.mtl"]), data=st.data())
def test_a_mesh_of_text(name, data, tmp_path):
    for beside in ("l_shape.obj", "l_shape.mtl", "heptagon.obj", "heptagon.mtl"):
        (tmp_path / beside).write_bytes((GAZEBO / "targets" / beside).read_bytes())
    path = tmp_path / Path(name).name
    path.write_text(data.draw(damaged(path.read_text())), encoding="utf-8", errors="replace")
    read(path.with_suffix(".obj"))


@settings(max_examples=40)
@given(cut=st.integers(0, 3000), at=st.integers(0, 2000), bits=st.binary(max_size=12))
def test_a_binary_mesh(cut, at, bits, tmp_path):
    whole = (GAZEBO / "meshes/link6.stl").read_bytes()[: 84 + 50 * 40]
    whole = whole[:80] + (40).to_bytes(4, "little") + whole[84:]
    path = tmp_path / "part.stl"
    path.write_bytes((whole[:at] + bits + whole[at + len(bits):])[: cut or None])
    read(path)


def read(path):
    try:
        meshes = files.read(str(path))
    except DescriptionError as error:
        is_one_line(error)
        assert path.stem in str(error)
    else:
        assert sum(len(mesh.triangles) for mesh in meshes) > 0
