"""Default values of every part of a description, in full."""

import math
from dataclasses import astuple

import pytest

from aras_sim_bridge.description import CameraPlugin, parse_sdf, parse_urdf, read_sdf
from aras_sim_bridge.errors import DescriptionError

NONE = (0.0, 0.0, 0.0)
HERE = (NONE, NONE)
STREAM = ("", "", "image_raw", "camera_info", "", 0.0, 0.0, 0.0, 0.0, 0.0, (0.0,) * 5, False, "",
          None)
LENS = ("gnomonical", True, math.pi / 2, None)


MASS = (1.0, NONE, NONE, (1.0, 0.0, 0.0, 1.0, 0.0, 1.0))
ENDLESS = (None, None, 1e16, 1e16)


def whole(made):
    """Return all values of a description as tuples and mappings."""
    parts = [{key: astuple(value) for key, value in part.items()}
             for part in (made.links, made.joints)]
    return (*astuple(made)[:2], *parts, *astuple(made)[4:])


def test_a_model_in_full():
    made = parse_sdf("<sdf><model name='m'><link name='a'/><link name='b'/><joint name='j' "
                     "type='revolute'><parent>a</parent><child>b</child></joint></model></sdf>")
    assert whole(made) == (
        "m", "a", {name: (name, MASS, (), (), True, False, None, None) for name in "ab"},
        {"j": ("j", "continuous", "a", "b", NONE, NONE, (0.0, 0.0, 1.0), ENDLESS, 0.0, 0.0, None,
               None, 0.0, 0.0)}, (), (), (), (), (), {}, False, (), HERE, {}, (), ())
    slide = parse_sdf("<sdf><model name='m'><link name='a'/><link name='b'/><joint name='j' "
                      "type='prismatic'><parent>a</parent><child>b</child></joint></model></sdf>")
    assert astuple(slide.joints["j"].limits) == (-1e16, 1e16, 1e16, 1e16)
    made = parse_urdf("<robot name='r'><link name='a'/></robot>")
    assert whole(made) == ("r", "a", {"a": ("a", None, (), (), True, False, None, None)}, {},
                           (), (), (), (), (), {}, False, (), HERE, {}, (), ())


def test_a_light_of_sdf_in_full():
    (bare,) = read_sdf("<sdf><light name='l'/></sdf>").lights
    assert astuple(bare) == ("l", "point", NONE, NONE, (1.0,) * 4, (0.1, 0.1, 0.1, 1.0),
                             (0.0, 0.0, -1.0), 1.0, 1.0, 0.0, 10.0, 0.6, 1.0, 1.0, False, None)
    (full,) = read_sdf(
        "<sdf><light name='l' type='spot'><pose>1 2 3 0.1 0.2 0.3</pose><diffuse>.1 .2 .3 .4"
        "</diffuse><specular>.5 .6 .7</specular><direction>2 3 -6</direction><attenuation>"
        "<constant>1.1</constant><linear>1.2</linear><quadratic>1.3</quadratic><range>1.4</range>"
        "</attenuation><spot><inner_angle>.8</inner_angle><outer_angle>.9</outer_angle><falloff>2"
        "</falloff></spot><cast_shadows>true</cast_shadows></light></sdf>").lights
    assert astuple(full) == (
        "l", "spot", (1, 2, 3), pytest.approx((0.1, 0.2, 0.3)), (0.1, 0.2, 0.3, 0.4),
        (0.5, 0.6, 0.7, 1.0), pytest.approx((2 / 7, 3 / 7, -6 / 7)), 1.1, 1.2, 1.3, 1.4, 0.8, 0.9,
        2.0, True, None)


@pytest.mark.parametrize("tag", ["diffuse", "specular"])
def test_a_light_s_colour_is_not_negative(tag):
    with pytest.raises(DescriptionError, match=f"light 'l': {tag} 0 -1 0 must not be negative"):
        read_sdf(f"<sdf><light name='l'><{tag}>0 -1 0</{tag}></light></sdf>")
    (dark,) = read_sdf(f"<sdf><light name='l'><{tag}>0 0 0 0</{tag}></light></sdf>").lights
    assert getattr(dark, tag) == (0.0, 0.0, 0.0, 0.0)


def stream(**changes):
    names = list(CameraPlugin.__dataclass_fields__)
    return tuple(changes.get(name, value) for name, value in zip(names, STREAM, strict=True))


def depth(farthest, rows):
    return stream(image_topic="ir/image_raw", info_topic="ir/camera_info", depth=(
        "depth/image_raw", "depth/camera_info", "points", 0.4, farthest, False, rows))


@pytest.mark.parametrize(("file", "expected"), [
    ("camera", STREAM), ("multicamera", STREAM),
    ("triggered_camera", stream(trigger_topic="image_trigger")),
    ("triggered_multicamera", stream(trigger_topic="image_trigger")),
    ("depth_camera", depth(math.inf, False)), ("openni_kinect", depth(5.0, True))])
def test_a_camera_and_its_plugin_in_full(file, expected):
    inside = ("<sensor name='e' type='camera'><camera><lens/><distortion/><noise/></camera><plugin "
              f"filename='libgazebo_ros_{file}.so'/></sensor>")
    for made in (
        parse_urdf(f"<robot name='r'><link name='a'/><gazebo reference='a'>{inside}</gazebo>"
                   "</robot>"),
        parse_sdf(f"<sdf><model name='m'><link name='a'>{inside}</link></model></sdf>"),
    ):
        assert made.warnings == ()
        assert astuple(made.cameras[0]) == (
            "e", "a", HERE, "camera", 0.0, 1.047, 320, 240, "R8G8B8", 0.1, 100.0,
            ("gaussian", 0.0, 0.0), (0.0,) * 5, (0.5, 0.5), LENS, expected, "")
