"""Meshes and models as other projects have them: names, materials and folders of their tools."""

import logging

import cv2
import numpy as np
import pytest

from aras_sim_bridge import Pose, Simulation, SimulationConfig, load_description
from aras_sim_bridge.description.shape_meshes import make_meshes
from aras_visual_servo_base.errors import DescriptionError
from aras_visual_servo_base.meshes import files as mesh_files
from aras_visual_servo_base.meshes.mesh import GREY

CUBE = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
FACES = [[q[i] for i in t] for q in QUADS for t in ((0, 1, 2), (0, 2, 3))]


def dae_geometry(name, low, size):
    corners = " ".join(str(x) for x in (np.array(low) + np.array(size) * CUBE).ravel())
    return (f'<geometry id="{name}" name="shape of {name}"><mesh>'
            f'<source id="{name}-s"><float_array id="{name}-a" count="24">{corners}</float_array>'
            f'<technique_common><accessor source="#{name}-a" count="8" stride="3"><param name="X"/>'
            '<param name="Y"/><param name="Z"/></accessor></technique_common></source>'
            '<source id="t"><float_array id="ta" count="16">' + "0 0 1 0 1 1 0 1 " * 2 +
            '</float_array><technique_common><accessor source="#ta" count="8" stride="2">'
            '<param name="S"/><param name="T"/></accessor></technique_common></source>'
            f'<vertices id="{name}-v"><input semantic="POSITION" source="#{name}-s"/></vertices>'
            f'<triangles count="12" material="look"><input semantic="VERTEX" source="#{name}-v" '
            'offset="0"/><input semantic="TEXCOORD" source="#t" offset="0" set="0"/><p>'
            + " ".join(str(i) for face in FACES for i in face)
            + "</p></triangles></mesh></geometry>")


DAE = ('<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" '
       'version="1.4.1"><asset><unit meter="1"/></asset>'
       '<library_images><image id="i"><init_from>paint.png</init_from></image></library_images>'
       '<library_effects><effect id="e"><profile_COMMON>'
       '<newparam sid="f"><surface type="2D"><init_from>i</init_from></surface></newparam>'
       '<newparam sid="s"><sampler2D><source>f</source></sampler2D></newparam>'
       '<technique sid="c"><phong><diffuse><color>0.25 0.5 1 1</color></diffuse></phong>'
       "</technique></profile_COMMON></effect></library_effects>"
       '<library_materials><material id="m"><instance_effect url="#e"/></material>'
       "</library_materials><library_geometries>" + dae_geometry("g", (2, 3, 4), (1, 2, 4))
       + dae_geometry("h", (0, 0, 0), (1, 1, 1)) + "</library_geometries>"
       '<library_visual_scenes><visual_scene id="w"><node id="n" name="Wheel"><node>'
       '<translate>0 0 10</translate><instance_geometry url="#g"><bind_material><technique_common>'
       '<instance_material symbol="look" target="#m"/></technique_common></bind_material>'
       '</instance_geometry></node></node><node id="b" name="Body"><instance_geometry url="#h"/>'
       "</node></visual_scene></library_visual_scenes>"
       '<scene><instance_visual_scene url="#w"/></scene></COLLADA>')
COLOUR, TEXTURE = "<color>0.25 0.5 1 1</color>", '<texture texture="s" texcoord="UV"/>'
IN_NODE = '<translate>0 0 10</translate>'


@pytest.mark.parametrize("old, new, rgba", [
    ("", "", (0.25, 0.5, 1.0, 1.0)),
    (COLOUR, "<color>0.25 0.5 1</color>", (0.25, 0.5, 1.0, 1.0)),
    # materials that cannot be read
    (COLOUR, "<color>0.25 blue 1 1</color>", GREY), (COLOUR, '<param ref="p"/>', GREY),
    ("<init_from>paint.png</init_from>", "", None), (COLOUR, TEXTURE, GREY),
    ('<instance_effect url="#e"/>', '<instance_effect url="#x"/>', GREY),
    ('<instance_effect url="#e"/>', "", GREY), ('target="#m"', 'target="#x"', GREY),
    ("profile_COMMON", "profile_GLSL", None), ("diffuse", "ambient", None),
    # parts that have no triangles
    (IN_NODE, IN_NODE + '<instance_camera url="#none"/><instance_light url="#none"/>'
     '<instance_controller url="#none"/><extra><technique profile="x"/></extra>', ...),
    ("<library_images>", '<library_lights><light id="l"/></library_lights><library_cameras>'
     '<camera id="c"/></library_cameras><library_controllers><controller id="k"/>'
     "</library_controllers><library_animations><animation/></library_animations>"
     "<library_images>", ...),
    ("<triangles", '<lines count="1"><p>0</p></lines><linestrips count="1"><p>0</p></linestrips>'
     "<triangles", ...),
    ("</library_geometries>", '<geometry id="c"><spline/></geometry></library_geometries>', ...),
    ('<node id="b"', '<node id="p"><instance_geometry url="#c"/></node><node id="b"', ...),
])
def test_all_triangles_of_a_collada_file_are_used(tmp_path, old, new, rgba, caplog):
    """Whatever is wrong with its materials, and whatever else it contains."""
    text = DAE if 'url="#c"' not in new else DAE.replace(
        "</library_geometries>", '<geometry id="c"><spline/></geometry></library_geometries>')
    assert old in text
    (tmp_path / "a.dae").write_text(text.replace(old, new))
    with caplog.at_level(logging.WARNING):
        wheel, body = mesh_files.read(str(tmp_path / "a.dae"))
    assert [len(wheel.triangles), len(body.triangles)] == [12, 12]
    assert np.allclose(wheel.positions.min(axis=0), [2, 3, 14])
    assert np.allclose(wheel.positions.max(axis=0), [3, 5, 18])
    wanted = (0.25, 0.5, 1.0, 1.0) if rgba is ... or old.startswith("<init_from") else rgba
    assert wheel.rgba == wanted and body.rgba is None
    assert ("material 'm' is drawn grey" in caplog.text or "'x' is drawn grey" in caplog.text) \
        == (wanted == GREY)


def test_an_image_without_a_file_leaves_the_triangles(tmp_path, caplog):
    text = DAE.replace("<init_from>paint.png</init_from>", "<!--<init_from>a.png</init_from>-->")
    (tmp_path / "a.dae").write_text(text.replace(COLOUR, TEXTURE))
    wheel, _ = mesh_files.read(str(tmp_path / "a.dae"))
    assert (len(wheel.triangles), wheel.rgba, wheel.texture) == (12, GREY, None)
    assert "material 'm' is drawn grey: image 'i' has no file" in caplog.text


@pytest.mark.parametrize("where, written", [
    ("car/meshes/a b.png", "a b.png"), ("car/meshes/a b.png", "a%20b.png"),
    ("car/meshes/part/a b.png", "part/a b.png"), ("car/meshes/part/a b.png", "part\\a b.png"),
    ("car/materials/textures/a b.png", "a b.png"),
    ("car/materials/textures/a b.png", "../materials/textures/a b.png"),
    ("car/materials/textures/a b.png", "C:\\work\\a b.png"),
    ("car/meshes/a b.png", "/home/somebody/a b.png"),
    ("car/meshes/a b.png", "file:///home/somebody/a%20b.png"),
    ("bus/materials/textures/a b.png", "model://bus/materials/textures/a b.png"),
])
@pytest.mark.parametrize("kind", ["dae", "obj"])
def test_a_texture_is_found_where_gazebo_models_have_it(tmp_path, where, written, kind, caplog):
    (tmp_path / where).parent.mkdir(parents=True)
    (tmp_path / "car" / "meshes").mkdir(exist_ok=True, parents=True)
    cv2.imwrite(str(tmp_path / where), np.zeros((2, 2, 3), np.uint8))
    path = tmp_path / "car" / "meshes" / f"m.{kind}"
    if kind == "dae":
        path.write_text(DAE.replace(COLOUR, TEXTURE).replace("paint.png", written))
    else:
        path.write_text("mtllib m.mtl\nusemtl look\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\n"
                        "vt 0 1\nf 1/1 2/2 3/3\n")
        path.with_suffix(".mtl").write_text(f"newmtl look\nKd 1 0 0\nmap_Kd {written}\n")
    texture = mesh_files.read(str(path))[0].texture
    assert texture is not None and (tmp_path / where).samefile(texture)
    assert "grey" not in caplog.text


def test_indices_of_texture_coordinates_that_the_file_does_not_have_are_ignored(tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1/1/1 2/2/2 3/3/3\n")
    (mesh,) = mesh_files.read(str(tmp_path / "a.obj"))
    assert mesh.uv is None and np.allclose(np.abs(mesh.normals), [0, 0, 1])


# ------------------------------------------------------------------ models

def obj_object(name, low, size, first):
    corners = np.array(low) + np.array(size) * CUBE
    return f"o {name}\n" + "".join(f"v {x} {y} {z}\n" for x, y, z in corners) + "".join(
        f"f {a + first} {b + first} {c + first}\n" for a, b, c in FACES)


OBJ = obj_object("Body", (0, 0, 0), (1, 1, 1), 1) + obj_object("Wheel", (2, 3, 14), (1, 2, 4), 9)
MESH = ("<geometry><mesh><uri>file://{file}</uri><scale>0.1 0.2 -0.5</scale><submesh>"
        "<name>{name}</name>{center}</submesh></mesh></geometry>")
MODEL = "<sdf version='1.6'><model name='m'>{}</model></sdf>"


def load(tmp_path, content):
    (tmp_path / "model.sdf").write_text(MODEL.format(content))
    return load_description(tmp_path / "model.sdf")


@pytest.mark.parametrize("center, low", [
    ("", (0.2, 0.6, -9.0)), ("<center>false</center>", (0.2, 0.6, -9.0)),
    ("<center>true</center>", (-0.05, -0.2, -1.0))])
@pytest.mark.parametrize("kind", ["dae", "obj"])
def test_a_submesh_is_used_by_its_name(tmp_path, kind, center, low):
    """A body of the submesh, which falls on the ground, is as high as the submesh alone."""
    file = tmp_path / f"parts.{kind}"
    file.write_text(DAE if kind == "dae" else OBJ)
    shape = MESH.format(file=file, name="Wheel", center=center)
    made = load(tmp_path, f"<link name='l'><visual name='v'>{shape}</visual>"
                f"<collision name='c'>{shape}</collision></link>")
    assert not made.warnings
    (visual,), (collision,) = made.links["l"].visuals, made.links["l"].collisions
    for part in (visual, collision):
        (mesh,) = make_meshes(part.geometry)
        assert np.allclose(mesh.positions.min(axis=0), low, atol=1e-6)
        assert np.allclose(np.ptp(mesh.positions, axis=0), (0.1, 0.4, 2.0), atol=1e-6)
    simulation = Simulation(SimulationConfig())
    try:
        model = simulation.spawn(made, "m", Pose((0.0, 0.0, 0.05 - low[2])))
        for _ in range(300):
            simulation.step()
        assert abs(model.link_pose("l").xyz[2] + low[2]) < 2e-3
    finally:
        simulation.close()


def test_a_submesh_that_the_file_does_not_have_is_named_with_those_that_it_has(tmp_path):
    file = tmp_path / "parts.dae"
    file.write_text(DAE)
    shape = MESH.format(file=file, name="Door", center="")
    made = load(tmp_path, f"<link name='l'><visual name='v'>{shape}</visual></link>")
    (warning,) = made.warnings
    assert "has no submesh 'Door'; its submeshes are: Wheel, Body; the visual is ignored" in warning
    assert made.links["l"].visuals == ()
    shape = shape.replace("<name>Door</name>", "<center>1</center>")
    (warning,) = load(tmp_path, f"<link name='l'><visual name='v'>{shape}</visual></link>").warnings
    assert "<submesh> has no <name>; add it; the visual is ignored" in warning


def test_a_link_with_many_shapes_is_loaded_whole(tmp_path):
    """Its description in one line would be longer than Bullet reads."""
    shapes = "".join(f"<collision name='c{k}'><pose>{k} 0 0 0 0 0</pose><geometry><sphere><radius>"
                     "0.3</radius></sphere></geometry></collision>" for k in range(150))
    simulation = Simulation(SimulationConfig())
    try:
        model = simulation.spawn(load(tmp_path, f"<link name='l'>{shapes}</link>"), "m",
                                 Pose((0.0, 0.0, 0.31)))
        for _ in range(200):
            simulation.step()
        assert abs(model.link_pose("l").xyz[2] - 0.3) < 1e-3
        assert np.allclose(model.link_pose("l").quat, (0, 0, 0, 1), atol=1e-3)
    finally:
        simulation.close()


@pytest.mark.parametrize("coefficient, slips", [("-1", False), ("0.5", True)])
@pytest.mark.parametrize("kind", ["urdf", "sdf"])
def test_a_negative_friction_coefficient_means_that_nothing_slips(
        tmp_path, kind, coefficient, slips):
    """Gravity is inclined by 56 degrees; the tangent is 1.5."""
    box = "<geometry><box{}</geometry>"
    if kind == "sdf":
        shape = box.format("><size>2 2 0.1</size></box>")
        surface = f"<surface><friction><ode><mu>{coefficient}</mu></ode></friction></surface>"
        text = MODEL.format(f"<link name='l'><collision name='c'>{shape}{surface}</collision>"
                            "</link>")
    else:
        text = ("<robot name='m'><link name='l'><inertial><mass value='1'/><inertia ixx='1' ixy='0'"
                " ixz='0' iyy='1' iyz='0' izz='1'/></inertial><collision>"
                + box.format(" size='2 2 0.1'/>") + "</collision></link><gazebo reference='l'>"
                f"<mu1>{coefficient}</mu1></gazebo></robot>")
    (tmp_path / f"box.{kind}").write_text(text)
    description = load_description(tmp_path / f"box.{kind}")
    simulation = Simulation(SimulationConfig(gravity=(6.0, 0.0, -4.0), ground_plane=False))
    try:
        floor = MODEL.format("<static>1</static><link name='l'><collision name='c'>" + box.format(
            "><size>9 9 1</size></box>") + "<surface><friction><ode><mu>-1</mu></ode></friction>"
            "</surface></collision></link>")
        (tmp_path / "floor.sdf").write_text(floor)
        simulation.spawn(load_description(tmp_path / "floor.sdf"), "f", Pose((0.0, 0.0, -0.5)))
        model = simulation.spawn(description, "m", Pose((0.0, 0.0, 0.05)))
        for _ in range(500):
            simulation.step()
        assert (model.link_pose("l").xyz[0] > 0.1) == slips
    finally:
        simulation.close()


@pytest.mark.parametrize("kind", ["screw", "universal"])
def test_a_chain_that_a_joint_of_two_axes_closes_is_left_open_with_a_warning(tmp_path, kind):
    made = load(tmp_path, "<link name='a'/><link name='b'><pose>0 0 1 0 0 0</pose></link>"
                "<joint name='j' type='revolute'><parent>a</parent><child>b</child><axis>"
                "<xyz>1 0 0</xyz></axis></joint>"
                f"<joint name='k' type='{kind}'><parent>a</parent><child>b</child><axis>"
                "<xyz>0 0 1</xyz></axis><axis2><xyz>0 1 0</xyz></axis2></joint>")
    assert any("joint 'k' is ignored, because it closes a chain" in text for text in made.warnings)
    assert list(made.links) == ["a", "b"] and list(made.joints) == ["j"] and not made.loops
    simulation = Simulation(SimulationConfig())
    try:
        simulation.spawn(made, "m")
    finally:
        simulation.close()


def test_an_error_that_a_missing_include_causes_names_the_include(tmp_path):
    with pytest.raises(DescriptionError, match=r"link 'arm::hand' does not exist.*<include> of "
                                        r"'model://no_arm' is ignored"):
        load(tmp_path, "<link name='a'/><include><uri>model://no_arm</uri></include>"
             "<joint name='j' type='fixed'><parent>a</parent><child>arm::hand</child></joint>")


@pytest.mark.parametrize("written", ["name='<STL_BINARY>'", "name=left_wheel", 'name = "a<b"'])
def test_attributes_that_gazebos_parser_accepts_are_read(tmp_path, written):
    text = MODEL.format(f"<link {written} >\n<inertial><mass>2</mass></inertial></link>")
    (tmp_path / "model.sdf").write_text("<!-- -- -->\n" + text)
    (link,) = load_description(tmp_path / "model.sdf").links.values()
    assert link.name in ("<STL_BINARY>", "left_wheel", "a<b") and link.inertial.mass == 2.0
    (tmp_path / "model.sdf").write_text("<!-- -- -->\n" + text.replace("</link>", "</ink>"))
    with pytest.raises(DescriptionError, match="line 3, column .*mismatched tag|line 2, column"):
        load_description(tmp_path / "model.sdf")


@pytest.mark.parametrize(("kind", "gravity", "speed"), [
    ("revolute", (0.0, 0.0, 0.0), 1.0), ("continuous", (0.0, 0.0, 0.0), 1.0),
    ("prismatic", (50.0, 0.0, 0.0), 12.5)])  # fmt: skip
def test_a_negative_effort_or_velocity_means_that_there_is_no_limit(tmp_path, kind, gravity, speed):
    """A constant torque or force accelerates the joint for 0.25 s."""
    body = ("<link name='b'><inertial><mass value='1'/><inertia ixx='1' ixy='0' ixz='0' iyy='1' "
            "iyz='0' izz='1'/></inertial></link>")
    (tmp_path / "a.urdf").write_text(
        f"<robot name='r'><link name='world'/>{body}<joint name='j' type='{kind}'>"
        "<parent link='world'/><child link='b'/><axis xyz='1 0 0'/><limit lower='-9' upper='9' "
        "effort='-1' velocity='-1.0'/></joint></robot>")
    robot = load_description(tmp_path / "a.urdf")
    assert (robot.joints["j"].limits.effort, robot.joints["j"].limits.velocity) == (np.inf, np.inf)
    simulation = Simulation(SimulationConfig(gravity=gravity))
    try:
        model = simulation.spawn(robot, "r")
        for _ in range(250):
            if kind != "prismatic":
                model.joints.apply_effort("j", 4.0)
            simulation.step()
        twist = model.link_twist("b")
        moved = twist.linear if kind == "prismatic" else twist.angular
        assert moved[0] == pytest.approx(speed, rel=0.02)
    finally:
        simulation.close()
