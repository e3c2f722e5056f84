"""Supported elements; every unsupported element is named once."""

import re

import pytest

from aras_sim_bridge.description import parse_urdf, read_sdf
from aras_sim_bridge.description.supported_elements import BLOCKS
from aras_sim_bridge.errors import DescriptionError
from aras_sim_bridge.world import World

URDF = ("<robot name='r'>{robot}<link name='a'>{link}<visual>{visual}<geometry><box size='1 1 1'/>"
        "</geometry></visual><collision>{collision}<geometry><box size='1 1 1'/></geometry>"
        "</collision></link><link name='b'/><joint name='j' type='continuous'><parent link='a'/>"
        "<child link='b'/>{joint}</joint><gazebo>{gazebo}</gazebo><gazebo reference='a'>{a}"
        "</gazebo><gazebo reference='j'>{j}</gazebo></robot>")
SENSORS = {
    "camera": "<camera>{}</camera>", "depth": "<camera><image>{}</image></camera>",
    "multicamera": "<camera><clip>{}</clip></camera>",
    "wideanglecamera": "<camera><lens>{}</lens></camera>", "contact": "<contact>{}</contact>",
    "imu": "<imu>{}</imu>"}
JOINT_SENSOR = "<sensor name='f' type='force_torque'><force_torque>{}</force_torque></sensor>"
JOINT = "<joint name='k' type='revolute'><parent>a</parent><child>b</child>{}</joint>"


def urdf_places():
    empty = dict.fromkeys(("robot", "link", "visual", "collision", "joint", "gazebo", "a", "j"), "")
    for key in empty:
        yield URDF.format(**{**empty, key: "{}"})
    for inside in ("<collision><surface>{}</surface></collision>", "<visual>{}</visual>",
                   "<visual><material>{}</material></visual>"):
        yield URDF.format(**{**empty, "a": inside})
    for kind, inside in SENSORS.items():
        for text in ("{}" + inside.format(""), inside):
            yield URDF.format(**{**empty, "a": f"<sensor name='s' type='{kind}'>{text}</sensor>"})
    yield URDF.format(**{**empty, "j": "<sensor name='s' type='force_torque'>{}</sensor>"})
    for inside in ("<link name='l'>{}</link>", JOINT, JOINT.format(JOINT_SENSOR)):
        yield URDF.format(**{**empty, "gazebo": inside})


def said(text):
    if text.startswith("<robot"):
        return list(parse_urdf(text).warnings)
    content = read_sdf(text)
    return [*content.warnings, *(one for model in content.models for one in model.warnings)]


UNKNOWN = ["<riverbed/>", "<light name='n'/>", "<projector name='n'><fov>1</fov></projector>",
           "<gripper name='n'/>", "<include><uri>model://x</uri></include>"]


@pytest.mark.parametrize("place", list(urdf_places()))
def test_an_element_that_is_not_served_is_named_once(place):
    """In blocks of URDF and of <gazebo> tags; SDF's blocks: test_sdf_elements.py."""
    for text in UNKNOWN:
        tag = re.match(r"<(\w+)", text)[1]
        before = said(place.replace("{}", ""))
        named = [one for one in said(place.replace("{}", text)) if one not in before]
        assert sum(f"<{tag}>" in one for one in named) == 1, named
        assert len(named) == 1 and named[0].endswith("not supported")
    assert said(place.replace("{}", "<other:tag xmlns:other='x'/>")) == said(
        place.replace("{}", ""))


GAZEBO = "<robot name='r'><link name='a'/><link name='b'/><joint name='j' type='continuous'>" \
         "<parent link='a'/><child link='b'/></joint>{}</robot>"


def test_one_sentence_names_what_is_left_out_in_the_same_places():
    tags = "".join(f"<gazebo reference='{link}'><kp>{k}</kp><kd>5</kd><mu1>1</mu1></gazebo>"
                   for k, link in enumerate("ab"))
    assert said(GAZEBO.format(tags)) == [
        "<gazebo reference='a'> and 1 more: <kp>, <kd> are ignored, because they are not supported"]


@pytest.mark.parametrize(("reference", "tag", "idle"), [
    (reference, tag, entry[0])
    for reference, block in (("a", "gazebo link"), ("j", "gazebo joint"))
    for tag, entry in BLOCKS[block].items() if isinstance(entry, tuple)])
def test_what_says_what_holds_anyway_is_not_named(reference, tag, idle):
    friction = "<mu1>0.5</mu1>" if reference == "a" else ""
    text = f"<gazebo reference='{reference}'>{friction}<{tag}>{{}}</{tag}></gazebo>"
    assert said(GAZEBO.format(text.format("0.5" if idle == "mu1" else idle))) == []
    assert any(f"<{tag}>" in one for one in said(GAZEBO.format(text.format(7))))


def test_gazebo_tags_add_links_and_joints_and_close_chains():
    """Frames of links are in the model's, axes in the joint's, as SDF has them."""
    added = ("<gazebo><link name='tip'><pose>0 0 3 0 0 0</pose><visual name='v'><geometry><sphere>"
             "<radius>1</radius></sphere></geometry><material><diffuse>1 0 0 1</diffuse></material>"
             "</visual></link><joint name='k' type='revolute'><parent>b</parent><child>tip</child>"
             "<axis><xyz>0 1 0</xyz><limit><lower>-1</lower><upper>1</upper></limit></axis></joint>"
             "<joint name='back' type='fixed'><parent>tip</parent><child>a</child></joint>"
             "</gazebo>")
    made = parse_urdf(GAZEBO.format(added))
    assert list(made.links) == ["a", "b", "tip"] and list(made.joints) == ["j", "k"]
    assert made.joints["k"].pose.xyz == (0, 0, 3) and made.joints["k"].axis == (0, 1, 0)
    assert made.colours["tip"] == (1, 0, 0, 1)
    assert [one.joint.name for one in made.loops] == ["back"]
    assert made.loops[0].in_parent.xyz == (0, 0, -3) and not made.warnings
    bolted = parse_urdf(GAZEBO.format("<gazebo><joint name='bolt' type='fixed'><parent>world"
                                      "</parent><child>a</child></joint></gazebo>"))
    assert bolted.root == "world" and list(bolted.joints) == ["j", "bolt"]


@pytest.mark.parametrize(("tag", "reason"), [
    ("<link name='a'/>", "two links are named 'a'; rename one; the link is ignored"),
    ("<link/>", "needs a name of 1 to 256 characters; the link is ignored"),
    (JOINT.format("").replace("revolute", "ball"), "joint 'k': joint type 'ball' is not supported"),
    (JOINT.format("").replace(">b", ">c"), "joint 'k': link 'c' does not exist; correct the name"),
    (JOINT.format("").replace("'k'", "'j'"), "two joints are named 'j'; rename one; the joint is")])
def test_what_a_gazebo_tag_adds_and_cannot_be_is_left_out_and_named(tag, reason):
    made = parse_urdf(GAZEBO.format(f"<gazebo>{tag}</gazebo>"))
    assert (list(made.links), list(made.joints), made.loops) == (["a", "b"], ["j"], ())
    (warning,) = made.warnings
    assert reason in warning


def test_a_visual_of_a_gazebo_tag_paints_its_link():
    """And yes and no are words of Gazebo's tags."""
    made = parse_urdf(GAZEBO.format(
        "<gazebo><static>yes</static></gazebo><gazebo reference='b'><turnGravityOff>no"
        "</turnGravityOff><visual><material><ambient>1 0 0 1</ambient><diffuse>0 1 0 1</diffuse>"
        "</material></visual></gazebo>"))
    assert made.colours == {"b": (0, 1, 0, 1)} and not made.warnings
    assert made.static and made.links["b"].gravity


@pytest.mark.parametrize(("root", "parts"), [("world", []), ("a", ["b"])])
def test_a_floating_joint_lets_its_child_go(root, parts):
    """From an empty world link on, the child is the robot; from another link on, a body more."""
    mass = "<inertial><mass value='1'/><inertia ixx='1' iyy='1' izz='1'/></inertial>"
    inside = "" if root == "world" else mass
    made = parse_urdf(
        f"<robot name='r'><link name='{root}'>{inside}</link><link name='b'>{mass}</link>"
        f"<link name='c'>{mass}</link><joint name='f' type='floating'><parent link='{root}'/><child"
        " link='b'/><origin xyz='1 2 3' rpy='0 0 1'/></joint><joint name='j' type='continuous'>"
        "<parent link='b'/><child link='c'/><origin xyz='0 0 1'/></joint></robot>")
    assert [part.root for part in made.parts] == parts
    free = made.parts[0] if parts else made
    assert (free.root, free.initial_pose[0]) == ("b", (1, 2, 3))
    assert free.initial_pose[1] == pytest.approx((0, 0, 1))
    assert list(free.joints) == ["j"] and free.joints["j"].origin_xyz == (0, 0, 1)


@pytest.mark.parametrize("stiffness", ["-1", "soft"])
def test_a_spring_that_cannot_be_is_named(stiffness):
    with pytest.raises(DescriptionError, match="<gazebo reference='j'>: springStiffness"):
        parse_urdf(GAZEBO.format("<gazebo reference='j'><springStiffness>"
                                 f"{stiffness}</springStiffness></gazebo>"))


LIMIT = "<limit lower='{}' upper='{}' effort='1' velocity='1'/>"
TURNED = ("<robot name='r'><link name='a'/><link name='b'/><joint name='j' type='{}'><parent "
          "link='a'/><child link='b'/>{}{}</joint></robot>")


@pytest.mark.parametrize(("text", "reason"), [
    (TURNED.format("revolute", LIMIT.format(-180, 180), ""),
     "joint 'j': its limits -180 180 must be in radians, but look like degrees; write -3.1416"),
    (TURNED.format("revolute", LIMIT.format(-1, 1), "<origin rpy='90 0 -45'/>"),
     "joint 'j': origin rpy 90 0 -45 must be in radians, but looks like degrees; write 1.5708"),
    (TURNED.format("revolute", LIMIT.format(-18.5, 12.6), "<origin rpy='6.25 -3.14 0'/>"), ""),
    (TURNED.format("prismatic", LIMIT.format(-180, 180), ""), ""),
    ("<sdf><model name='m'><link name='a'><pose>0 0 0 0 0 90</pose></link></model></sdf>",
     "model 'm', link 'a': pose: roll pitch yaw 0 0 90 must be in radians, but looks like degrees"),
    ("<sdf><model name='m'><link name='a'/><link name='b'/><joint name='j' type='revolute'><parent>"
     "a</parent><child>b</child><axis><limit><lower>-90</lower><upper>90</upper></limit></axis>"
     "</joint></model></sdf>", "model 'm', joint 'j': its limits -90 90 must be in radians"),
    ("<sdf><model name='m'><pose>100 20 0 0 0 1.57</pose><link name='a'/></model></sdf>", "")])
def test_degrees_where_radians_belong_are_named_with_the_radians(text, reason):
    found = said(text)
    assert len(found) == bool(reason) and reason in "".join(found)


def test_a_mesh_in_millimetres_is_named_with_the_scale(tmp_path, caplog):
    path = tmp_path / "arm.stl"
    corners = ((0, 0, 0), (300, 0, 0), (0, 200, 0), (0, 0, 100))
    faces = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))
    path.write_text("solid a\n" + "".join(
        "facet normal 0 0 0\nouter loop\n" + "".join(
            "vertex {} {} {}\n".format(*corners[k]) for k in face) + "endloop\nendfacet\n"
        for face in faces) + "endsolid a\n")
    text = ("<robot name='r'><link name='a'><visual><geometry><mesh filename="
            f"'{path}'{{}}/></geometry></visual></link></robot>")
    with World() as world:
        world.spawn(parse_urdf(text.format(" scale='0.001 0.001 0.001'")), "small")
        assert not caplog.messages
        world.spawn(parse_urdf(text.format("")), "large")
    (line,) = caplog.messages
    assert "model 'large', link 'a', visual" in line and "is 300 m large; if it is in mill" in line
