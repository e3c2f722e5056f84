"""Damaged mesh files are refused before Bullet, whose loaders die of many of them, gets them."""

import struct
import subprocess
import sys

import pytest

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.description.mesh_files import check
from aras_sim_bridge.errors import DescriptionError
from aras_sim_bridge.world import Pose, World

CORNERS = ((0, 0, 0), (0.1, 0, 0), (0, 0.1, 0), (0, 0, 0.1))
FACES = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))
INERTIAL = (
    '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    "</inertial>"
)


def binary_stl(corners=CORNERS, count=None):
    body = b"".join(
        struct.pack("<12fH", 0, 0, 1, *(x for i in face for x in corners[i]), 0) for face in FACES
    )
    return bytes(80) + struct.pack("<I", len(FACES) if count is None else count) + body


def ascii_stl():
    lines = ["solid tetrahedron"]
    for face in FACES:
        lines += ["facet normal 0 0 1", "outer loop"]
        lines += ["vertex {} {} {}".format(*CORNERS[i]) for i in face]
        lines += ["endloop", "endfacet"]
    return "\n".join([*lines, "endsolid tetrahedron"]).encode()


def obj(*more):
    lines = ["v {} {} {}".format(*corner) for corner in CORNERS]
    lines += ["f " + " ".join(str(i + 1) for i in face) for face in FACES]
    return "\n".join([*lines, *more]).encode()


def dae(old="", new=""):
    positions = " ".join(str(x) for corner in CORNERS for x in corner)
    text = f"""<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit meter="1"/><up_axis>Z_UP</up_axis></asset>
<library_geometries><geometry id="g"><mesh>
<source id="s"><float_array id="a" count="12">{positions}</float_array>
<technique_common><accessor source="#a" count="4" stride="3"/></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#s"/></vertices>
<triangles count="4"><input semantic="VERTEX" source="#v" offset="0"/>
<p>{" ".join(str(i) for face in FACES for i in face)}</p></triangles>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="scene"><node id="n"><translate>0 0 0</translate>
<instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#scene"/></scene></COLLADA>"""
    assert old in text
    return text.replace(old, new).encode()


def polygons(text, each):
    """The same with a <polylist>."""
    text = text.replace(b'<triangles count="4">', b'<polylist count="4">')
    return text.replace(b"</triangles>", b"<vcount>" + each + b"</vcount></polylist>")


GOOD = {"a.stl": binary_stl(), "B.STL": binary_stl(), "a.obj": obj(), "a.dae": dae(),
        "p.dae": polygons(dae(), b"3 3 3 3")}
# Name, content, what is said of it. Those marked end the process that gives them to Bullet.
FATAL = [
    ("wrap.stl", bytes(80) + struct.pack("<I", 85899346) + bytes(4), "88 bytes are neither"),
    ("far.obj", obj("f 1 2 99999999"), "line 9: a face refers to element 99999999 of 4"),
    ("back.obj", obj("f 1 2 -99999999"), "refers to element -99999999 of 4"),
    ("a.dae", b"<a/>", "its root element is <a>, not <COLLADA>"),
    ("bare.dae", b"<COLLADA/>", "<COLLADA> has no <asset>"),
    ("meter.dae", dae(' meter="1"'), "<unit> has no meter"),
    ("up.dae", dae("Z_UP"), "<up_axis> is empty"),
    ("name.dae", dae('geometry id="g"', "geometry"), "<geometry> has no id"),
    ("array.dae", dae("float_array", "floats"), "<source> has no <float_array>"),
    ("accessor.dae", dae("technique_common", "technique"), "has no <technique_common>"),
    ("source.dae", dae('source="#s"', 'source="#t"'), "there is no <source> 't'"),
    ("vertex.dae", dae('source="#v"', 'source="#w"'), "there is no 'w'"),
    ("offset.dae", dae(' offset="0"'), "<input> has no offset"),
    ("far.dae", dae("<p>0 ", "<p>99999999 "), "<triangles> names POSITION 99999999 of 4"),
    ("list.dae", polygons(dae("<p>0 ", "<p>99999999 "), b"3 3 3 3"), "<polylist> names POSITION"),
    ("meaning.dae", polygons(dae("POSITION", "PLACE"), b"3 3 3 3"), "<polylist> has no positions"),
    ("comment.dae", dae("<p>", "<p><!-- mine -->"), "a comment stands before"),
    ("url.dae", dae(' url="#g"'), "<instance_geometry> has no url"),
    ("scene.dae", dae('instance_visual_scene url="#scene"', "instance_visual_scene"), "no url"),
]
DAMAGED = [
    *FATAL,
    ("empty.stl", b"", "0 bytes are neither ASCII STL nor"),
    ("text.stl", b"this is a shopping list, not a mesh\n" * 9, "neither ASCII STL nor"),
    ("cut.stl", binary_stl()[:-60], "224 bytes are neither ASCII STL nor a binary one of 4"),
    ("none.stl", bytes(84), "it has no triangle with an area"),
    ("flat.stl", binary_stl(((0, 0, 0), (1, 0, 0), (2, 0, 0), (3, 0, 0))), "with an area"),
    ("nan.stl", binary_stl((*CORNERS[:3], (float("nan"), 0, 0))), "a corner is not finite"),
    ("cut_ascii.stl", ascii_stl()[:250].rpartition(b"vertex")[0], "'vertex' lines are no triang"),
    ("empty.obj", b"", "it has no faces"),
    ("zero.obj", obj("f 0 1 2"), "refers to element 0 of 4"),
    ("normal.obj", obj("f 1//7 2//7 3//7"), "refers to element 7 of 0"),
    ("word.obj", obj("f one two three"), "line 9: what should be a number is none"),
    ("inf.obj", obj("v inf 0 0"), "line 9: a vertex needs three finite numbers"),
    ("short.obj", obj("v 0 0"), "a vertex needs three finite numbers"),
    ("empty.dae", b"", "COLLADA: the description is empty"),
    ("cut.dae", dae()[:400], "COLLADA: line"),
    ("entity.dae", b'<!DOCTYPE a [<!ENTITY b "c">]><COLLADA/>', "document type"),
    ("count.dae", dae('count="12"', 'count="2000000000"'), "of 2000000000 has 12 numbers"),
    ("few.dae", dae('triangles count="4"', 'triangles count="5"'), "<p> has 12 indices"),
    ("nan.dae", dae(">0 0 0 0.1", ">nan 0 0 0.1"), "not finite"),
    # Bullet would look for the second transform for ever.
    ("loop.dae", dae("</node>", "<node><scale>1 1 1</scale></node><scale>1 1 1</scale></node>"),
     "<scale> comes after a <node>"),
    ("a.ply", b"ply", "convert it to one of .dae, .obj, .stl"),
]


def robot(path, kind="visual"):
    shape = f'<{kind}><geometry><mesh filename="file://{path}"/></geometry></{kind}>'
    return f'<robot name="r"><link name="arm">{INERTIAL}{shape}</link></robot>'


@pytest.mark.parametrize("kind", ["visual", "collision"])
@pytest.mark.parametrize("name, content, said", DAMAGED, ids=[case[0] for case in DAMAGED])
def test_a_damaged_mesh_is_refused_and_the_world_is_as_before(tmp_path, name, content, said, kind):
    path = tmp_path / name
    path.write_bytes(content)
    with World() as world:
        with pytest.raises(DescriptionError) as refused:
            world.spawn(parse_urdf(robot(path, kind)), "robot")
        assert not world.models
        world.spawn_ground_plane()
        world.step()
    text = str(refused.value)
    assert text.startswith(f"model 'robot', link 'arm', {kind}: mesh file {path} ")
    assert said in text
    assert text.endswith("export it again") or "convert it" in text


@pytest.mark.parametrize("name, content", [case[:2] for case in FATAL], ids=[c[0] for c in FATAL])
def test_the_fatal_ones_are_truly_fatal(tmp_path, name, content):
    """What the check keeps from Bullet is what Bullet dies of; else it would be too strict."""
    (tmp_path / name).write_bytes(content)
    (tmp_path / "robot.urdf").write_text(robot(tmp_path / name).replace("file://", ""))
    code = f"import pybullet as p; p.connect(p.DIRECT); p.loadURDF('{tmp_path}/robot.urdf')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, timeout=60)
    assert done.returncode < 0


@pytest.mark.parametrize("kind", ["visual", "collision"])
@pytest.mark.parametrize("name", GOOD)
def test_sound_meshes_are_read(tmp_path, name, kind):
    path = tmp_path / name
    path.write_bytes(GOOD[name])
    with World() as world:
        model = world.spawn(parse_urdf(robot(path, kind)), "robot")
        world.step()
        assert model.link_pose("arm").xyz[2] < 0.0


def test_a_mesh_that_is_damaged_after_the_spawn(tmp_path):
    path = tmp_path / "a.dae"
    path.write_bytes(dae())
    with World() as world:
        model = world.spawn(parse_urdf(robot(path)), "robot")
        path.write_bytes(b"<a/>")
        with pytest.raises(DescriptionError, match="not <COLLADA>"):
            world.reset_simulation()
        with pytest.raises(DescriptionError, match="not <COLLADA>"):
            world.change("robot", model.description)
        world.step()
        path.write_bytes(dae())
        world.reset_simulation()


@pytest.mark.parametrize("content", [
    binary_stl(), ascii_stl(), binary_stl() + b"more", obj(), dae(), polygons(dae(), b"3 3 3 3"),
], ids=["a.stl", "ascii.stl", "longer.stl", "a.obj", "a.dae", "polylist.dae"])  # fmt: skip
def test_every_format_is_collided_with(tmp_path, content, request):
    """Bullet alone makes no body of an ASCII STL, or of one that goes on behind its triangles."""
    path = tmp_path / request.node.callspec.id
    path.write_bytes(content)
    with World() as world:
        world.spawn_ground_plane()
        above = Pose((0.0, 0.0, 0.05), (0.0, 0.0, 0.0, 1.0))
        model = world.spawn(parse_urdf(robot(path, "collision")), "robot", above)
        for _ in range(1000):
            world.step()
        assert model.link_pose("arm").xyz[2] == pytest.approx(0.0, abs=0.01)


def test_a_scene_without_triangles_is_for_the_eye_only(tmp_path):
    path = tmp_path / "a.dae"
    path.write_bytes(dae('<instance_geometry url="#g"/>'))
    check(str(path))
    with pytest.raises(DescriptionError, match="its scene shows no <triangles>"):
        check(str(path), solid=True)


def test_larger_polygons_are_for_the_eye_only(tmp_path):
    path = tmp_path / "a.dae"
    path.write_bytes(polygons(dae(), b"4 4 4"))
    check(str(path))
    with pytest.raises(DescriptionError, match="more than three corners"):
        check(str(path), solid=True)
