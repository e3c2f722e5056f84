"""Shapes as triangles, and the poses and colours that a renderer receives."""

import math

import numpy as np
import pytest

from aras_sim_bridge.description import (
    Geometry,
    Inertial,
    Link,
    RobotDescription,
    Visual,
    parse_urdf,
)
from aras_sim_bridge.description import shape_meshes as shapes
from aras_sim_bridge.errors import DescriptionError
from aras_sim_bridge.rendering.scene import Scene
from aras_sim_bridge.world import World
from aras_visual_servo_base.meshes.mesh import Mesh, from_corners, from_indices
from aras_visual_servo_base.poses import Pose

BOX = Geometry("box", size=(0.2, 0.4, 0.6))


def corners(mesh):
    """(T, 3, 3) corners of the triangles."""
    return mesh.positions[mesh.triangles].astype(float)


def volume(mesh):
    """m³ that the triangles enclose, counter-clockwise from outside."""
    a, b, c = corners(mesh).transpose(1, 0, 2)
    return np.einsum("ni,ni->n", np.cross(a, b), c).sum() / 6


@pytest.mark.parametrize("shape, expected, extents", [
    (BOX, 0.048, (0.2, 0.4, 0.6)), (Geometry("sphere", radius=0.5), math.pi / 6, (1, 1, 1)),
    (Geometry("cylinder", radius=0.5, length=2.0), math.pi / 2, (1, 1, 2)),
    (Geometry("capsule", radius=0.5, length=2.0), math.pi / 2 + math.pi / 6, (1, 1, 3))])
def test_solids_have_their_size_and_volume(shape, expected, extents):
    """Facets lie inside round shapes: up to 2 % of the volume are lost."""
    (mesh,) = shapes.make_meshes(shape)
    assert np.ptp(mesh.positions, axis=0) == pytest.approx(extents, rel=1e-6)
    assert np.abs(mesh.positions.max(axis=0) + mesh.positions.min(axis=0)).max() < 1e-6
    assert 0.98 * expected < volume(mesh) <= expected * (1 + 1e-6)
    assert np.linalg.norm(mesh.normals, axis=1) == pytest.approx(1.0)


@pytest.mark.parametrize("normal", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0, -0.6, 0.8)])
def test_a_plane_is_a_rectangle_that_its_normal_leaves(normal):
    (mesh,) = shapes.make_meshes(Geometry("plane", size=(2.0, 6.0, 0.0), normal=normal))
    assert len(mesh.triangles) == 2
    assert np.abs(mesh.normals - normal).max() < 1e-6
    a, b, c = corners(mesh).transpose(1, 0, 2)
    assert np.cross(b - a, c - a).sum(axis=0) / 2 == pytest.approx(12.0 * np.array(normal))
    sides = sorted(np.linalg.norm(corners(mesh)[0] - np.roll(corners(mesh)[0], 1, axis=0), axis=1))
    assert sides == pytest.approx([2.0, 6.0, math.sqrt(40)])
    if normal == (0, 0, 1):
        assert mesh.positions.max(axis=0) == pytest.approx((1, 3, 0))
    (endless,) = shapes.make_meshes(Geometry("plane", normal=normal))
    assert np.linalg.norm(endless.positions, axis=1) == pytest.approx(50 * math.sqrt(2))


@pytest.mark.parametrize("scale", [(1, 1, 1), (2, 3, -1), (-0.5, -4, 1)])
def test_a_stretched_ball_s_normals_stand_on_its_surface(scale):
    (ball,) = shapes.make_meshes(Geometry("sphere", radius=0.5))
    turn = Pose.from_rpy((1, 2, 3), (0.1, 0.2, 0.3))
    T = turn.matrix()
    stretch = np.diag([*scale, 1.0])
    for moved in (ball.transform(T, scale), ball.apply_affine(T @ stretch)):
        local = (moved.positions - T[:3, 3]) @ T[:3, :3]
        expected = local / np.square(scale)
        expected /= np.linalg.norm(expected, axis=1, keepdims=True)
        cosine = np.einsum("ni,ni->n", expected @ T[:3, :3].T, moved.normals)
        assert cosine.min() > 0.99
        assert volume(moved) == pytest.approx(volume(ball) * abs(np.prod(scale)), rel=1e-4)


def wound(mesh, point):
    """Winding number of a surface about a point: its solid angle over 4 pi (van Oosterom)."""
    a, b, c = (corners(mesh) - point).transpose(1, 0, 2)
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    volumes = np.einsum("ni,ni->n", a, np.cross(b, c))
    under = (la * lb * lc + np.einsum("ni,ni->n", a, b) * lc + np.einsum("ni,ni->n", b, c) * la
             + np.einsum("ni,ni->n", c, a) * lb)
    return np.arctan2(volumes, under).sum() / (2 * math.pi)


def test_inside_is_what_the_surface_goes_round():
    """Of two boxes that are apart, and of a wedge with an edge along the ray that is counted."""
    boxes = [shapes.make_meshes(BOX)[0].transform(Pose.from_rpy(xyz, (0.3, -0.5, 0.8)).matrix())
             for xyz in ((0.4, 0.3, 0.5), (-0.3, -0.4, -0.2))]
    two = from_corners(np.concatenate([corners(box) for box in boxes]))
    tips = np.array([(0, 0, 0), (0.5773, 0.5411, 0.6119), (1, 0, 0), (0, 1, 0)], float)
    wedge = Mesh(tips, tips, np.array([(0, 1, 2), (0, 3, 1), (0, 2, 3), (1, 3, 2)]))
    shares = np.random.default_rng(5).random((400, 3))
    for mesh in (two, wedge):
        points = mesh.positions.min(axis=0) + shares * np.ptp(mesh.positions, axis=0)
        inside = [mesh.contains(point) for point in points]
        assert inside == [abs(wound(mesh, point)) > 0.5 for point in points]
        assert 5 < sum(inside) < 200


def test_a_picture_is_whole_and_upright_on_each_side_of_a_box():
    box = shapes.make_meshes(BOX)[0].apply_affine(Pose((1.0, 2.0, 3.0)).matrix())
    draped = box.apply_texture("a.png", box_mapping=True)
    for p, n, (across, up) in zip(box.positions, box.normals, draped.uv, strict=True):
        above = np.array([0.0, 1.0, 0.0] if abs(n[2]) > 0.5 else [0.0, 0.0, 1.0])
        right = np.cross(above, n)  # of who looks at that side from outside
        for share, axis in ((across, right), (up, above)):
            place = (p - (1.0, 2.0, 3.0)) @ axis / (np.abs(axis) @ BOX.size)
            assert share == pytest.approx(0.5 + place, abs=1e-5)
    assert draped.texture == "a.png"
    own = draped.apply_texture("b.png", box_mapping=False)
    assert own.texture == "b.png" and own.uv is draped.uv
    assert box.apply_texture("b.png", box_mapping=False) is box


def test_edges_of_faces_and_faces_without_an_area():
    def roof(angle):
        """Two faces that meet at this angle, rad."""
        s, c = math.sin(angle / 2), math.cos(angle / 2)
        return from_corners([[(0, 0, 0), (c, 0, -s), (0, 1, 0)], [(0, 0, 0), (0, 1, 0),
                                                                 (-c, 0, -s)]])
    assert len(roof(math.radians(34)).positions) == 4
    assert len(roof(math.radians(36)).positions) == 6
    assert roof(math.radians(34)).normals[:, 2].max() == pytest.approx(1.0)
    flat = [(0, 0, 0), (1, 0, 0), (2, 0, 0)]
    mesh = from_corners([[(0, 0, 0), (1, 0, 0), (0, 1, 0)], flat])
    assert len(mesh.triangles) == 1
    with pytest.raises(DescriptionError, match="no triangle with an area"):
        from_corners([flat])


def test_a_file_s_own_normals_and_coordinates():
    v = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0)], float)
    vn = np.array([(0, 0, 2.0), (0, 3.0, 4.0)])
    vt = np.array([(0, 0), (1, 0), (0, 1.0)])
    index = np.array([[(0, 0, 0), (1, 1, 0), (2, 2, 1)]])
    mesh = from_indices(index, v, vt, vn, (1, 0, 0, 1), "a.png", 3)
    assert mesh.normals.tolist() == [[0, 0, 1], [0, 0, 1], pytest.approx([0, 0.6, 0.8])]
    assert mesh.uv.tolist() == vt.tolist()
    assert (mesh.rgba, mesh.texture, mesh.piece) == ((1, 0, 0, 1), "a.png", 3)
    bare = from_indices(np.where([True, False, False], index, -1), v, vt, vn, None, "a.png")
    assert bare.uv is None and bare.texture is None
    assert bare.normals.tolist() == [[0, 0, 1]] * 3
    for part, what in ((0, "position"), (1, "texture coordinate"), (2, "normal")):
        wrong = index.copy()
        wrong[0, 1, part] = 3
        with pytest.raises(DescriptionError, match=f"a face refers to {what} 3, but there are"):
            from_indices(wrong, v, vt, vn, None, None)
    with pytest.raises(DescriptionError, match="a normal is not finite"):
        from_indices(index, v, vt, vn * [1, 1, math.inf], None, None)


def body(*visuals, colours=(), com=None, name="r"):
    inertial = None if com is None else Inertial(1.0, com, (0.4, 0.5, 0.6), (1, 0, 0, 2, 0, 2.5))
    return RobotDescription(name, "link", {"link": Link("link", inertial, visuals)}, {},
                            static=com is None, colours=dict(colours))


def test_a_visual_is_drawn_where_its_origin_and_its_link_put_it():
    """Wherever the centre of mass is, and while the body turns."""
    origin = ((0.1, 0.2, 0.3), (0.3, -0.4, 0.5))
    with World(gravity=(0, 0, 0)) as world:
        at = Pose.from_rpy((1, 2, 3), (0.7, 0.8, -0.9))
        model = world.spawn(body(Visual("v", *origin, BOX), com=(0.5, 0.1, -0.2)), "m", at)
        scene = Scene(world)
        for _ in range(2):
            scene.refresh()
            (part,), (pose,) = scene.visuals, scene.read_poses()
            expected = np.array((model.link_pose("link") @ Pose.from_rpy(*origin)).matrix())
            drawn = part.mesh.positions @ pose[:3, :3].T + pose[:3, 3]
            (box,) = shapes.make_meshes(BOX)
            exact = box.positions @ expected[:3, :3].T + expected[:3, 3]
            assert np.abs(drawn - exact).max() < 1e-6
            model.apply_force("link", (0, 100, 0), (0, 0, 0))
            for _ in range(500):
                world.step()
        assert np.abs(expected[:3, :3] - at.matrix()[0][0]).max() > 0.1


def test_links_are_drawn_at_their_own_poses_in_whatever_order_the_file_has_them():
    def link(name, size):
        return (f"<link name='{name}'><visual><geometry><box size='{size} {size} {size}'/>"
                "</geometry></visual></link>")

    def joint(child, parent, x):
        return (f"<joint name='to_{child}' type='fixed'><origin xyz='{x} 0 0'/><parent link="
                f"'{parent}'/><child link='{child}'/></joint>")

    text = (link("hand", 0.1) + "<link name='bare'/>" + link("root", 0.2) + link("arm", 0.3)
            + joint("hand", "bare", 3) + joint("bare", "arm", 2) + joint("arm", "root", 1))
    with World() as world:
        model = world.spawn(parse_urdf(f"<robot name='r'>{text}</robot>"), "m", Pose((0, 5, 0)))
        scene = Scene(world)
        scene.refresh()
        poses, labels = scene.read_poses(), scene.compute_labels()
        assert len(poses) == 3
        for part in scene.visuals:
            name = {1: "hand", 2: "root", 3: "arm"}[round(10 * np.ptp(part.mesh.positions[:, 0]))]
            assert poses[part.row][:3, 3] == pytest.approx(model.link_pose(name).xyz)
            index = model.link_index(name)
            assert labels[part.row] == model.body_id + ((index + 1) << 24)
            middle = np.add(model.link_pose(name).xyz, 0.01)
            assert scene.find_bodies_around(middle) == [f"m::{name}"]


def test_colours_go_link_mesh_white_and_the_invisible_is_left_out(tmp_path):
    path = tmp_path / "a.obj"
    (tmp_path / "a.mtl").write_text("newmtl m\nKd 0 1 0\n")
    path.write_text("mtllib a.mtl\nusemtl m\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
                    "usemtl none\nf 1 3 2\n")
    visual = Visual("v", (0, 0, 0), (0, 0, 0), Geometry("mesh", filename=str(path)))

    def drawn(**colours):
        with World() as world:
            world.spawn(body(visual, colours=colours), "m")
            scene = Scene(world)
            scene.refresh()
            return [part.rgba for part in scene.visuals]

    assert drawn() == [(0, 1, 0, 1), (0.7, 0.7, 0.7, 1)]  # no library has the second material
    assert drawn(link=(1, 0, 0, 0.5)) == [(1, 0, 0, 0.5)] * 2
    assert drawn(link=(1, 0, 0, 0)) == []
