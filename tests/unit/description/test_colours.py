"""Appearance of links: Gazebo's materials by name, and unknown names."""

import pytest

from aras_sim_bridge.description import parse_sdf, parse_urdf
from aras_sim_bridge.description.gazebo_materials import COLOURS, WHITE
from aras_sim_bridge.errors import DescriptionError
from aras_sim_bridge.simulation import Simulation

BOX = "<geometry><box size='1 1 1'/></geometry>"
SDF_BOX = "<geometry><box><size>1 1 1</size></box></geometry>"


def painted(name):
    yield parse_urdf(f"<robot name='r'><link name='a'><visual>{BOX}</visual></link>"
                     f"<gazebo reference='a'><material>{name}</material></gazebo></robot>")
    yield parse_sdf(f"<sdf><model name='r'><static>1</static><link name='a'><visual name='v'>"
                    f"{SDF_BOX}<material><script><name>{name}</name></script></material></visual>"
                    "</link></model></sdf>")


SHIPPED = """Grey DarkGrey White FlatBlack Black Red RedBright Green Blue SkyBlue Yellow ZincYellow
    Purple Turquoise Orange WhiteGlow RedGlow GreenGlow BlueGlow YellowGlow PurpleGlow TurquoiseGlow
    TurquoiseGlowOutline RedTransparentOverlay BlueTransparentOverlay GreenTransparentOverlay
    OrangeTransparentOverlay DarkOrangeTransparentOverlay RedTransparent GreenTransparent
    BlueTransparent DarkMagentaTransparent GreyTransparent YellowTransparent OrangeTransparent
    LightOn LightOff LightBlueLaser BlueLaser JointAnchor CoM WoodFloor CeilingTiled PaintedWall
    PioneerBody Pioneer2Body Gold GreyGradientSky CloudySky WoodPallet Wood Bricks Road Residential
    Tertiary Pedestrian Footway Motorway Lanes_6 Trunk Lanes_4 Primary Lanes_2 Secondary Lane_1
    Steps BuildingFrame WindowFrame Runway Grass"""


def test_every_material_that_gazebo_ships_has_a_colour():
    assert not {f"Gazebo/{name}" for name in SHIPPED.split()} - COLOURS.keys()
    assert all(len(rgba) == 4 and 0.0 <= min(rgba) <= max(rgba) <= 1.0 for rgba in COLOURS.values())


@pytest.mark.parametrize("name, nearest", [
    ("Gazebo/Chrome", "Gazebo/"), ("Black", "Gazebo/Black"), ("Mine/Gold", "Gazebo/Gold")])
def test_an_unknown_material_is_white_with_a_warning_and_costs_no_robot(name, nearest):
    for description in painted(name):
        assert description.colours == {"a": WHITE}
        (warning,) = description.warnings
        assert f"link 'a' is drawn white, because Gazebo has no material '{name}'" in warning
        assert f"did you mean '{nearest}" in warning
        simulation = Simulation()
        simulation.spawn(description, "r")
        assert "r" in simulation.world.models
        simulation.close()


def visual(material, name="v"):
    return f"<visual name='{name}'>{SDF_BOX}<material>{material}</material></visual>"


def shown(*visuals):
    made = parse_sdf("<sdf><model name='r'><link name='a'>" + "".join(
        one.replace("'v'", f"'v{k}'") for k, one in enumerate(visuals)) + "</link></model></sdf>")
    return made.colours.get("a"), made.warnings


PLAIN = f"<visual name='v'>{SDF_BOX}</visual>"
SCRIPT = "<script><name>Gazebo/{}</name></script>"
BLUE, GREEN = (0.0, 0.0, 1.0, 1.0), (0.1, 0.9, 0.2, 1.0)


@pytest.mark.parametrize(("material", "rgba"), [
    ("<diffuse>.1 .2 .3</diffuse>", (0.1, 0.2, 0.3, 1.0)),
    ("<diffuse>.1 .2 .3 .4</diffuse>", (0.1, 0.2, 0.3, 0.4)),
    ("<ambient>.1 .2 .3</ambient>", (0.1, 0.2, 0.3, 1.0)),
    ("<ambient>1 1 1 1</ambient><diffuse>.1 .2 .3 .4</diffuse>", (0.1, 0.2, 0.3, 0.4)),
    ("<diffuse>1 1 1</diffuse>" + SCRIPT.format("Blue"), BLUE),
    ("<emissive>0 0 0 1</emissive>", None), ("", None)])
def test_the_colour_of_a_visual_of_sdf(material, rgba):
    """A script's counts before a diffuse one, and that before an ambient one."""
    assert shown(visual(material)) == (rgba, ())
    assert shown(PLAIN, visual(material)) == (rgba, ())


def test_colours_of_the_first_visual_and_of_tags():
    green = visual("<diffuse>.1 .9 .2</diffuse>")
    blue = visual(SCRIPT.format("Blue"))
    assert shown(green, green) == (GREEN, ())
    for visuals, rgba in (((green, blue), GREEN), ((PLAIN, blue, PLAIN, green), BLUE)):
        assert shown(*visuals) == (
            rgba,
            ("link 'a': all visuals are drawn in the colour of the first visual; put visuals of "
             "other colours into other links",))
    text = "<robot name='r'><link name='a'/><gazebo reference='a'>{}</gazebo></robot>"
    for tag in ("<material>Gazebo/Blue</material>", "<material value='Gazebo/Blue'/>",
                "<material value='Gazebo/Blue'>Gazebo/Red</material>"):
        assert parse_urdf(text.format(tag)).colours == {"a": BLUE}
    for tag in ("<material/>", "<material value=''/>", ""):
        made = parse_urdf(text.format(tag))
        assert made.colours == {} and made.warnings == ()


@pytest.mark.parametrize("tag", ["diffuse", "ambient"])
def test_a_colour_has_three_numbers_or_four(tag):
    for text in ("1 2", "1 2 3 4 5", "red"):
        with pytest.raises(DescriptionError, match=f"link 'a': material {tag}: .*'{text}"):
            shown(visual(f"<{tag}>{text}</{tag}>"))
