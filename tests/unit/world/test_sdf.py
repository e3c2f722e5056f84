"""SDF: shapes, colours, links, joints and lights; unsupported elements are named."""

import math
from pathlib import Path

import numpy as np
import pytest

from aras_sim_bridge.description import parse_sdf, read_sdf
from aras_sim_bridge.errors import DescriptionError
from aras_sim_bridge.world import Pose, World

ROBOT = Path(__file__).parents[3] / "src" / "aras_visual_servo_gazebo"
BOX = "<box><size>0.2 0.4 0.6</size></box>"


def part(kind, shape, extra=""):
    """A <visual> or <collision>."""
    return f'<{kind} name="{kind}"><geometry>{shape}</geometry>{extra}</{kind}>'


def model(links, extra="<static>1</static>", name="m"):
    """An SDF text of one model."""
    return f'<?xml version="1.0"?><sdf version="1.6"><model name="{name}">{extra}{links}' \
           "</model></sdf>"


def link(body, name="link", extra=""):
    """A <link>."""
    return f'<link name="{name}">{extra}{body}</link>'


def solid(shape, **options):
    """Return a link with a visual and a collision."""
    return link(part("visual", shape) + part("collision", shape), **options)


@pytest.mark.parametrize(("shape", "height"), [
    (BOX, 0.3), ("<sphere><radius>0.3</radius></sphere>", 0.3),
    ("<cylinder><radius>0.1</radius><length>0.6</length></cylinder>", 0.3),
    ("<plane><normal>0 0 1</normal><size>5 5</size></plane>", 0.0),
    (f"<mesh><uri>file://{ROBOT}/meshes/link1.stl</uri></mesh>", 0.1945),
])
def test_shapes_carry_what_falls_on_them(make, shape, height):
    with World() as world:
        world.spawn(parse_sdf(model(solid(shape))), "m", Pose((1, 2, 0)))
        ball = parse_sdf(model(solid("<sphere><radius>0.05</radius></sphere>"), ""))
        world.spawn(ball, "ball", Pose((1, 2, height + 0.08)))
        for _ in range(300):
            world.step()
        assert world.models["ball"].pose().xyz[2] == pytest.approx(height + 0.05, abs=3e-3)
        assert world.models["m"].fixed_base


def test_the_shipped_world_is_read():
    content = read_sdf((ROBOT / "world/aras_visual_servo.world").read_text())
    assert [m.name for m in content.models] == ["ground_plane"]
    assert content.models[0].colours == {"link": (0.7, 0.7, 0.7, 1.0)}
    (sun,) = content.lights
    assert (sun.name, sun.kind, sun.diffuse) == ("sun", "directional", (0.8, 0.8, 0.8, 1.0))
    assert sun.direction == pytest.approx(np.array((-0.5, 0.1, -0.9)) / math.sqrt(1.07))
    assert (sun.attenuation_constant, sun.attenuation_linear) == (0.9, 0.01)


@pytest.mark.parametrize(("text", "reason"), [
    (model(link(part("visual", "<box><size>1 1 -1</size></box>"))), "must be positive"),
    (model(link(part("visual", "<box><size>1 nan 1</size></box>"))), "not finite"),
    (model(link(part("visual", "<sphere/>"))), "sphere radius is missing"),
    (model('<model name="inner"/>'), "model 'm': <link> is missing"),
    (model(""), "<link> is missing"),
    (model(solid(BOX) + solid(BOX)), "two links are named 'link'"),
    (model(solid(BOX, name="a") + solid(BOX, name="b")
           + '<joint name="j" type="ball"><parent>a</parent><child>b</child></joint>', ""),
     "joint type 'ball' is not supported"),
    (model(solid(BOX) + '<joint name="j" type="fixed"><parent>x</parent><child>link</child>'
           "</joint>"), "link 'x' does not exist"),
    (model(solid(BOX, extra="<pose relative_to='q'>0 0 0 0 0 0</pose>")), "relative_to='q'"),
    ('<sdf version="1.6"/>', "no <model> and no <light>"),
    ("<robot name='r'/>", "not <sdf>"),
    ("<!DOCTYPE x [<!ENTITY a 'b'>]><sdf/>", "document type"),
    (model(solid(BOX, extra="<inertial><mass>-1</mass></inertial>")), "must not be negative"),
])
def test_what_is_not_supported_is_named(text, reason):
    with pytest.raises(DescriptionError, match=reason):
        parse_sdf(text)
