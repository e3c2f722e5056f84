"""The renderer draws the geometry in Bullet, and reports unsupported features."""

from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest
from scenes import Bench, bright_renderer, looking

from aras_sim_bridge import rendering
from aras_sim_bridge.camera import CameraConfig, CameraSensor
from aras_sim_bridge.description import Geometry
from aras_sim_bridge.errors import RenderingError
from aras_sim_bridge.rendering import View
from aras_sim_bridge.world import Pose
from aras_visual_servo_base.meshes import files as mesh_files

K = np.array([[150.0, 0, 80.3], [0, 155.0, 55.8], [0, 0, 1]])


def view(eye=(2.0, -1.5, 1.2), at=(0.0, 0.0, 0.3), **changes):
    return View(160, 120, looking(eye, at), changes.pop("K", K), **changes)


def furnish(bench):
    """Add one of every shape, some rotated, with their centres of mass off their origins."""
    bench.box([0.2, 0.1, 0.3], [0, 0.6, 0.3], "Gazebo/Red", orientation=(0.1, 0, 0, 0.995))
    shapes = [Geometry("sphere", radius=0.2), Geometry("cylinder", radius=0.15, length=0.5),
              Geometry("capsule", radius=0.1, length=0.4)]
    for n, shape in enumerate(shapes):
        bench.body(shape, [0.5 * n - 0.5, -0.3, 0.5], "Gazebo/Blue", (0.5, 0.5, 0.5, 0.5),
                   com=(0.1, 0.05, -0.1))
    bench.world.spawn_ground_plane()


def test_a_grey_camera_delivers_the_luminance_of_the_coloured_image(bench):
    furnish(bench)
    renderer = bright_renderer(bench.world)
    rgb, grey = renderer.render(view()), renderer.render_grey(view())
    luminance = rgb.astype(float) @ [0.299, 0.587, 0.114]
    assert grey.dtype == np.uint8 and len(np.unique(grey)) > 50
    assert np.abs(grey - luminance).max() <= 0.501
    settings = {"width": 160, "height": 120, "format": "mono16"}
    sensor = CameraSensor(CameraConfig.from_mapping(settings), renderer)
    pose = np.eye(4)
    image = sensor.capture(pose, 40_000_000).image
    expected = renderer.render_grey(sensor.make_view(pose)).astype(np.uint16) * 257
    np.testing.assert_array_equal(image, expected)


def test_models_come_and_go(bench):
    renderer = bright_renderer(bench.world)
    empty = renderer.render(view())
    assert np.isin(empty, (178, 179)).all(), "an empty world is Gazebo's grey"
    body = bench.box([0.3, 0.3, 0.3], [0, 0, 0.3], "Gazebo/Green")
    with_box = renderer.render(view())
    green = (with_box[..., 1] > 60) & (with_box[..., 0] == 0)
    assert green.mean() > 0.05
    body.set_pose(Pose((0.0, 0.0, 5.0)))
    assert (renderer.render(view()) == empty).all()
    bench.world.delete(body.name)
    assert (renderer.render(view()) == empty).all()


def test_unknown_renderer_lists_what_there_is(bench):
    with pytest.raises(RenderingError, match="'vulkan'; use one of auto, exact, tiny, opengl"):
        rendering.create_renderer("vulkan", bench.world)


def test_several_renderers_and_threads_do_not_mix(bench):
    other = Bench()
    furnish(bench)
    other.box([0.3, 0.3, 0.3], [0, 0, 0.3], "Gazebo/Green")
    renderers = [bright_renderer(b.world) for b in (bench, other)]
    alone = [renderer.render(view()) for renderer in renderers]
    assert (alone[0] != alone[1]).any()
    with ThreadPoolExecutor(1) as pool:
        for renderer, picture in zip(renderers, alone, strict=True):
            assert (pool.submit(renderer.render, view()).result() == picture).all()
            assert (renderer.render(view()) == picture).all()
    for _ in range(2):
        renderers[1].close()
    assert (renderers[0].render(view()) == alone[0]).all()
    with pytest.raises(RenderingError, match="closed"):
        renderers[1].render(view())
    other.close()


CUBE_OBJ = """mtllib cube.mtl
v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0
vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1
usemtl {material}
f 1/1 2/2 3/3 4/4
"""


def test_obj_materials_and_textures(bench, tmp_path):
    (tmp_path / "cube.mtl").write_text(
        "newmtl plain\nKd 0 0.5 1\nnewmtl picture\nKd 1 1 1\nmap_Kd half.png\n"
    )
    painted(tmp_path / "half.png")
    for material in ("plain", "picture"):
        path = tmp_path / f"{material}.obj"
        path.write_text(CUBE_OBJ.format(material=material))
        check_quarters(bench, path, material == "picture")


def painted(file) -> None:
    """Return an image whose right half contains red and whose upper half contains green."""
    picture = np.zeros((64, 64, 3), np.uint8)
    picture[:, 32:, 2] = 255  # OpenCV's order
    picture[:32, :, 1] = 255
    cv2.imwrite(str(file), picture)


def check_quarters(bench, path, textured: bool) -> None:
    """Check the colours of a square metre in the mesh file."""
    body = bench.body(Geometry("mesh", filename=str(path)), colour=None)
    pose = looking([0.5, 0.5, 1.0], [0.5, 0.5, 0], (0, 1, 0))
    image = bright_renderer(bench.world).render(View(160, 120, pose, K, 0.02))
    for row, green in ((30, 255), (90, 0)):
        for column, red in ((30, 0), (130, 255)):
            wanted = [red, green, 0] if textured else [0, 140, 255]
            assert np.abs(image[row, column].astype(int) - wanted).max() <= 2
    bench.world.delete(body.name)


SQUARE_DAE = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit name="centimetre" meter="0.01"/><up_axis>Y_UP</up_axis></asset>
<library_images><image id="half"><init_from>half.png</init_from></image></library_images>
<library_effects><effect id="e"><profile_COMMON>
<newparam sid="f"><surface type="2D"><init_from>half</init_from></surface></newparam>
<newparam sid="s"><sampler2D><source>f</source></sampler2D></newparam>
<technique sid="t"><lambert><diffuse>{diffuse}</diffuse></lambert></technique>
</profile_COMMON></effect></library_effects>
<library_materials><material id="m"><instance_effect url="#e"/></material></library_materials>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="pa" count="12">0 0 0 50 0 0 50 50 0 0 50 0</float_array>
<technique_common><accessor source="#pa" count="4" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<source id="t"><float_array id="ta" count="8">0 0 1 0 1 1 0 1</float_array>
<technique_common><accessor source="#ta" count="4" stride="2"><param name="S" type="float"/>
<param name="T" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<polylist material="look" count="1"><input semantic="VERTEX" source="#v" offset="0"/>
<input semantic="TEXCOORD" source="#t" offset="1" set="0"/>
<vcount>4</vcount><p>0 0 1 1 2 2 3 3</p></polylist></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="w"><node id="n">
<matrix>2 0 0 0 0 2 0 0 0 0 2 0 0 0 0 1</matrix><instance_geometry url="#g"><bind_material>
<technique_common><instance_material symbol="look" target="#m"/></technique_common>
</bind_material></instance_geometry></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#w"/></scene></COLLADA>"""


@pytest.mark.parametrize("diffuse", ["<color>0 0.5 1 1</color>",
                                     '<texture texture="s" texcoord="UV"/>'])
def test_collada_units_colours_and_textures(bench, tmp_path, diffuse):
    """Half a metre in centimetres, doubled by its node, is the metre that the camera sees."""
    painted(tmp_path / "half.png")
    path = tmp_path / "square.dae"
    path.write_text(SQUARE_DAE.format(diffuse=diffuse))
    (mesh,) = mesh_files.read(str(path))
    assert np.abs(np.ptp(mesh.positions, axis=0) - [1.0, 1.0, 0.0]).max() < 1e-6
    check_quarters(bench, path, "texture" in diffuse)


def test_a_mesh_damaged_after_its_spawn_leaves_the_rest_in_view(bench, tmp_path, caplog):
    path = tmp_path / "square.obj"
    path.write_text(CUBE_OBJ.format(material=""))
    bench.box([0.3, 0.3, 0.3], [0.0, 0.0, 0.3], "Gazebo/Red")
    bench.body(Geometry("mesh", filename=str(path)), colour=None)
    path.write_text("v 0 0 0")
    drawn = bright_renderer(bench.world)
    for n in range(2):
        image = drawn.render(view())
        bench.box([0.1, 0.1, 0.1], [0.0, n, -9.0])  # the world changed: all is read again
    assert (image[..., 0] > image[..., 1].astype(int) + 50).any()
    assert [f"body2::link is not drawn: mesh file {path}" in text for text in caplog.messages] \
        == [True]
