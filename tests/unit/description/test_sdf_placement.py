"""Poses of links, shapes, joints and cameras in SDF, and their defaults."""

import math

import numpy as np
import pytest

from aras_sim_bridge.description import parse_sdf, read_sdf
from aras_sim_bridge.errors import DescriptionError
from aras_sim_bridge.world import World
from aras_visual_servo_base.poses import Pose


def model(inside):
    return parse_sdf(f"<sdf><model name='m'>{inside}</model></sdf>")


def link(name, pose, inside=""):
    return f"<link name='{name}'><pose>{pose}</pose>{inside}</link>"


def joint(inside="", kind="revolute", parent="a", child="b"):
    return (f"<joint name='j' type='{kind}'><parent>{parent}</parent><child>{child}</child>"
            f"{inside}</joint>")


@pytest.mark.parametrize("pitch", [-math.pi / 2, math.pi / 2])
def test_a_link_may_stand_on_its_nose(pitch):
    """At ±90° of pitch roll and yaw turn about one axis; the link's place is right all the same."""
    made = model(link("a", "0 0 0 0 0 0") + link("b", f"1 2 3 0.4 {pitch} 0.9") + joint())
    expected = Pose.from_rpy((1, 2, 3), (0.4, pitch, 0.9)).matrix()
    at = made.joints["j"]
    np.testing.assert_allclose(Pose.from_rpy(at.origin_xyz, at.origin_rpy).matrix(), expected,
                               atol=2e-7)
    with World() as world:
        np.testing.assert_allclose(world.spawn(made, "m").link_pose("b").matrix(), expected,
                                   atol=2e-7)


def test_numbers_of_joints_and_links():
    """A limit of 1e15 is none; an effort or a speed of 0 is one."""
    links = link("a", "0 0 0 0 0 0") + link("b", "0 0 1 0 0 0")
    made = model(links + joint("<axis><xyz>0 3 4</xyz><limit><lower>-1</lower><upper>2</upper>"
                               "<effort>3</effort><velocity>4</velocity></limit><dynamics>"
                               "<damping>5</damping><friction>6</friction></dynamics></axis>"))
    found = made.joints["j"]
    assert found.kind == "revolute" and found.axis == pytest.approx((0, 0.6, 0.8))
    assert (found.limits.lower, found.limits.upper) == (-1, 2)
    assert (found.limits.effort, found.limits.velocity) == (3, 4)
    assert (found.damping, found.friction) == (5, 6)
    free = model(links + joint("<axis><limit><effort>-1</effort></limit></axis>")).joints["j"]
    assert free.limits.effort >= 1e15, "SDF's -1 is no limit"
    for lower, upper in ((-1e15, 1e15), (-9e14, 1e15), (-1e15, 9e14), (0.5, 0.5)):
        found = model(links + joint(
            f"<axis><limit><lower>{lower}</lower><upper>{upper}</upper><effort>0</effort><velocity>0"
            "</velocity></limit></axis>")).joints["j"]
        endless = upper - lower == 2e15
        assert found.kind == ("continuous" if endless else "revolute")
        assert (found.limits.lower, found.limits.upper) == (
            (None, None) if endless else (lower, upper))
        assert (found.limits.effort, found.limits.velocity) == (0.0, 0.0)
    full = model(
        "<link name='a'><gravity>0</gravity><kinematic>1</kinematic><inertial><mass>2</mass>"
        "<inertia><ixx>3</ixx><ixy>.1</ixy><ixz>.2</ixz><iyy>4</iyy><iyz>.3</iyz><izz>5</izz>"
        "</inertia></inertial><collision name='c'><geometry><plane><size>3 4</size>"
        "<normal>0 3 4</normal></plane></geometry><surface><friction><ode><mu>.5</mu></ode>"
        "</friction></surface></collision>"
        "</link>").links["a"]
    assert full.inertial.inertia == (3, 0.1, 0.2, 4, 0.3, 5)
    assert (full.gravity, full.kinematic, full.mu) == (False, True, 0.5)
    plane = full.collisions[0].geometry
    assert (plane.size, plane.normal) == ((3, 4, 0), pytest.approx((0, 0.6, 0.8)))


@pytest.mark.parametrize("inside, reason", [
    (joint() + joint(), "two joints are named 'j'"),
    (joint("<axis><xyz expressed_in='c'>1 0 0</xyz></axis>"),
     "joint 'j': <xyz expressed_in='c'> names no link; give the axis in the joint's frame"),
    (joint("<axis><xyz>0 0 0</xyz></axis>"), "axis is the zero vector; give a direction"),
    (joint("<axis><limit><lower>2</lower><upper>1</upper></limit></axis>"), "2.0 is above upper"),
    (joint("<axis><dynamics><damping>-1</damping></dynamics></axis>"), "must be ≥ 0")])
def test_joints_that_cannot_be(inside, reason):
    with pytest.raises(DescriptionError, match=reason):
        model(link("a", "0 0 0 0 0 0") + link("b", "0 0 1 0 0 0") + inside)


PART = "<geometry><sphere><radius>1</radius></sphere></geometry>"


@pytest.mark.parametrize("text", [
    "<model{0}><link name='a'/></model>", "<light{0}/>", "<model name='m'><link{0}/></model>",
    f"<model name='m'><link name='a'><visual{{0}}>{PART}</visual></link></model>",
    f"<model name='m'><link name='a'><collision{{0}}>{PART}</collision></link></model>",
    "<model name='m'><link name='a'/><link name='b'/><joint{0} type='fixed'><parent>a</parent>"
    "<child>b</child></joint></model>"])
def test_what_needs_a_name_has_one_of_up_to_256_characters(text):
    for name in ("", " name=''", f" name='{257 * 'n'}'"):
        with pytest.raises(DescriptionError, match="needs a name of 1 to 256 characters"):
            read_sdf(f"<sdf>{text.format(name)}</sdf>")
    for name in ("n", 256 * "n"):
        named = f" name='{name}'"
        read_sdf(f"<sdf>{text.format(named)}</sdf>")


@pytest.mark.parametrize(("count", "lights", "words"), [
    (0, 1, "0 models and 1 lights"), (2, 0, "2 models and 0 lights"),
    (1, 1, "1 models and 1 lights")])
def test_one_model_at_a_time_can_be_spawned_and_one_world_simulated(count, lights, words):
    """Why there are fewer than meant is told with it."""
    text = "".join(f"<model name='m{k}'><link name='a'/></model>" for k in range(count))
    text += "".join(f"<light name='l{k}'/>" for k in range(lights))
    with pytest.raises(DescriptionError) as refused:
        parse_sdf(f"<sdf>{text}<include><uri>x://y</uri></include></sdf>")
    assert (f"SDF: the text has {words}; it must contain exactly one model; <include> of 'x://y' "
            "is ignored: ") in str(refused.value)
    world = "<world name='w'><model name='m'><link name='a'/></model></world>"
    assert len(read_sdf(f"<sdf>{world}<model name='n'/></sdf>").models) == 1
    with pytest.raises(DescriptionError, match="SDF: the text has 2 worlds, must have one"):
        read_sdf(f"<sdf>{world}{world}</sdf>")


@pytest.mark.parametrize("key", ["relative_to", "frame"])
def test_a_pose_is_in_the_frame_of_what_is_around(key):
    text = f"<link name='a'/><link name='b'><pose {key}='{{}}'>1 2 3 0 0 0</pose></link>{joint()}"
    for frame in ("world", "__model__", ""):
        assert model(text.format(frame)).joints["j"].origin_xyz == (1, 2, 3)
    with pytest.raises(DescriptionError, match="link 'b': <pose relative_to='c'> names no"):
        model(text.format("c"))


@pytest.mark.parametrize("inside", ["", "<pose>1 2 3 0 0 0</pose>"])
@pytest.mark.parametrize("kind", ["revolute", "prismatic", "fixed"])
@pytest.mark.parametrize(("parent", "child", "missing"), [
    ("x", "b", "x"), ("a", "x", "x"), ("a", "world", "world"), ("world", "world", "world"),
    ("", "b", ""), ("a", "", ""), ("world", "b", None), ("a", "b", None)])
def test_a_joint_s_ends_are_links_or_its_parent_the_world(inside, kind, parent, child, missing):
    text = link("a", "0 0 0 0 0 0") + link("b", "0 0 1 0 0 0") + joint(inside, kind, parent, child)
    if parent == "world":
        text += joint(kind="fixed", child="a", parent="world").replace("'j'", "'k'")
    if missing is None:
        assert model(text).joints["j"].parent == parent
    else:
        with pytest.raises(DescriptionError, match=f"joint 'j': link '{missing}' does not exist"):
            model(text)


TILTED = ((4.0, 5.0, 6.0, 0.3, -0.4, 1.5), (1.0, -2.0, 3.0, -0.5, 0.2, 0.7))


def six(pose):
    return " ".join(map(str, pose))


def test_all_that_is_on_the_root_link_is_turned_with_it_and_nothing_on_others():
    """Shapes, mass, cameras and an IMU, all tilted: by 4 x 4 matrices."""
    at = f"<pose>{six(TILTED[1])}</pose>"
    shape = f"{at}<geometry><box><size>1 2 3</size></box></geometry>"
    inside = (f"<visual name='v'>{shape}</visual><collision name='c'>{shape}</collision><inertial>"
              f"{at}<mass>2</mass></inertial><sensor name='{{0}}' type='camera'>{at}<camera/>"
              f"</sensor><sensor name='i' type='imu'>{at}<plugin filename="
              "'libgazebo_ros_imu_sensor.so'><frameName>f</frameName></plugin></sensor>")
    made = model(link("a", six(TILTED[0]), inside.format("on_a"))
                 + link("b", six(TILTED[0]), inside.format("on_b")) + joint())
    own, of_link = (Pose.from_rpy(pose[:3], pose[3:]).matrix() for pose in TILTED[::-1])
    for k, (name, expected) in enumerate((("a", of_link @ own), ("b", own))):
        part = made.links[name]
        sensors = [Pose.from_rpy(*one[k].pose) for one in (made.cameras, made.sensors)]
        placed = [part.visuals[0].pose, part.collisions[0].pose, part.inertial.pose]
        for pose in placed + sensors:
            np.testing.assert_allclose(pose.matrix(), expected, atol=1e-12)
