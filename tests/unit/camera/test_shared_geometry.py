"""Prepared scenes are reused if and only if they are equal."""

import os
from dataclasses import replace

import cv2
import numpy as np
import pytest

from aras_sim_bridge.camera import CameraConfig, CameraSensor
from aras_sim_bridge.rendering import create_renderer
from aras_sim_bridge.rendering.clustering import CLUSTER_SIZE, cluster_triangles
from aras_sim_bridge.rendering.scene import VisualMesh
from aras_sim_bridge.rendering.triangles import Triangles
from aras_sim_bridge.world import World
from aras_visual_servo_base.meshes.mesh import from_corners
from aras_visual_servo_base.poses import rotation_from_rpy

CORNERS = np.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 0, 1], [1, 0, 1], [0, 1, 1]]])


def part(**changes):
    mesh = from_corners(CORNERS)
    return VisualMesh(0, replace(mesh, **changes), (1.0, 0.0, 0.0, 1.0))


def test_the_same_parts_are_prepared_once():
    assert Triangles.from_visuals([part()]) is Triangles.from_visuals([part()])


@pytest.mark.parametrize("other", [
    lambda: [replace(part(), row=1)],
    lambda: [replace(part(), rgba=(1.0, 0.0, 0.0, 0.5))],
    lambda: [part(positions=from_corners(CORNERS * 1.1).positions)],
    lambda: [part(normals=-from_corners(CORNERS).normals)],
    lambda: [part(triangles=from_corners(CORNERS).triangles[:1])],
    lambda: [part(uv=np.zeros((6, 2), np.float32))],
    lambda: [part(), part()],
    list,
])  # fmt: skip
def test_what_differs_is_prepared_anew(other):
    assert Triangles.from_visuals(other()) is not Triangles.from_visuals([part()])


@pytest.mark.parametrize("away", [(0.0, 0.0, 0.0), (3e3, -2e3, 0.0)])
def test_each_links_box_is_as_large_as_it_is_and_a_dent_is_none_less_far_from_its_origin(away):
    """A tetrahedron, with and without a dent of a tenth of a millimetre; the origin is one of
    a CAD program's."""
    whole = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 4]]) * 1e-1
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    dented = np.vstack([whole, whole[1:].mean(axis=0) * (1 - 1e-3)])
    parts = [
        VisualMesh(row, replace(from_corners(corners[faces]), positions=corners, triangles=faces,
                          normals=np.zeros_like(corners)), (1.0, 0.0, 0.0, 1.0))
        for row, corners, faces in (
            (2, whole + away, faces),
            (0, dented + away, np.vstack([faces[:3], [[1, 2, 4], [2, 3, 4], [3, 1, 4]]])),
        )
    ]  # fmt: skip
    made = Triangles.from_visuals(parts)
    convex = {int(row): set(made.hull[made.row == row] >= 0) for row in (0, 2)}
    assert convex == {2: {True}, 0: {False}}
    for row in (0, 2):
        np.testing.assert_allclose(made.row_centre[row], away + np.array([0.05, 0.1, 0.2]))
        np.testing.assert_allclose(made.row_half[row], [0.05, 0.1, 0.2], rtol=1e-6)
    assert (made.row_half[1] == -1.0).all()  # has none
    distance = np.einsum("tkj,tj->tk", made.corners, made.plane[:, :3])
    np.testing.assert_allclose(distance, np.repeat(made.plane[:, 3:], 3, axis=1), atol=1e-9)


def test_a_texture_that_was_painted_over_is_read_again(tmp_path):
    file = tmp_path / "texture.png"
    cv2.imwrite(str(file), np.zeros((4, 4, 3), np.uint8))
    textured = [part(texture=str(file), uv=np.zeros((6, 2), np.float32))]
    plain = part()
    assert Triangles.from_visuals(textured).textures.texels[1:].max() == 0
    made = Triangles.from_visuals([*textured, plain, *textured])
    assert {(int(n), int(s), int(at)) for n, s, at in zip(
        made.part, made.smooth, made.layer, strict=True)} == {(0, -1, 0), (1, 1, -1), (2, -1, 0)}
    cv2.imwrite(str(file), np.full((4, 4, 3), 200, np.uint8))
    os.utime(file, ns=(1, 1))
    assert (Triangles.from_visuals(textured).textures.texels[1:] & 255).min() == 200


def test_cameras_that_see_alike_have_the_same_tiles_and_others_their_own():
    """But those of a large image are not kept."""
    def tiles_of(fov, width=40, height=32, **lens):
        config = CameraConfig.from_mapping(
            {"width": width, "height": height, "horizontal_fov": fov, **lens})
        with World() as world:
            sensor = CameraSensor(config, create_renderer("exact", world))
            return sensor.make_view(np.eye(4)).get_tiles()

    bent = {"distortion_coefficients": (-0.2, 0.0, 0.0, 0.0, 0.0)}
    lenses = [{}, bent, {"distortion_coefficients": (-0.21, 0.0, 0.0, 0.0, 0.0)},
              {"lens": "equidistant"}, {"width": 48}]
    found = [tiles_of(fov, **lens) for fov in (1.0, 1.1) for lens in lenses]
    assert len(set(map(id, found))) == 10 and tiles_of(1.1, **bent) is found[6]
    assert tiles_of(1.0, 640, 480) is tiles_of(1.0, 640, 480)
    assert tiles_of(1.0, 640, 481) is not tiles_of(1.0, 640, 481)


def test_every_triangle_is_in_one_group_of_few_that_face_one_side():
    """Of each part and side by itself, cut where that makes the boxes smaller."""
    draw = np.random.default_rng(3)
    large = draw.choice([0.1, 0.7, 4.0], (900, 1, 1))
    corners = draw.normal(size=(900, 1, 3)) + large * draw.normal(size=(900, 3, 3))
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    part = np.repeat([0, 4, 7], 300)
    side = 2 * np.abs(normal).argmax(axis=1)
    side += normal[np.arange(900), side // 2] > 0
    made, one = cluster_triangles(corners, normal, part), 6 * part + side
    assert sorted(np.concatenate(made)) == list(range(900)) and 40 < len(made) < 400
    assert all(len(set(one[group])) == 1 and len(group) <= CLUSTER_SIZE for group in made)
    # neighbours are together: a strip of squares is cut across, not into its odd and even ones
    strip = np.array([[[x, 0, 0], [x + 1, 0, 0], [x, 1, 0]] for x in range(64)], float)
    halves = cluster_triangles(strip, np.tile([0.0, 0, 1], (64, 1)), np.zeros(64, int))
    assert all(np.ptp(np.sort(group)) == len(group) - 1 for group in halves)
    assert cluster_triangles(strip[:0], strip[:0, 0], np.zeros(0, int)) == []
    for count, many in ((CLUSTER_SIZE, 1), (CLUSTER_SIZE + 1, 2)):  # all in one place
        one, up = strip[np.zeros(count, int)], np.tile([0.0, 0, 1], (count, 1))
        assert len(cluster_triangles(one, up, np.zeros(count, int))) == many


@pytest.mark.parametrize("size", [1e-3, 30.0])
def test_two_triangles_are_a_quad_where_they_lie_in_one_plane(size):
    """Where they fold, one does not stand for both, though their normals are said to be alike."""
    turn = rotation_from_rpy(0.1, -0.2, 0.5)
    for fold, told in ((0.0, True), (0.002, False)):
        outline = np.array([[0.0, 0, 0], [1, 0, 0], [0.8, 0.9, fold], [0, 1, 0]]) + [3.0, -2.0, 1.0]
        faces = size * np.float32(outline @ turn.T)[[[0, 1, 3], [1, 2, 3]]]
        made = Triangles.from_visuals([VisualMesh(0, replace(from_corners(faces), normals=np.tile(
            np.float32(turn[:, 2]), (6, 1))), (1.0, 0.0, 0.0, 1.0))])
        assert made.clusters.quad.tolist() == [told]


def test_what_is_known_of_a_cluster_holds_all_its_triangles():
    draw = np.random.default_rng(4)
    corners = draw.normal(size=(200, 3, 3))  # through each other: few clusters of many
    made = Triangles.from_visuals([VisualMesh(0, from_corners(corners), (1.0, 0.0, 0.0, 1.0))])
    seen = made.clusters
    assert seen.count.sum() == len(made.corners) == 200 and seen.count.min() > 1
    for n, (first, count) in enumerate(zip(seen.first, seen.count, strict=True)):
        points = made.corners[first:first + count].reshape(-1, 3)
        plane = made.plane[first:first + count]
        assert (np.abs(points - seen.centre[n]) <= seen.half[n] + 1e-12).all()
        assert np.linalg.norm(points - seen.centre[n], axis=1).max() == pytest.approx(
            seen.radius[n])
        assert (plane[:, :3] @ seen.axis[n]).min() == pytest.approx(seen.cosine[n])
        assert (plane[:, 3] - plane[:, :3] @ seen.centre[n]).min() == pytest.approx(seen.height[n])


def test_flat_triangles_of_a_part_that_face_one_side_are_one_facet():
    signs = np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, -1).T
    solid = np.array([np.diag(one)[::int(one.prod())] for one in signs])  # of eight sides
    faces = np.concatenate([solid, 2.0 * solid + 1.0])
    made = Triangles.from_visuals([VisualMesh(0, from_corners(faces), (1.0, 0.0, 0.0, 1.0))] * 2)
    facing = [(n, *way) for n, way in zip(
        made.part, np.rint(1e3 * made.normals[:, 0]).astype(int).tolist(), strict=True)]
    number = dict(zip(facing, made.facets, strict=True))
    assert [number[one] for one in facing] == made.facets.tolist()
    assert len(set(number.values())) == len(number) == 16
