"""Every element of SDF 1.4 to 1.9 (http://sdformat.org/spec) changes the description, or is named
in one line, or has no meaning here."""

import pytest

from aras_sim_bridge.description import world_file
from aras_sim_bridge.description.supported_elements import BLOCKS

LINK = "<model name='m'><link name='l'>{}</link></model>"
BOX = "<geometry><box><size>1 2 3</size></box></geometry>"
CAMERA = LINK.format("<sensor name='s' type='{type}'>{{}}</sensor>")
LENS = "<camera name='c'><lens>{}</lens></camera>"
JOINT = ("<model name='m'><link name='a'/><link name='l'/><joint name='j' type='revolute'><parent>a"
         "</parent><child>l</child>{}</joint></model>")
VISUAL = "<visual name='v'>" + BOX + "{}</visual>"
COLLISION = "<collision name='c'>" + BOX + "{}</collision>"
FRICTION = COLLISION.format("<surface><friction>{}</friction></surface>")
CONTACT = COLLISION.format("<surface><contact>{}</contact></surface>")
ODE = JOINT.format("<physics><ode>{}</ode></physics>")
ODE_PHYSICS = "<physics type='ode'><ode>{}</ode></physics>"
# where, with {} for the element: (its block, elements that act, those without a meaning here).
# What a block takes with one value only, and what it does not know, is added below.
PLACES = {
    "{}": (
        "world",
        "<gravity>0 0 -3</gravity> <light name='k' type='point'/> <actor name='k'/>"
        " <model name='n'><link name='l'/></model> <plugin name='k' filename='libk.so'/>"
        " <joint name='k' type='fixed'/> <frame name='k' attached_to='x'/>"
        " <include><uri>model://sun</uri></include> <state><sim_time>3 0</sim_time></state>"
        " <population name='k'><model name='n'><link name='l'/></model><box><size>1 1 1</size>"
        "</box><model_count>2</model_count><distribution><type>random</type></distribution>"
        "</population>",
        "<gui/> <audio/> <atmosphere type='adiabatic'><temperature>3</temperature></atmosphere>"
        " <magnetic_field>1 2 3</magnetic_field> <spherical_coordinates/>"),
    "<wind>{}</wind>": ("world wind", "", ""),
    "<physics type='ode'>{}</physics>": (
        "world physics", "", "<real_time_factor>2</real_time_factor> <bullet/> <simbody/> <dart/>"),
    ODE_PHYSICS.format("<solver>{}</solver>"): ("world physics ode solver", "", ""),
    ODE_PHYSICS.format("<constraints>{}</constraints>"): ("world physics ode constraints", "", ""),
    "<scene>{}</scene>": (
        "world scene", "<ambient>1 0 0 1</ambient> <background>1 0 0 1</background> <sky/>",
        "<shadows>0</shadows> <grid>0</grid> <origin_visual>0</origin_visual>"),
    "<scene><fog>{}</fog></scene>": ("world scene fog", "", ""),
    "<scene><sky>{}</sky></scene>": ("world scene sky", "", ""),
    "<scene><sky><clouds>{}</clouds></sky></scene>": ("world scene sky clouds", "", ""),
    "<light name='k' type='spot'>{}</light>": ("light", "", ""),
    "<model name='m'><link name='l'/>{}</model>": (
        "model",
        "<static>1</static> <pose>1 0 0 0 0 0</pose> <frame name='k' attached_to='x'/>"
        " <gripper name='k'/> <plugin name='k' filename='libk.so'/>"
        " <include><uri>model://k</uri></include> <model name='n'><link name='l'/></model>",
        "<allow_auto_disable>0</allow_auto_disable>"),
    LINK: (
        "model link",
        "<gravity>0</gravity> <kinematic>1</kinematic> <pose>1 0 0 0 0 0</pose>"
        " <battery name='k'/> <sensor name='k' type='ray'/>",
        "<must_be_base_link>1</must_be_base_link>"),
    LINK.format("<velocity_decay>{}</velocity_decay>"): ("model link velocity_decay", "", ""),
    LINK.format("<inertial>{}</inertial>"): ("model link inertial", "", ""),
    LINK.format(VISUAL): (
        "model link visual", "<pose>1 0 0 0 0 0</pose> <plugin name='k' filename='libk.so'/>", ""),
    LINK.format(VISUAL.format("<material>{}</material>")): ("model link visual material", "", ""),
    LINK.format(COLLISION): (
        "model link collision", "<pose>1 0 0 0 0 0</pose>", "<max_contacts>3</max_contacts>"),
    LINK.format("<collision name='c'>{}</collision>"): (
        "model link collision",
        "<geometry><heightmap/></geometry> <geometry><ellipsoid/></geometry>"
        " <geometry><sphere><radius>1</radius></sphere></geometry>"
        " <geometry><mesh><uri>file:///x.stl</uri></mesh></geometry>"
        " <geometry><box><size>1 1 1</size><skin>3</skin></box></geometry>"
        " <geometry><mesh><uri>file:///x.stl</uri><submesh><name>k</name></submesh></mesh>"
        "</geometry>", "<geometry><empty/></geometry>"),
    LINK.format(COLLISION.format("<surface>{}</surface>")): (
        "model link collision surface",
        "<bounce><restitution_coefficient>0.5</restitution_coefficient></bounce>", ""),
    LINK.format(FRICTION): ("model link collision surface friction", "", ""),
    LINK.format(FRICTION.format("<ode>{}</ode>")): (
        "model link collision surface friction ode", "<mu>0.3</mu>", ""),
    LINK.format(FRICTION.format("<torsional>{}</torsional>")): (
        "model link collision surface friction torsional", "",
        # of a contact without a radius
        "<coefficient>3</coefficient> <use_patch_radius>0</use_patch_radius>"),
    LINK.format(FRICTION.format("<torsional><ode>{}</ode></torsional>")): (
        "model link collision surface friction torsional ode", "", ""),
    LINK.format(CONTACT): ("model link collision surface contact", "", ""),
    LINK.format(CONTACT.format("<ode>{}</ode>")): (
        "model link collision surface contact ode", "", ""),
    JOINT: ("model joint", "<pose>1 0 0 0 0 0</pose> <axis2><xyz>1 0 0</xyz></axis2>"
            " <sensor name='k' type='ray'/>", ""),
    JOINT.format("<axis>{}</axis>"): (
        "model joint axis",
        "<dynamics><spring_reference>1</spring_reference></dynamics>"
        " <dynamics><spring_stiffness>1</spring_stiffness></dynamics>", ""),
    JOINT.format("<axis><limit>{}</limit></axis>"): ("model joint axis limit", "", ""),
    JOINT.format("<physics>{}</physics>"): (
        "model joint physics", "",
        # the first is of a closed chain, where it acts
        "<simbody><must_be_loop_joint>1</must_be_loop_joint></simbody>"
        " <provide_feedback>1</provide_feedback>"),
    ODE: ("model joint physics ode", "", "<provide_feedback>1</provide_feedback>"
          " <implicit_spring_damper>1</implicit_spring_damper>"),
    ODE.format("<limit>{}</limit>"): ("model joint physics ode limit", "", ""),
    ODE.format("<suspension>{}</suspension>"): ("model joint physics ode suspension", "", ""),
    CAMERA.format(type="camera").format("<camera name='c'/>{}"): (
        "model link sensor camera",
        "<update_rate>3</update_rate> <pose>1 0 0 0 0 0</pose>"
        " <plugin name='k' filename='libk.so'/>",
        "<always_on>1</always_on> <visualize>1</visualize>"),
    CAMERA.format(type="camera").format("<camera name='c'>{}</camera>"): (
        "model link sensor camera camera", "<image><anti_aliasing>1</anti_aliasing></image>", ""),
    CAMERA.format(type="camera").format(LENS): (
        "model link sensor camera camera lens",
        "<type>equidistant</type> <intrinsics><s>3</s></intrinsics>",
        "<env_texture_size>64</env_texture_size>"),
    CAMERA.format(type="wideanglecamera").format(LENS): (
        "model link sensor camera camera lens",
        "<intrinsics><fx>30</fx></intrinsics>", "<env_texture_size>64</env_texture_size>"),
}


def cases():
    for place, (path, acting, idle) in PLACES.items():
        block = BLOCKS
        for name in path.split():
            block = block[name]
        acting = acting.replace("> <", ">\n<").splitlines() + ["<riverbed/>"]
        acting += [f"<{tag}>7</{tag}>" for tag, entry in block.items() if isinstance(entry, tuple)]
        yield from ((place, element, True) for element in acting)
        yield from ((place, element, False) for element in idle.replace("> <", ">\n<").splitlines())


@pytest.fixture(scope="module")
def read(tmp_path_factory):
    file = tmp_path_factory.mktemp("world") / "w.world"

    def made(inside):
        file.write_text(f"<sdf version='1.9'><world name='w'>{inside}</world></sdf>")
        found = world_file.load_world(str(file))
        return found.warnings, repr(found).replace(repr(found.warnings), "")

    return made


@pytest.mark.parametrize(("place", "element", "has_meaning"), list(cases()))
def test_each_element_acts_or_is_named_once(read, place, element, has_meaning):
    before, plain = read(place.replace("{}", ""))
    warnings, given = read(place.replace("{}", element))
    named = [text for text in warnings if text not in before]
    if has_meaning:
        assert len(named) == 1 or (given != plain and not named), named
    else:
        assert not named
