"""Restitution in SDF's surfaces and in Gazebo's tags of a URDF."""

import pytest

from aras_sim_bridge.description import parse_sdf, parse_urdf
from aras_sim_bridge.errors import DescriptionError


def surface(inside):
    return f"<surface><bounce>{inside}</bounce></surface>"


def urdf(inside):
    return parse_urdf("<robot name='r'><link name='a'/><gazebo reference='a'><collision>"
                      f"{surface(inside)}</collision></gazebo></robot>").links["a"]


def sdf(inside):
    return parse_sdf("<sdf version='1.6'><model name='m'><link name='a'><collision name='c'>"
                     "<geometry><sphere><radius>1</radius></sphere></geometry>"
                     f"{surface(inside)}</collision></link></model></sdf>").links["a"]


@pytest.mark.parametrize("parsed", [urdf, sdf])
@pytest.mark.parametrize(("inside", "expected"), [
    ("<restitution_coefficient>0.6</restitution_coefficient><threshold>0.2</threshold>",
     (0.6, 0.2)),
    ("<restitution_coefficient>1</restitution_coefficient>", (1.0, 0.0)),
    ("<restitution_coefficient>0</restitution_coefficient>", (0.0, 0.0)),
    ("<threshold>0.2</threshold>", None), ("", None)])
def test_a_surface_s_bounce(parsed, inside, expected):
    assert parsed(inside).bounce == expected


@pytest.mark.parametrize("parsed", [urdf, sdf])
@pytest.mark.parametrize(("inside", "words"), [
    ("<restitution_coefficient>1.2</restitution_coefficient>", "restitution_coefficient 1.2"),
    ("<restitution_coefficient>-0.1</restitution_coefficient>", "must be 0 to 1"),
    ("<restitution_coefficient>bouncy</restitution_coefficient>", "restitution_coefficient"),
    ("<restitution_coefficient>1</restitution_coefficient><threshold>-1</threshold>",
     "threshold -1.0")])
def test_an_impossible_bounce_is_refused(parsed, inside, words):
    with pytest.raises(DescriptionError, match=words):
        parsed(inside)
