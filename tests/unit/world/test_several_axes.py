"""SDF joints with two axes or with a thread."""


import numpy as np
import pytest

from aras_sim_bridge.description import parse_sdf, parse_urdf, read_sdf
from aras_sim_bridge.errors import DescriptionError
from aras_sim_bridge.world import Pose, World

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
def test_a_screw_moves_its_child_along_as_it_turns(bolt, pitch):
    """As in Gazebo, by -1/pitch m a rad: a torque accelerates the inertia and the mass."""
    made = read("screw", f"<thread_pitch>{pitch}</thread_pitch><axis><xyz>0 0 1</xyz></axis>", bolt)
    assert not made.warnings
    with World(gravity=(0.0, 0.0, 0.0)) as world:
        model = world.spawn(made, "m")
        for _ in range(500):
            model.apply_effort("j", 0.1)
            world.step()
        state = dict(zip(model.joint_names, zip(*model.read_joints()[:2], strict=True),
                         strict=True))
        height = (model.link_pose("a").inverse() @ model.link_pose("b")).xyz[2]
        angle, speed = state["j"]
        assert height == pytest.approx(1.0 - angle / pitch, abs=1e-3)
        assert speed == pytest.approx(0.05 / (0.04 + 2.0 / pitch**2), rel=0.02)


@pytest.mark.parametrize(("kind", "inside", "reason"), [
    ("ball", "", "joint 'j': joint type 'ball' is not supported; use revolute"),
    ("gearbox", "", "joint 'j': joint type 'gearbox' is not supported"),
    ("screw", "<thread_pitch>0</thread_pitch>", "joint 'j': thread_pitch is 0 rad/m"),
    ("universal", "<axis><xyz>1 0 0</xyz></axis><axis2><xyz>-1 0 0</xyz></axis2>",
     "joint 'j': <axis> and <axis2> are parallel"),
])
def test_a_joint_that_cannot_be_is_named_and_the_world_starts(kind, inside, reason):
    with pytest.raises(DescriptionError, match=reason):
        read(kind, inside)
    text = MODEL.format(type=kind, inside=inside, bolt="", pose="", base="")
    inner = text.partition("<model")[2].partition("</sdf>")[0]
    found = read_sdf(f"<sdf version='1.7'><world name='w'><model{inner}<model name='n'><link "
                     "name='l'/></model></world></sdf>")
    assert [one.name for one in found.models] == ["n"]
    (line,) = found.warnings
    assert line.startswith("model 'm' is ignored: ") and reason in line


def test_a_link_that_a_joint_needs_has_a_name_of_its_own():
    with pytest.raises(DescriptionError, match="the simulator adds a link 'j_cross'"):
        parse_sdf(MODEL.format(type="universal", inside=CROSS.format("", ""), pose="", base="",
                               bolt="<link name='j_cross'/>"))


@pytest.mark.parametrize("more", ["", "<gazebo><link name='c'/></gazebo>"])
def test_a_planar_joint_of_a_urdf_slides_and_turns_in_its_plane(more):
    inertial = ("<inertial><mass value='2'/><inertia ixx='0.02' iyy='0.03' izz='0.04' ixy='0' "
                "ixz='0' iyz='0'/></inertial>")
    made = parse_urdf(
        f"<robot name='r'><link name='world'/><link name='b'>{inertial}</link><joint name='j' "
        "type='planar'><parent link='world'/><child link='b'/><origin xyz='0 0 1'/><axis xyz='0 0 "
        f"1'/></joint>{more}</robot>")
    assert not made.warnings and list(made.joints) == ["j_x", "j_y", "j"]
    with World() as world:
        model = world.spawn(made, "r")
        model.set_joint_positions({"j_x": 0.3, "j_y": -0.2, "j": 0.5})
        for _ in range(100):
            model.apply_effort("j_x", 2.0)
            world.step()
        at = model.link_pose("b")
        assert at.xyz == pytest.approx((0.3 + 0.5 * 0.1**2, -0.2, 1.0), abs=1e-4)
        assert at.rpy == pytest.approx((0.0, 0.0, 0.5), abs=1e-6)
