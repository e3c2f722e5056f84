"""URDF: effect of each element and attribute, and error messages."""

import math
import os
import re
from dataclasses import replace

import pytest

from aras_sim_bridge.description import (
    Geometry,
    Joint,
    JointLimits,
    Mimic,
    SoftLimits,
    Transmission,
    packages,
    parse_sdf,
    parse_urdf,
)
from aras_sim_bridge.errors import DescriptionError

LIMIT = "<limit lower='-1' upper='2' effort='3' velocity='4'/>"


def robot(inside, name="r"):
    return parse_urdf(f"<robot name='{name}'>{inside}</robot>")


A = "<link name='a'/>"
AB = A + "<link name='b'/>"


def joint(inside="", kind="fixed", name="j", ends="ab"):
    parent, child = ends
    return (f"<joint name='{name}' type='{kind}'><parent link='{parent}'/><child link='{child}'/>"
            f"{inside}</joint>")


def joined(inside, kind="revolute"):
    return robot(AB + joint(inside, kind)).joints["j"]


def shown(shape, tag="visual"):
    link = robot(f"<link name='a'><{tag}><geometry>{shape}</geometry></{tag}></link>").links["a"]
    return link.visuals if tag == "visual" else link.collisions


def test_a_joint_s_numbers_and_whom_it_mimics():
    found = joined(f"<origin xyz='1 2 3' rpy='.1 .2 .3'/><axis xyz='0 3 4'/>{LIMIT}"
                   "<dynamics damping='5' friction='6'/><safety_controller k_velocity='7' "
                   "k_position='8' soft_lower_limit='-.5' soft_upper_limit='.5'/>")
    assert (found.parent, found.child, found.kind, found.is_movable) == ("a", "b", "revolute", True)
    assert (found.origin_xyz, found.origin_rpy) == ((1, 2, 3), (0.1, 0.2, 0.3))
    assert found.axis == pytest.approx((0.0, 0.6, 0.8))
    assert found.limits == JointLimits(-1.0, 2.0, 3.0, 4.0)
    assert (found.damping, found.friction) == (5.0, 6.0)
    assert found.soft_limits == SoftLimits(-0.5, 0.5, 8.0, 7.0)
    assert found.mimic is None
    text = (AB + "<link name='c'/>" + joint(LIMIT, "revolute")
            + joint(LIMIT + "<mimic joint='{}'{}/>", "revolute", "k", "bc"))
    assert robot(text.format("j", "")).joints["k"].mimic == Mimic("j", 1.0, 0.0)
    full = robot(text.format("j", " multiplier='-2' offset='.5'"))
    assert full.joints["k"].mimic == Mimic("j", -2.0, 0.5)
    assert full.list_moving_joints() == ("j", "k")
    for more in ("", "<link name='d'/>" + joint(name="x", ends="ad")):
        with pytest.raises(DescriptionError, match="mimics 'x', which is not a moving joint"):
            robot(text.format("x", "") + more)
    with pytest.raises(DescriptionError, match="joint 'k': the <mimic> elements form a loop"):
        robot(text.format("k", ""))


def test_what_a_joint_leaves_open():
    found = joined(LIMIT, "prismatic")
    assert found.axis == joined("<axis/>" + LIMIT, "prismatic").axis == (1.0, 0.0, 0.0)
    assert Joint("j", "prismatic", "a", "b").axis == (1.0, 0.0, 0.0)
    assert (found.origin_xyz, found.origin_rpy) == ((0, 0, 0), (0, 0, 0))
    assert (found.damping, found.friction, found.soft_limits) == (0.0, 0.0, None)
    turned, moved = (joined(f"<origin {one}/>{LIMIT}") for one in ("rpy='1 2 3'", "xyz='4 5 6'"))
    assert (turned.origin_xyz, turned.origin_rpy) == ((0, 0, 0), (1, 2, 3))
    assert (moved.origin_xyz, moved.origin_rpy) == ((4, 5, 6), (0, 0, 0))
    for inside, kind, limits in (
            ("<limit effort='1' velocity='2'/>", "revolute", JointLimits(0.0, 0.0, 1.0, 2.0)),
            (LIMIT, "continuous", JointLimits(None, None, 3.0, 4.0)), ("", "continuous", None),
            ("<limit velocity='6'/>", "continuous", JointLimits(None, None, math.inf, 6.0)),
            ("<limit effort='5'/>", "continuous", JointLimits(None, None, 5.0, math.inf))):
        assert joined(inside, kind).limits == limits
    assert not joined("", "fixed").is_movable
    open_soft = joined(f"{LIMIT}<safety_controller k_velocity='1'/>").soft_limits
    assert open_soft == SoftLimits(None, None, 0.0, 1.0)


def test_meshes_name_their_files(tmp_path):
    file = tmp_path / "a.stl"
    file.touch()
    mesh = shown(f"<mesh filename='file://{file}' scale='1 2 -3'/>")[0].geometry
    assert (mesh.kind, mesh.filename, mesh.scale) == ("mesh", str(file), (1, 2, -3))
    assert shown(f"<mesh filename='{file}' scale='2'/>")[0].geometry.scale == (2, 2, 2)
    assert shown(f"<mesh filename='{file}'/>")[0].geometry.scale == (1, 1, 1)
    text = ("<robot name='r'><link name='a'><visual><geometry><mesh filename='package://p/a.stl'/>"
            "</geometry></visual></link></robot>")
    found = parse_urdf(text, lambda package: str(tmp_path) if package == "p" else "")
    assert found.links["a"].visuals[0].geometry.filename == str(file)


@pytest.mark.parametrize(("shape", "reason"), [
    ("<mesh filename='package://p/../a.stl'/>", "outside of package 'p'"),
    ("<mesh filename='package://p/b.stl'/>", "does not exist"),
    ("<mesh filename='package://gone/a.stl'/>", "package 'gone' is not in ROS_PACKAGE_PATH"),
    ("<mesh filename='a.stl'/>", "is a relative path"), ("<mesh/>", "has no filename"),
    ("<mesh filename='package://p/pipe.stl'/>", "is no regular file"),
    ("<mesh filename='package://p/whole.stl' scale='1 0 1'/>", "contains a zero"),
    ("<cone/>", "shape <cone> is not supported; use box, cylinder, sphere"),
    ("", "<geometry> with a shape is missing")])
@pytest.mark.parametrize("kind", ["visual", "collision"])
def test_a_shape_that_cannot_be_served_is_left_out_and_named(tmp_path, shape, reason, kind):
    package = tmp_path / "p"
    package.mkdir()
    os.mkfifo(package / "pipe.stl")
    for file in (tmp_path / "a.stl", package / "whole.stl"):
        file.touch()
    box = f"<{kind}><geometry><box size='1 1 1'/></geometry></{kind}>"
    found = parse_urdf(
        f"<robot name='r'><link name='a'>{box}<{kind}><geometry>{shape}</geometry></{kind}></link>"
        "</robot>", lambda name: str(package) if name == "p" else packages.find_package(name))
    assert len(found.links["a"].visuals + found.links["a"].collisions) == 1
    (warning,) = found.warnings
    assert re.search(reason, warning) and f"link 'a', {kind} 2" in warning
    assert warning.endswith(f"; the {kind} is ignored")


def test_inertials_masses_origins_and_names_of_parts():
    link = robot(
        "<link name='a'><inertial><origin xyz='1 2 3' rpy='.1 .2 .3'/><mass value='2'/>"
        "<inertia ixx='4' ixy='.1' ixz='.2' iyy='5' iyz='.3' izz='6'/></inertial>"
        "<visual name='v'><origin xyz='4 5 6' rpy='.4 .5 .6'/><geometry><sphere radius='1'/>"
        "</geometry></visual><collision><origin xyz='7 8 9'/><geometry><sphere radius='1'/>"
        "</geometry></collision><collision><geometry><sphere radius='2'/></geometry></collision>"
        "</link>").links["a"]
    assert (link.inertial.mass, link.inertial.origin_xyz) == (2.0, (1, 2, 3))
    assert link.inertial.origin_rpy == (0.1, 0.2, 0.3)
    assert link.inertial.inertia == (4.0, 0.1, 0.2, 5.0, 0.3, 6.0)
    (visual,) = link.visuals
    assert (visual.name, visual.origin_xyz, visual.origin_rpy) == ("v", (4, 5, 6), (0.4, 0.5, 0.6))
    assert [c.name for c in link.collisions] == ["a_collision", "a_collision_1"]
    assert link.collisions[0].origin_xyz == (7, 8, 9)
    assert link.gravity and not link.kinematic and link.mu is None
    link = "<link name='a'><inertial><mass value='{}'/></inertial></link>"
    made = robot(link.format(2))
    assert made.links["a"].inertial.inertia[0] == pytest.approx(0.002) and made.warnings
    massless = robot(link.format(0))
    assert massless.links["a"].inertial is None and massless.warnings == ()
    with pytest.raises(DescriptionError, match="link 'a': mass value is missing"):
        robot(link.replace("value='{}'", ""))


@pytest.mark.parametrize("inside, reason", [
    ("", "robot 'r' has no link"), ("<link/>", "a link has no name"),
    (f"<link name='{'a' * 256}'/><link name='{'b' * 257}'/>", "a link name has 257 characters"),
    (A + A, "two links are named 'a'"), (AB, "exactly one link without a parent, found 'a', 'b'"),
    (AB + 2 * joint(), "two joints are named 'j'"),
    (A + joint(), "robot 'r', joint 'j': link 'b' does not exist"),
    (AB + joint() + joint(name="k"), "link 'b' already has a parent"),
    (AB + joint() + joint(name="k", ends="ba"), "found none"),
    (AB + "<link name='c'/>" + joint(ends="cb") + joint(name="k", ends="bc"),
     "link 'b' is in a loop of joints, not in the tree of 'a'"),
    (AB + joint("", "screw"), "type 'screw' is unknown; use one of revolute"),
    (AB + joint("", "revolute"), "a revolute joint needs <limit lower="),
    (AB + "<joint type='fixed'/>", "a joint has no name"),
    (AB + "<joint name='j' type='fixed'><parent link='a'/></joint>", "has no <child link=…>"),
    (AB + joint("<mimic/>"), "<mimic> has no at"),
    (AB + joint("<dynamics damping='-1'/>"), "damping -1.0 and friction"),
    (AB + joint(LIMIT.replace("-1", "2.5"), "revolute"), "limit lower 2.5 is above upper 2.0"),
    (AB + joint("<limit lower='1' upper='2' velocity='1'/>", "revolute"), "effort is missing"),
    (AB + joint("<axis xyz='0 0 0'/>", "continuous"), "joint 'j': axis is the zero vector; give a"),
    ("<link name='a'><inertial/></link>", "link 'a': <inertial> has no <mass>"),
    ("<link name='a'><visual><geometry><box size='1 1'/></geometry></visual></link>",
     "link 'a', visual 1: box size: needs 3 numbers, got '1 1'"),
    ("<link name='a'><collision><geometry><sphere radius='-2'/></geometry></collision></link>",
     "link 'a', collision 1: sphere radius is -2.0; it must be positive")])
def test_what_is_wrong_is_named(inside, reason):
    with pytest.raises(DescriptionError, match=reason):
        robot(inside)


@pytest.mark.parametrize("before", [
    "<!-- c --><?xml version='1.0'?>", "\ufeff<?xml version='1.0'?>\n<!-- a -- b -->",
    "\n\n<!--\n<a>\n--><?xml version='1.0' encoding='utf-8'?><!---->"])
def test_comments_may_stand_anywhere_as_gazebo_takes_them(before):
    """Before the XML declaration and with dashes; lines are counted with them."""
    assert parse_urdf(f"{before}<robot name='r'><link name='a'/><!-- -- --></robot>").root == "a"
    line = before.count("\n") + 2
    with pytest.raises(DescriptionError, match=f"line {line}, column"):
        parse_urdf(f"{before}<robot name='r'>\n<link</robot>")


@pytest.mark.parametrize("text, reason", [
    ("", "the description is empty"), ("<robot name='r'>\n<!-- <link name='a'/></robot>", "line 2"),
    ("<sdf/>", "the root element is <sdf>, not <robot>"), ("<robot/>", "<robot> has no name"),
    ("<!DOCTYPE r [<!ENTITY a 'b'>]><robot name='r'/>", "document type and entity declarations"),
    ("<robot name='r'><xacro:if/></robot>", "<xacro:if> is not expanded; run xacro on the file"),
    ("<a>" * 65 + "</a>" * 65, "more than 64 elements are nested"),
    ("<robot name='r'>" + " " * 16_777_216 + "</robot>", "more than the limit of 16777216")])
def test_texts_that_are_no_urdf(text, reason):
    with pytest.raises(DescriptionError, match=reason):
        parse_urdf(text)


def test_long_chains_and_many_names_are_read_in_our_lifetime():
    """Each name compared with each, or each chain climbed from every link, would take hours."""
    count = 8_000
    links = "".join(f"<link name='l{k}'/>" for k in range(count))
    joints = "".join(joint(f"<mimic joint='j{k - 1}'/>" if k else "", "continuous", f"j{k}",
                           (f"l{k}", f"l{k + 1}")) for k in range(count - 1))
    assert robot(links + joints).root == "l0"
    eyes = "".join(f"<sensor type='camera' name='e{k}'><camera/></sensor>" for k in range(count))
    assert len(robot(f"<link name='a'/><gazebo reference='a'>{eyes}</gazebo>").cameras) == count


SHAPES = {  # shape: (settings, what they become)
    "box": ({"size": "1 2 3"}, {"size": (1, 2, 3)}),
    "cylinder": ({"radius": ".5", "length": "2"}, {"radius": 0.5, "length": 2.0}),
    "capsule": ({"radius": ".5", "length": "2"}, {"radius": 0.5, "length": 2.0}),
    "sphere": ({"radius": ".5"}, {"radius": 0.5}),
    "plane": ({"size": "2 3", "normal": "2 3 6"}, {"size": (2, 3, 0), "normal": (2, 3, 6)}),
}


def both(kind, settings):
    """Return functions that make the geometry of a URDF and of an SDF with this shape."""
    def urdf():
        inside = " ".join(f"{key}='{value}'" for key, value in settings.items())
        return shown(f"<{kind} {inside}/>")[0].geometry

    def sdf():
        inside = "".join(f"<{key}>{value}</{key}>" for key, value in settings.items())
        (part,) = parse_sdf(
            f"<sdf><model name='m'><link name='a'><collision name='c'><geometry><{kind}>{inside}"
            f"</{kind}></geometry></collision></link></model></sdf>").links["a"].collisions
        return part.geometry

    return urdf, sdf


@pytest.mark.parametrize("kind", SHAPES)
def test_each_shape_in_full_in_urdf_and_sdf(kind):
    settings, changes = SHAPES[kind]
    expected = Geometry(kind, **changes)
    for read in both(kind, settings):
        made, length = read(), math.hypot(*expected.normal)
        assert made.normal == pytest.approx([value / length for value in expected.normal])
        assert replace(made, normal=expected.normal) == expected


@pytest.mark.parametrize(("kind", "key"), [
    (kind, key) for kind, (settings, _) in SHAPES.items() for key in settings if key != "normal"])
def test_each_size_of_a_shape_is_a_positive_number(kind, key):
    """And is needed, but for a plane's; 0 is Gazebo's 0.1 mm, and is named."""
    settings, _ = SHAPES[kind]
    count = len(settings[key].split())
    for place in range(count):
        for bad in ("-1", "-1e-9"):
            text = " ".join(bad if k == place else "1" for k in range(count))
            reason = f"{kind} {key} is .*; it must be positive"
            for read in both(kind, settings | {key: text}):
                with pytest.raises(DescriptionError, match=reason):
                    read()
        text = " ".join("0" if k == place else "1" for k in range(count))
        for read in both(kind, settings | {key: text}):
            made = read()
            sizes = [made.radius, made.length, *made.size]
            assert sorted(size for size in sizes if size)[0] == 1e-4
    for read in both(kind, {name: settings[name] for name in settings if name != key}):
        if kind == "plane":
            assert read().normal == pytest.approx((2 / 7, 3 / 7, 6 / 7))
            assert read().size[:2] == ((0.0, 0.0) if read.__name__ == "urdf" else (1.0, 1.0))
        else:
            with pytest.raises(DescriptionError, match=f"{kind} {key} is missing"):
                read()
    for read in both(kind, settings | {key: settings[key] + " 9"}):
        with pytest.raises(DescriptionError, match=f"{kind} {key}: needs {count} numbers"):
            read()


def test_a_transmission_of_several_joints_and_interfaces():
    """Their names, each in the file's order; what is missing is empty."""
    made, bare = robot(
        "<link name='a'/><transmission name='t' type='attribute'><type>element</type>"
        "<joint name='j'><hardwareInterface>one</hardwareInterface><hardwareInterface> two "
        "</hardwareInterface></joint><joint><hardwareInterface/></joint><joint name='k'/>"
        "<actuator name='x'/></transmission><transmission/>").transmissions
    assert made == Transmission("t", "element", "j", "one", True, ("j", "", "k"),
                                ("one", "two", ""))
    assert bare == Transmission("", "", "", "", False)


@pytest.mark.parametrize("without", [None, "ixx", "ixy", "ixz", "iyy", "iyz", "izz"])
def test_what_an_inertia_does_not_name_is_zero(without):
    values = {"ixx": 4.0, "ixy": 0.1, "ixz": 0.2, "iyy": 5.0, "iyz": 0.3, "izz": 6.0}
    given = {key: value for key, value in values.items() if key != without}
    text = "".join(f" {key}='{value}'" for key, value in given.items())
    link = f"<link name='a'><inertial><mass value='2'/><inertia{text}/></inertial></link>"
    if without and without[1] == without[2]:  # a zero on the diagonal: products beside it
        with pytest.raises(DescriptionError, match="negative principal moment"):
            robot(link)
    else:
        made = robot(link).links["a"].inertial
        assert made.inertia == tuple(given.get(key, 0.0) for key in values)
        assert (made.origin_xyz, made.origin_rpy) == ((0, 0, 0), (0, 0, 0))
