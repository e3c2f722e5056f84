"""The tree of a URDF: the path from link to link, the name, and hostile texts."""

import pytest

from aras_visual_servo_base.errors import DescriptionError
from aras_visual_servo_base.urdf import parse_tree, read_robot_name

# base - j1 - a - j2 - b - eye, and a branch a - j3 - hand
ROBOT = """<robot name="fork"><link name="base"/><link name="a"/><link name="b"/>
<link name="eye"/><link name="hand"/>
<joint name="eye_joint" type="fixed"><parent link="b"/><child link="eye"/></joint>
<joint name="j2" type="prismatic"><parent link="a"/><child link="b"/>
  <limit lower="-1" upper="2" velocity="1" effort="3"/></joint>
<joint name="j1" type="continuous"><parent link="base"/><child link="a"/></joint>
<joint name="j3" type="continuous"><parent link="a"/><child link="hand"/></joint></robot>"""


@pytest.mark.parametrize(("base", "link", "names"), [
    ("", "eye", ["j1", "j2", "eye_joint"]), ("base", "eye", ["j1", "j2", "eye_joint"]),
    ("a", "hand", ["j3"]), ("eye", "eye", []), ("", "base", [])])
def test_a_path_goes_down_from_the_base(base, link, names):
    assert [joint.name for joint in parse_tree(ROBOT).find_path(base, link)] == names


@pytest.mark.parametrize(("base", "link", "words"), [
    ("", "ey", "robot 'fork' has no link ey; did you mean 'eye'?"),
    ("hand", "eye", "hand is not an ancestor of eye; use one of base, a, b"),
    ("bas", "eye", "bas is not an ancestor of eye; did you mean 'base'?"),
    ("eye", "base", "eye is not an ancestor of base")])
def test_what_is_not_on_the_path_is_named(base, link, words):
    with pytest.raises(DescriptionError) as caught:
        parse_tree(ROBOT).find_path(base, link)
    assert words in str(caught.value)


def test_the_tree_knows_its_root_and_keeps_the_order_of_the_file():
    tree = parse_tree(ROBOT)
    assert (tree.name, tree.root) == ("fork", "base")
    assert list(tree.links) == ["base", "a", "b", "eye", "hand"]
    assert list(tree.joints) == ["eye_joint", "j2", "j1", "j3"]
    with pytest.raises(TypeError):
        tree.joints["j4"] = tree.joints["j1"]


@pytest.mark.parametrize("text", [
    "", "no XML", "<robot/>", "<sdf name='r'/>", "<!DOCTYPE r [<!ENTITY a 'b'>]><robot name='r'/>"])
def test_what_is_no_robot_has_no_name(text):
    assert read_robot_name(text) == ""
    assert read_robot_name(ROBOT) == "fork"
    with pytest.raises(DescriptionError, match="document type and entity declarations") as caught:
        parse_tree("<!DOCTYPE r [<!ENTITY a 'ha'><!ENTITY b '&a;&a;'>]>" + ROBOT)
    assert "\n" not in str(caught.value)
