"""SDF joints with two axes or with a thread, and shapes, are where they belong."""

from pathlib import Path

import numpy as np
import pytest

from aras_sim_bridge.description import parse_sdf, parse_urdf, read_sdf
from aras_sim_bridge.errors import DescriptionError
from aras_sim_bridge.world import Pose, World

ROBOT = Path(__file__).parents[3] / "src" / "aras_visual_servo_gazebo"
MASS = ("<inertial><mass>{0}</mass><inertia><ixx>{1}</ixx><iyy>{2}</iyy><izz>{3}</izz></inertia>"
        "</inertial>")
HEAVY, LIGHT = MASS.format(1e3, 1e3, 1e3, 1e3), MASS.format(2, 0.02, 0.03, 0.04)
MODEL = ("<sdf version='1.7'><model name='m'><link name='a'>{base}" + HEAVY
         + "</link><link name='b'><pose>0 0 1 0 0 0</pose>" + LIGHT
         + "</link>{bolt}<joint name='j' type='{type}'>{pose}<parent>a</parent><child>b</child>"
         "{inside}</joint></model></sdf>")
BOLT = "<joint name='k' type='fixed'><parent>world</parent><child>a</child></joint>"
CROSS = "<axis><xyz>1 0 0</xyz>{}</axis><axis2><xyz>0 1 0</xyz>{}</axis2>"


def read(kind, inside, bolt=BOLT, pose=""):
    return parse_sdf(MODEL.format(type=kind, inside=inside, bolt=bolt, pose=pose, base=""))


@pytest.mark.parametrize("kind", ["universal", "revolute2"])
def test_a_universal_joint_turns_about_both_axes(kind):
    limits = "<limit><lower>-1</lower><upper>0.5</upper></limit>"
    made = read(kind, CROSS.format(limits, "<dynamics><damping>0.2</damping></dynamics>"),
                pose="<pose>0 0 0.1 0 0 0</pose>")
    assert not made.warnings and list(made.joints) == ["k", "j", "j_2_frame", "j_2"]
    assert made.joints["j"].stops == (-1.0, 0.5) and made.joints["j_2"].damping == 0.2
    with World(gravity=(0.0, 0.0, 0.0)) as world:
        model = world.spawn(made, "m")
        model.set_joint_positions({"j": 0.3, "j_2": -0.4})
        expected = (Pose((0, 0, 1.1)) @ Pose.from_rpy((0, 0, 0), (0.3, 0, 0))
                    @ Pose.from_rpy((0, 0, 0), (0, -0.4, 0)) @ Pose((0, 0, -0.1)))
        np.testing.assert_allclose(model.link_pose("b").matrix(), expected.matrix(), atol=1e-9)


@pytest.mark.parametrize("bolt", [BOLT, ""])
@pytest.mark.parametrize("pitch", [20.0, -5.0])
def test_a_screw_moves_its_child_along_as_it_turns(make, bolt, pitch):
    """As in Gazebo, by -1/pitch m a rad: a torque accelerates the inertia and the mass."""
    made = read("screw", f"<thread_pitch>{pitch}</thread_pitch><axis><xyz>0 0 1</xyz></axis>", bolt)
    assert not made.warnings
    with World(gravity=(0.0, 0.0, 0.0)) as world:
        model = world.spawn(made, "m")
        make.step(world, 500, model, j=0.1)
        state = dict(zip(model.joint_names, zip(*model.read_joints()[:2], strict=True),
                         strict=True))
        height = (model.link_pose("a").inverse() @ model.link_pose("b")).xyz[2]
        angle, speed = state["j"]
        assert height == pytest.approx(1.0 - angle / pitch, abs=1e-3)
        assert speed == pytest.approx(0.05 / (0.04 + 2.0 / pitch**2), rel=0.02)


@pytest.mark.parametrize(("kind", "inside", "bolt", "reason"), [
    ("ball", "", "", "joint 'j': joint type 'ball' is not supported; use revolute"),
    ("screw", "<thread_pitch>0</thread_pitch>", "", "joint 'j': thread_pitch is 0 rad/m"),
    ("universal", "<axis><xyz>1 0 0</xyz></axis><axis2><xyz>-1 0 0</xyz></axis2>", "",
     "joint 'j': <axis> and <axis2> are parallel"),
    ("universal", CROSS.format("", ""), "<link name='j_cross'/>",
     "the simulator adds a link 'j_cross'")])
def test_a_joint_that_cannot_be_is_named_and_the_world_starts(kind, inside, bolt, reason):
    with pytest.raises(DescriptionError, match=reason):
        read(kind, inside, bolt)
    text = MODEL.format(type=kind, inside=inside, bolt=bolt, pose="", base="")
    inner = text.partition("<model")[2].partition("</sdf>")[0]
    found = read_sdf(f"<sdf version='1.7'><world name='w'><model{inner}<model name='n'><link "
                     "name='l'/></model></world></sdf>")
    assert [one.name for one in found.models] == ["n"]
    (line,) = found.warnings
    assert line.startswith("model 'm' is ignored: ") and reason in line


@pytest.mark.parametrize("more", ["", "<gazebo><link name='c'/></gazebo>"])
def test_a_planar_joint_of_a_urdf_slides_and_turns_in_its_plane(world, make, more):
    inertial = ("<inertial><mass value='2'/><inertia ixx='0.02' iyy='0.03' izz='0.04' ixy='0' "
                "ixz='0' iyz='0'/></inertial>")
    made = parse_urdf(
        f"<robot name='r'><link name='world'/><link name='b'>{inertial}</link><joint name='j' "
        "type='planar'><parent link='world'/><child link='b'/><origin xyz='0 0 1'/><axis xyz='0 0 "
        f"1'/></joint>{more}</robot>")
    assert not made.warnings and list(made.joints) == ["j_x", "j_y", "j"]
    model = world.spawn(made, "r")
    model.set_joint_positions({"j_x": 0.3, "j_y": -0.2, "j": 0.5})
    make.step(world, 100, model, j_x=2.0)
    at = model.link_pose("b")
    assert at.xyz == pytest.approx((0.3 + 0.5 * 0.1**2, -0.2, 1.0), abs=1e-4)
    assert at.rpy == pytest.approx((0.0, 0.0, 0.5), abs=1e-6)


def model(shape, static):
    parts = "".join(f'<{kind} name="{kind}"><geometry>{shape}</geometry></{kind}>'
                    for kind in ("visual", "collision"))
    return parse_sdf(f'<?xml version="1.0"?><sdf version="1.6"><model name="m"><static>{static}'
                     f'</static><link name="link">{parts}</link></model></sdf>')


@pytest.mark.parametrize(("shape", "height"), [
    ("<box><size>0.2 0.4 0.6</size></box>", 0.3), ("<sphere><radius>0.3</radius></sphere>", 0.3),
    ("<cylinder><radius>0.1</radius><length>0.6</length></cylinder>", 0.3),
    ("<plane><normal>0 0 1</normal><size>5 5</size></plane>", 0.0),
    (f"<mesh><uri>file://{ROBOT}/meshes/link1.stl</uri></mesh>", 0.1945)])
def test_shapes_carry_what_falls_on_them(world, make, shape, height):
    world.spawn(model(shape, 1), "m", Pose((1, 2, 0)))
    ball = model("<sphere><radius>0.05</radius></sphere>", 0)
    world.spawn(ball, "ball", Pose((1, 2, height + 0.08)))
    make.step(world, 300)
    assert world.models["ball"].pose().xyz[2] == pytest.approx(height + 0.05, abs=3e-3)
    assert world.models["m"].fixed_base
