"""Mesh files: damaged files are refused by name; images and collisions use the same mesh."""

import os
import struct

import numpy as np
import pytest

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.errors import DescriptionError
from aras_sim_bridge.world import Pose, World
from aras_visual_servo_base.meshes import files as mesh_files
from aras_visual_servo_base.meshes.files import read
from aras_visual_servo_base.meshes.mesh import MOST_MESHES, MOST_TRIANGLES

CORNERS = ((0, 0, 0), (0.1, 0, 0), (0, 0.1, 0), (0, 0, 0.1))
FACES = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))
INERTIAL = ('<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
            "</inertial>")


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
<technique_common><accessor source="#a" count="4" stride="3">
<param name="X"/><param name="Y"/><param name="Z"/></accessor>
</technique_common></source>
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
    text = text.replace(b'<triangles count="4">', b'<polylist count="4">')
    return text.replace(b"</triangles>", b"<vcount>" + each + b"</vcount></polylist>")


def polygon_list(*corners):
    text = dae("<p>0 2 1 0 1 3 0 3 2 1 2 3</p>").replace(b'<triangles count="4">', b"<polygons>")
    return text.replace(b"</triangles>", b"".join(b"<p>%b</p>" % each for each in corners)
                        + b"</polygons>")


# Name, content, what is said of it.
DAMAGED = [
    ("wrap.stl", bytes(80) + struct.pack("<I", 85899346) + bytes(4), "88 bytes are neither"),
    ("cut.stl", binary_stl()[:-60], "224 bytes are neither an ASCII STL file nor a binary STL file "
                                    "of 4"),
    ("flat.stl", binary_stl(((0, 0, 0), (1, 0, 0), (2, 0, 0), (3, 0, 0))), "with an area"),
    ("far.stl", binary_stl((*CORNERS[:3], (1e30, 0, 0))), "a corner is 1e+30, above 1e+09"),
    ("huge.dae", dae("<translate>0 0 0", "<translate>0 0 1e300"), "<translate> is 1e+300"),
    ("short.dae", dae("<translate>0 0 0", "<translate>0 0"), "<translate>: needs 3 numbers"),
    ("node.dae", dae("<translate>0 0 0</translate>", "<scale>1e8 1 1</scale>" * 2),
     "a transform is 1e+16, above 1e+09"),
    ("unit.dae", dae('meter="1"', 'meter="1e11"'), "a transform is 1e+11, above 1e+09"),
    ("nan_ascii.stl", ascii_stl().replace(b"vertex 0.1", b"vertex nan"), "a corner is not finite"),
    ("cut_ascii.stl", ascii_stl()[:250].rpartition(b"vertex")[0], "lines do not form triang"),
    ("empty.obj", b"", "the file has no faces"),
    ("far.obj", obj("f 1 2 99999999"), "line 9: a face refers to element 99999999, but there are "
                                       "4"),
    ("before.obj", b"f 1 2 3\n" + obj(), "line 1: a face refers to element 1, but there are 0"),
    ("normal.obj", obj("vn 0 0 1", "f 1//7 2//7 3//7"), "refers to element 7, but there are 1"),
    ("word.obj", obj("f SECRET 2 3"), "line 9: it contains an invalid number"),
    ("place.obj", b"v SECRET 1 1\n", "line 1: it contains an invalid number"),
    ("word.stl", b"solid SECRET\nvertex SECRET 1 1\n", "do not form"),
    ("word.dae", b"root:SECRET:0", "COLLADA: "),
    ("a.dae", b"<SECRET/>", "the root element is not <COLLADA>"),
    ("empty.dae", b"", "COLLADA: the description is empty"),
    ("utf16.dae", dae().decode().encode("utf-16"), "the file is not UTF-8 text"),
    ("entity.dae", b'<!DOCTYPE a [<!ENTITY b "c">]><COLLADA/>', "document type"),
    ("bare.dae", b"<COLLADA/>", "the scene contains no triangles"),
    ("meter.dae", dae('meter="1"', 'meter="-1"'), "<unit>: meter -1 must be positive"),
    ("65.dae", dae('offset="0"', 'offset="65"'), "an invalid offset"),
    ("array.dae", dae("float_array", "floats"), "No array found in source s"),
    ("source.dae", dae('source="#s"', 'source="#t"'), "there is no <source> '#t'"),
    ("offset.dae", dae(' offset="0"'), "<input>: offset is missing"),
    ("wide.dae", dae('offset="0"', 'offset="999999999"'), "an invalid offset"),
    ("far.dae", dae("<p>0 ", "<p>99999999 "), "(maxindex=99999999) for source 's' (len=4)"),
    ("back.dae", dae("<p>0 ", "<p>-1 "), "a face refers to position -1, but there are 4"),
    ("large.dae", polygons(dae(), b"3 3 3 2000000000"),
     "<polylist> with the count 4: <p> has 12 indices"),
    ("two.dae", polygons(dae(), b"2 4 3 3"), "each polygon needs at least three corners"),
    ("polygons.dae", polygon_list(b"0 2 1", b"0 1 3", b"0 3"), "has a polygon with fewer"),
    ("url.dae", dae(' url="#g"'), "<instance_geometry>: url '' does not start with #"),
    ("away.dae", dae('url="#g"', 'url="#h"'), "contains a geometry that does not exist: '#h'"),
    ("count.dae", dae('count="12"', 'count="2000000000"'), "count 2000000000, but 12 numbers"),
    ("nan.dae", dae(">0 0 0 0.1", ">nan 0 0 0.1"), "not finite"),
    # Thirty nodes that each show the one before twice: a thousand million.
    ("twice.dae", dae("</library_geometries>", "</library_geometries><library_nodes>" + "".join(
        f'<node id="n{k}">' + (f'<instance_node url="#n{k - 1}"/>' * 2 if k else "") + "</node>"
        for k in range(30)) + "</library_nodes>").replace(
            b'<instance_geometry url="#g"/>', b'<instance_node url="#n29"/>'),
     "the scene has more than 100000 nodes; simplify it"),
    ("loop.dae", dae('<instance_geometry url="#g"/>', '<instance_node url="#n"/>'), "cannot be"),
    ("a.ply", b"ply", "convert it to one of .dae, .glb, .gltf, .obj, .stl"),
]
SOUND = {
    "a.stl": binary_stl(), "B.STL": binary_stl(), "ascii.stl": ascii_stl(),
    "longer.stl": binary_stl() + b"more", "a.obj": obj(), "a.dae": dae(),
    "back.obj": b"\n".join([*obj().splitlines()[:4], b"f -4 -2 -3", b"f -4 -3 -1", b"f -4 -1 -2",
                            b"f -3 -2 -1", b"v 9 9 9"]),
    "p.dae": polygons(dae(), b"3 3 3 3"),
    "each.dae": polygon_list(b"0 2 1", b"0 1 3", b"0 3 2", b"1 2 3"),
    "comment.dae": dae("<p>", "<p><!-- mine -->"), "meter.dae": dae(' meter="1"'),
    "up.dae": dae("Z_UP"), "unit.dae": dae(">Z_UP", ">Y_UP"),
    "64.dae": dae('offset="0"/>\n<p>0 2 1 0 1 3 0 3 2 1 2 3',
                  'offset="64"/>\n<p>' + "".join("0 " * 64 + f"{i} " for f in FACES for i in f)),
    "later.dae": dae("</node>", "<node><scale>2 2 2</scale></node><scale>1 1 1</scale></node>")}


def robot(path, kind="visual"):
    shape = f'<{kind}><geometry><mesh filename="file://{path}"/></geometry></{kind}>'
    return f'<robot name="r"><link name="arm">{INERTIAL}{shape}</link></robot>'


@pytest.mark.parametrize("name, content, said", DAMAGED, ids=[case[0] for case in DAMAGED])
def test_a_damaged_mesh_is_refused_in_one_line(tmp_path, name, content, said):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(DescriptionError) as refused:
        read(str(path))
    text = str(refused.value)
    assert text.startswith(f"mesh file {path} ") and said in text
    assert text.endswith(("export it again", "simplify it")) or "convert it" in text
    assert len(text) < 500 and "SECRET" not in text  # nothing of what another file holds


@pytest.mark.parametrize("kind", ["visual", "collision"])
def test_a_robot_with_a_damaged_mesh_leaves_the_world_as_it_was(tmp_path, kind):
    path = tmp_path / "a.stl"
    path.write_bytes(binary_stl()[:-60])
    with World() as world:
        with pytest.raises(DescriptionError) as refused:
            world.spawn(parse_urdf(robot(path, kind)), "robot")
        assert not world.models
        world.spawn_ground_plane()
        world.step()
    assert str(refused.value).startswith(f"model 'robot', link 'arm', {kind}: mesh file {path} ")


def contents(path):
    """The one mesh of a file: its corners (T, 3, 3), and the volume that they enclose, m³."""
    (mesh,) = read(str(path))
    corners = mesh.positions[mesh.triangles].astype(float)
    a, b, c = corners.transpose(1, 0, 2)
    return corners, np.einsum("ni,ni->n", np.cross(a, b), c).sum() / 6


@pytest.mark.parametrize("name", SOUND)
def test_every_format_is_read_alike(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(SOUND[name])
    corners, volume = contents(path)
    assert sorted(map(tuple, np.unique(corners.reshape(-1, 3).round(6), axis=0).tolist())) \
        == sorted(CORNERS)
    assert volume == pytest.approx(0.1**3 / 6)


def test_a_mesh_that_is_damaged_after_the_spawn(tmp_path):
    path = tmp_path / "a.dae"
    path.write_bytes(dae())
    with World() as world:
        model = world.spawn(parse_urdf(robot(path)), "robot")
        path.write_bytes(b"<a/>")
        with pytest.raises(DescriptionError, match="not <COLLADA>"):
            world.reset_simulation()
        with pytest.raises(DescriptionError, match="not <COLLADA>"):
            world.change_model("robot", model.description)
        world.step()
        path.write_bytes(dae())
        world.reset_simulation()


def test_nodes_place_what_is_in_them_from_the_inside_out(tmp_path):
    """In units of half a metre; the up axis has no effect, as in Gazebo and rviz."""
    path = tmp_path / "a.dae"
    path.write_bytes(dae(
        '<translate>0 0 0</translate>\n<instance_geometry url="#g"/>',
        "<translate>1 0 0</translate><rotate>0 0 1 90</rotate><node><scale>2 3 4</scale>"
        '<translate>0 0 1</translate><instance_geometry url="#g"/></node>')
        .replace(b'meter="1"', b'meter="0.5"').replace(b"Z_UP", b"Y_UP"))
    (mesh,) = read(str(path))
    assert 2 * mesh.positions.min(axis=0) == pytest.approx([1 - 0.3, 0, 4], abs=1e-6)
    assert 2 * mesh.positions.max(axis=0) == pytest.approx([1, 0.2, 4.4], abs=1e-6)


def test_groups_of_an_obj_file_are_bodies_of_their_own(tmp_path):
    """Two feet apart carry nothing between them; as one convex body they would."""
    def block(x, first):
        corners = [(x + dx, y, z) for dx in (0, 0.1) for y in (-0.1, 0.1) for z in (0, 0.1)]
        faces = ("1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5", "2 6 8 4")
        return ["g foot", *("v {} {} {}".format(*corner) for corner in corners),
                *("f " + " ".join(str(int(i) + first) for i in face.split()) for face in faces)]

    path = tmp_path / "feet.obj"
    path.write_text("\n".join(block(-0.5, 0) + block(0.4, 8)))
    assert {mesh.piece for mesh in read(str(path))} == {1, 2}
    ball = "<geometry><sphere radius='0.05'/></geometry>"
    falling = parse_urdf(f"<robot name='b'><link name='b'>{INERTIAL}<collision>{ball}</collision>"
                         "</link></robot>")
    with World() as world:
        world.spawn_ground_plane()
        world.spawn(parse_urdf(robot(path, "collision")), "feet")
        between, above = (world.spawn(falling, f"at {x}", Pose((x, 0.0, 0.2))) for x in (0.0, 0.45))
        for _ in range(500):
            world.step()
        assert between.pose().xyz[2] == pytest.approx(0.05, abs=5e-3)
        assert above.pose().xyz[2] == pytest.approx(0.15, abs=5e-3)


def test_files_that_are_no_meshes_and_large_textures_are_refused_unread(tmp_path):
    pipe = tmp_path / "pipe.stl"
    os.mkfifo(pipe)
    folder = tmp_path / "folder.stl"
    folder.mkdir()
    (tmp_path / "zero.stl").symlink_to("/dev/zero")
    for name, reason in (("pipe.stl", "it is not a regular file"), ("folder.stl", "Is a dir"),
                         ("zero.stl", "it is not a regular file"), ("gone.stl", "No such")):
        with pytest.raises(DescriptionError, match=reason) as refused:
            read(str(tmp_path / name))
        assert refused.value.path == str(tmp_path / name) and name in str(refused.value)
    (tmp_path / "a.obj").write_text(
        "mtllib a.mtl\nusemtl m\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n"
        "f 1/1 2/2 3/3\n"
    )
    (tmp_path / "a.mtl").write_text("newmtl m\nmap_Kd huge.bmp\n")
    (tmp_path / "huge.bmp").write_bytes(
        struct.pack("<2sIHHIIiiHHIIiiII", b"BM", 0, 0, 0, 54, 40, 9000, 8000, 1, 24, *6 * (0,))
    )
    with pytest.raises(DescriptionError, match=r"huge.bmp has more than 64000000 pixels: make it"):
        read(str(tmp_path / "a.obj"))


def test_what_is_too_much_is_refused_before_it_is_read(tmp_path):
    path, most = tmp_path / "a.stl", MOST_TRIANGLES
    large = b"f 1 2%b\n" % (b" 3 4" * 500)  # 1000 triangles
    faces = large * (most // 1000 - 1) + b"f 1 2 3\n" * 1000
    (tmp_path / "a.obj").write_bytes(obj() + b"\n" + faces)
    with path.open("wb") as file:
        file.write(bytes(80) + struct.pack("<I", most + 1))
        file.truncate(84 + 50 * (most + 1))
    for name in ("a.stl", "a.obj"):
        with pytest.raises(DescriptionError, match=f"{most + 1} triangles, more than the limit of "
                                                   f"{most}; simplify"):
            read(str(tmp_path / name))
    many, most = tmp_path / "many.obj", MOST_MESHES
    many.write_bytes(b"v 0 0 0\nv 1 0 0\nv 0 1 0\n" + b"".join(
        b"usemtl m%d\nf 1 2 3\n" % n for n in range(most + 1)))
    with pytest.raises(DescriptionError, match=f"{most + 1} groups and materials, more than the"):
        read(str(many))
    os.truncate(path, mesh_files.LARGEST_FILE + 1)
    with pytest.raises(DescriptionError, match="268435457 bytes, more than the limit of 268435456"):
        read(str(path))


def test_a_file_is_read_once_until_it_or_what_it_names_changes(tmp_path):
    path, colours = tmp_path / "a.obj", tmp_path / "a.mtl"
    path.write_bytes(b"mtllib a.mtl\nusemtl m\n" + obj())
    (first,) = read(str(path))
    assert first.rgba == mesh_files.GREY
    assert read(str(path))[0] is first
    colours.write_text("newmtl m\nKd 1 0 0 and more\n")
    (red,) = read(str(path))
    assert red.rgba == (1.0, 0.0, 0.0, 1.0)
    colours.write_text("newmtl m\nKd 0 0 1.0\n")
    assert read(str(path))[0].rgba == (0.0, 0.0, 1.0, 1.0)
    colours.write_text("newmtl m\nKd 0 zero 1\n")
    with pytest.raises(DescriptionError, match="line 1: it contains an invalid number"):
        read(str(path))
    path.write_bytes(binary_stl())
    with pytest.raises(DescriptionError, match="no faces"):
        read(str(path))


TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n"


@pytest.mark.parametrize(("library", "named"), [
    ("newmtl m\nmap_Kd lost.png\nKd 1 0 0\n", "lost.png"), (None, "a.mtl"),
    ("newmtl other\nKd 1 0 0\n", "a.obj")])
def test_what_lacks_its_material_or_picture_is_grey_and_named(tmp_path, caplog, library, named):
    (tmp_path / "a.obj").write_text("mtllib a.mtl\nusemtl m\n" + TRIANGLE)
    if library is not None:
        (tmp_path / "a.mtl").write_text(library)
    (mesh,) = mesh_files.read(str(tmp_path / "a.obj"))
    assert (mesh.rgba, mesh.texture) == (mesh_files.GREY, None)
    (record,) = caplog.records
    assert str(tmp_path / named) in record.getMessage() and "grey" in record.getMessage()
