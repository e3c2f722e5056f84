"""Both renderers draw what Bullet holds, and say what they cannot do."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pybullet
import pytest
from scenes import Bench, looking, table_and_target

from aras_sim_bridge.errors import RenderingError
from aras_sim_bridge.rendering import COLOURS, MaterialTable, View, create_renderer, opengl
from aras_sim_bridge.rendering import meshes as mesh_files
from aras_sim_bridge.rendering.faces import whole
from aras_sim_bridge.rendering.gazebo_materials import colour

K = np.array([[150.0, 0, 80.3], [0, 155.0, 55.8], [0, 0, 1]])
RENDERERS = ("opengl", "tiny")


def view(eye=(2.0, -1.5, 1.2), at=(0.0, 0.0, 0.3), **changes):
    return View(160, 120, looking(eye, at), changes.pop("K", K), **changes)


def furnish(bench):
    """One of every shape, some turned, one with its centre of mass off its origin."""
    client = bench.client
    bench.box([0.2, 0.1, 0.3], [0, 0.6, 0.3], "Gazebo/Red", orientation=(0.1, 0, 0, 0.995))
    shapes = [
        dict(shapeType=pybullet.GEOM_SPHERE, radius=0.2),
        dict(shapeType=pybullet.GEOM_CYLINDER, radius=0.15, height=0.5),
        dict(shapeType=pybullet.GEOM_CAPSULE, radius=0.1, height=0.4),
    ]
    for n, shape in enumerate(shapes):
        body = pybullet.createMultiBody(
            1.0, pybullet.createCollisionShape(**shape, physicsClientId=client),
            basePosition=[0.5 * n - 0.5, -0.3, 0.5], baseOrientation=[0.5, 0.5, 0.5, 0.5],
            baseInertialFramePosition=[0.1, 0.05, -0.1], physicsClientId=client,
        )
        bench.materials.set_body(body, {-1: COLOURS["Gazebo/Blue"]})
    pybullet.createMultiBody(
        0, pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=client),
        physicsClientId=client,
    )


def test_both_draw_the_same_picture(bench):
    furnish(bench)
    pictures = {}
    for name in RENDERERS:
        renderer = create_renderer(name, bench.client, bench.materials, antialiasing="none")
        pictures[name] = renderer.render(view()).astype(int)
    difference = np.abs(pictures["opengl"] - pictures["tiny"]).max(axis=2)
    assert (difference > 12).mean() < 0.003, "more than the odd edge pixel differs"
    means = [picture.mean(axis=(0, 1)) for picture in pictures.values()]
    assert np.abs(means[0] - means[1]).max() < 0.5


def test_both_measure_the_same(bench):
    furnish(bench)
    measured = [create_renderer(n, bench.client, bench.materials).measure(view())
                for n in RENDERERS]
    (depth_a, label_a), (depth_b, label_b) = measured
    same = label_a == label_b
    assert same.mean() > 0.99
    assert set(np.unique(label_a)) == {-1, 0, 1, 2, 3, 4}
    solid = same & (label_a >= 0)
    assert np.median(np.abs(depth_a[solid] - depth_b[solid])) < 1e-3
    assert np.isinf(depth_a[label_a < 0]).all()


@pytest.mark.parametrize("name", RENDERERS)
def test_models_come_and_go(bench, name):
    renderer = create_renderer(name, bench.client, bench.materials)
    empty = renderer.render(view())
    assert (empty == 178).all() or (empty == 179).all(), "an empty world is Gazebo's grey"
    body = bench.box([0.3, 0.3, 0.3], [0, 0, 0.3], "Gazebo/Green")
    with_box = renderer.render(view())
    green = (with_box[..., 1] > 60) & (with_box[..., 0] == 0)
    assert green.mean() > 0.05
    pybullet.resetBasePositionAndOrientation(
        body, [0, 0, 5], [0, 0, 0, 1], physicsClientId=bench.client
    )
    assert (renderer.render(view()) == empty).all()
    pybullet.removeBody(body, physicsClientId=bench.client)
    bench.materials.forget(body)
    assert (renderer.render(view()) == empty).all()


@pytest.mark.parametrize("name", RENDERERS)
def test_table_is_white_and_target_black_from_anywhere(bench, name):
    table_and_target(bench)
    renderer = create_renderer(name, bench.client, bench.materials)
    for eye in ([0.0, 0.0, 0.78], [0.08, -0.1, 0.75], [-0.2, 0.15, 1.0]):
        image = renderer.render(View(160, 120, looking(eye, [0.0, 0.0, 0.59], (1, 0, 0)), K, 0.02))
        centre = image[52:60, 76:84]
        assert centre.max() <= 10
        assert image[:8].min() >= 251


def test_links_of_a_body_without_material_are_white_and_unknown_ones_warn(caplog):
    table = MaterialTable()
    table.set_materials(3, {0: "Gazebo/Black", 1: "Gazebo/Blak"})
    assert table.lookup(3, 0) == (0.0, 0.0, 0.0, 1.0)
    assert table.lookup(3, 1) == table.lookup(3, 7) == (1.0, 1.0, 1.0, 1.0)
    assert table.lookup(4, 0) is None
    assert "the nearest is 'Gazebo/Black'" in caplog.text
    assert colour("Red") == COLOURS["Gazebo/Red"]


@pytest.mark.parametrize("name", RENDERERS)
def test_nothing_nearer_than_near(bench, name):
    bench.box([0.5, 0.5, 0.01], [0, 0, 0.0], "Gazebo/Red")
    renderer = create_renderer(name, bench.client, bench.materials)
    pose = looking([0, 0, 1.0], [0, 0, 0], (0, 1, 0))
    assert renderer.render(View(32, 24, pose, K, 0.9))[12, 16, 0] > 200
    assert renderer.render(View(32, 24, pose, K, 1.1))[12, 16].tolist() in ([178] * 3, [179] * 3)


@pytest.mark.parametrize("name", RENDERERS)
def test_a_camera_inside_a_body_looks_out_of_it(bench, name):
    body = bench.box([0.2, 0.2, 0.2], [0, 0, 1.0], "Gazebo/Black")
    bench.box([2, 2, 0.01], [0, 0, 0], "Gazebo/White")
    renderer = create_renderer(name, bench.client, bench.materials)
    pose = looking([0, 0, 1.0], [0, 0, 0], (0, 1, 0))
    assert renderer.render(View(32, 24, pose, K, 0.02)).min() > 200
    base, model = pybullet.getBodyInfo(body, physicsClientId=bench.client)
    assert renderer.bodies_around([0, 0, 1.0]) == [f"{model.decode()}::{base.decode()}"]
    assert renderer.bodies_around([0, 0, 1.5]) == []


def test_distance_and_pose_blend_between_snapshot_and_now(bench):
    body = bench.box([0.05, 0.05, 0.001], [0, 0, 0], "Gazebo/Black")
    renderer = create_renderer("opengl", bench.client, bench.materials)
    renderer.snapshot()
    pybullet.resetBasePositionAndOrientation(
        body, [0.1, 0, 0], [0, 0, 0, 1], physicsClientId=bench.client
    )
    pose = looking([0, 0, 1.0], [0, 0, 0], (0, 1, 0))
    columns = []
    for blend in (0.0, 0.5, 1.0):
        dark = 255.0 - renderer.render(View(160, 120, pose, K, 0.02), blend)[..., 0]
        dark -= dark.min()
        columns.append((dark * np.arange(160)).sum() / dark.sum())
    assert columns[1] - columns[0] == pytest.approx(columns[2] - columns[1], abs=0.1)
    assert columns[2] - columns[0] == pytest.approx(0.1 * 150 / 0.999, abs=0.2)


def test_tiny_pictures_have_any_size(bench):
    furnish(bench)
    renderer = create_renderer("opengl", bench.client, bench.materials)
    for size in ((1, 1), (5, 3), (37, 41), (161, 121)):
        image = renderer.render(View(*size, looking([2, 1, 1], [0, 0, 0]), K))
        assert image.shape == (*size[::-1], 3)


def test_unknown_renderer_lists_what_there_is(bench):
    with pytest.raises(RenderingError, match="'vulkan'; there are opengl, tiny and auto"):
        create_renderer("vulkan", bench.client, bench.materials)
    with pytest.raises(RenderingError, match="anti-aliasing 'most'"):
        create_renderer("opengl", bench.client, bench.materials, antialiasing="most")


def test_without_egl_auto_takes_tiny_with_one_reason(bench, monkeypatch, caplog):
    def no_egl():
        raise RenderingError("EGL gives no OpenGL 3.3 context (libEGL.so: not found)")

    monkeypatch.setattr(opengl, "create_context", no_egl)
    renderer = create_renderer("auto", bench.client, bench.materials)
    assert renderer.name == "tiny"
    assert "EGL gives no OpenGL" in renderer.reason
    assert len(caplog.records) == 1
    with pytest.raises(RenderingError, match="EGL"):
        create_renderer("opengl", bench.client, bench.materials)


def test_what_a_table_hides_is_left_out_and_nothing_else(bench):
    bench.box([1.5, 1.5, 0.05], [0, 0, 0.5])
    bench.box([0.1, 0.1, 0.1], [0, 0, 0.2], "Gazebo/Red")
    bench.box([0.05, 0.05, 0.3], [0.1, 0.1, 0.5], "Gazebo/Blue")  # through the table
    renderer = create_renderer("opengl", bench.client, bench.materials)
    rng = np.random.default_rng(0)
    hidden = 0
    for _ in range(30):
        eye = [*rng.uniform(-0.9, 0.9, 2), rng.uniform(0.6, 1.5)]
        at = [*(eye[:2] + rng.uniform(-0.4, 0.4, 2)), 0.55]
        turn = rng.uniform(0, 6)
        picture = View(160, 120, looking(eye, at, (np.cos(turn), np.sin(turn), 0)), K, 0.02)
        with_it = renderer.render(picture)
        visibility = renderer._geometry.visibility
        filling, visibility._occluders.filling = visibility._occluders.filling, lambda *_: None
        without = renderer.render(picture)
        visibility._occluders.filling = filling
        # What reaches through the table is cut at its plane, not where depths are rounded to.
        difference = np.abs(without.astype(int) - with_it).max(axis=2)
        assert np.count_nonzero(difference) <= 1 and difference.max() <= 16
        hidden += filling(whole(picture), renderer._prepare(picture, 1.0)[0]) is not None
    assert 5 < hidden < 30


def test_several_renderers_and_threads_do_not_mix(bench):
    other = Bench()
    furnish(bench)
    other.box([0.3, 0.3, 0.3], [0, 0, 0.3], "Gazebo/Green")
    renderers = [create_renderer("opengl", b.client, b.materials) for b in (bench, other)]
    alone = [renderer.render(view()) for renderer in renderers]
    assert (alone[0] != alone[1]).any()
    for _ in range(3):
        for renderer, picture in zip(renderers, alone, strict=True):
            assert (renderer.render(view()) == picture).all()
    with ThreadPoolExecutor(1) as pool:
        for renderer, picture in zip(renderers, alone, strict=True):
            assert (pool.submit(renderer.render, view()).result() == picture).all()
            assert (renderer.render(view()) == picture).all()
    renderers[1].close()
    assert (renderers[0].render(view()) == alone[0]).all()
    other.close()


def test_a_closed_renderer_says_so(bench):
    for name in RENDERERS:
        renderer = create_renderer(name, bench.client, bench.materials)
        renderer.close()
        renderer.close()
        with pytest.raises(RenderingError, match="closed"):
            renderer.render(view())


CUBE_OBJ = """mtllib cube.mtl
v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0
vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1
usemtl {material}
f 1/1 2/2 3/3 4/4
"""


def spawn_mesh(bench, path):
    shape = pybullet.createVisualShape(
        pybullet.GEOM_MESH, fileName=str(path), physicsClientId=bench.client
    )
    return pybullet.createMultiBody(0, -1, shape, physicsClientId=bench.client)


def test_obj_materials_and_textures(bench, tmp_path):
    import cv2

    (tmp_path / "cube.mtl").write_text(
        "newmtl plain\nKd 0 0.5 1\nnewmtl picture\nKd 1 1 1\nmap_Kd half.png\n"
    )
    picture = np.zeros((64, 64, 3), np.uint8)
    picture[:, 32:] = (0, 0, 255)  # right half red, in OpenCV's order
    cv2.imwrite(str(tmp_path / "half.png"), picture)
    for material, left, right in (("plain", [0, 140, 255], [0, 140, 255]),
                                  ("picture", [0, 0, 0], [255, 0, 0])):
        path = tmp_path / f"{material}.obj"
        path.write_text(CUBE_OBJ.format(material=material))
        body = spawn_mesh(bench, path)
        renderer = create_renderer("opengl", bench.client, bench.materials)
        pose = looking([0.5, 0.5, 1.0], [0.5, 0.5, 0], (0, 1, 0))
        image = renderer.render(View(160, 120, pose, K, 0.02))
        assert np.abs(image[60, 30].astype(int) - left).max() <= 2
        assert np.abs(image[60, 130].astype(int) - right).max() <= 2
        pybullet.removeBody(body, physicsClientId=bench.client)


@pytest.mark.parametrize("name, content", [
    ("cut.stl", b"\0" * 80 + (1000).to_bytes(4, "little") + b"\0" * 100),
    ("empty.obj", b"v 0 0 0\n"),
    ("strange.ply", b"ply"),
    ("wrong.obj", b"v 0 0 0\nf 1 2 3\n"),
    ("nan.stl", b"solid x\nvertex nan 0 0\nvertex 1 0 0\nvertex 0 1 0\n"),
])
def test_unreadable_meshes_are_named(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(RenderingError) as caught:
        mesh_files.load(path)
    assert str(path) in str(caught.value)
    with pytest.raises(RenderingError, match="none.stl"):
        mesh_files.load(tmp_path / "none.stl")


def test_shapes_are_closed_and_face_outwards():
    for mesh in (mesh_files.box(np.array([1.0, 2.0, 3.0])), mesh_files.sphere(0.5),
                 mesh_files.cylinder(0.3, 1.0), mesh_files.capsule(0.2, 0.6)):
        a, b, c = mesh.positions[mesh.triangles].astype(float).transpose(1, 0, 2)
        assert (np.einsum("ni,ni->n", np.cross(a, b), c) / 6).sum() > 0
        assert mesh_files.contains(mesh, np.zeros(3))
        assert not mesh_files.contains(mesh, np.array([0.0, 0.0, 1.6]))
        outward = np.einsum("ni,ni->n", mesh.normals, mesh.positions)
        assert (outward > -1e-6).all()
