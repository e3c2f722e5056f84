"""Points on the visible edges of solids, compared with independent code."""

import numpy as np
import pytest
from tracking_scenes import CAMERA, RADIUS, corners_of, prism

from aras_visual_servo_base.poses import inverse, matrix_from_xyz_rpy
from aras_visual_servo_camera.model_tracker import Solid
from aras_visual_servo_camera.model_tracker.visible_edges import MAX_POINTS, sample_visible_edges

K = np.reshape(CAMERA.K, (3, 3))
SIZE = np.array([CAMERA.width, CAMERA.height])


def drum() -> np.ndarray:
    """A prism whose 24 sides are shorter in the image than the omitted ends of an edge."""
    around = 2.0 * np.pi * np.arange(24) / 24
    return prism(RADIUS * np.column_stack([np.cos(around), np.sin(around)]), 0.0, 0.05)


def room(uv, edges, own, at, k) -> tuple[float, float]:
    """px from a point to other edges along the row (k = 0) or column, before it and behind."""
    rest = edges[(edges != own).any(axis=1)]
    a, b = uv[rest, 1 - k].T - at[1 - k]
    with np.errstate(all="ignore"):
        away = uv[rest[:, 0], k] + a / (a - b) * (uv[rest[:, 1], k] - uv[rest[:, 0], k]) - at[k]
    beside = np.isin(rest, own).any(axis=1) & (np.abs(away) < 0.5)
    away = away[(a * b <= 0.0) & (a != b) & ~beside]
    return min(-away[away < 0.0], default=1e6), min(away[away >= 0.0], default=1e6)


def expected(solid, T, spacing) -> list[tuple]:
    """Compute the result of EdgePoints point by point."""
    P = solid.vertices @ T[:3, :3].T + T[:3, 3]
    uv = P @ K.T
    uv = uv[:, :2] / uv[:, 2:]
    eye = inverse(T)[:3, 3] - solid.vertices[solid.faces[:, 0]]
    cosine = (eye * solid.normals).sum(axis=1) / np.linalg.norm(eye, axis=1)
    front, strip = cosine > 0.0, (cosine > -0.01) & (cosine < 0.03)
    one, other = solid.edge_faces.T
    shown = np.where(solid.is_crease, (front[one] | front[other]) & ~strip[one] & ~strip[other],
                     front[one] != front[other])
    shown = np.flatnonzero(shown & (P[solid.edges, 2] > 0.01).all(axis=1))
    edges = solid.edges[shown]
    hiding = front & (P[solid.faces, 2] > 0.01).all(axis=1)
    shares_of = np.linalg.inv(P[solid.faces].swapaxes(1, 2))
    points, due = [], 0.5 * spacing
    for e in shown:
        i, j = solid.edges[e]
        way = uv[j] - uv[i]
        length = np.linalg.norm(way)
        end = length
        if length > 16.0:  # nothing within 4 px of its ends, and all in the middle of the rest
            due, end = 4.0 + 0.5 * ((length - 8.0) % spacing), length - 4.0
        count = max(int(np.ceil((end - due) / spacing - 1e-9)), 0)
        normal = np.array([way[1], -way[0]]) / length
        for s in (due + spacing * np.arange(count)) / length:
            pixel = uv[i] + s * way
            if (pixel <= 5.0).any() or (pixel >= SIZE - 5.0).any():
                continue
            depth = 1.0 / ((1.0 - s) / P[i, 2] + s / P[j, 2])
            at = depth * (np.linalg.inv(K) @ [*pixel, 1.0])
            shares = shares_of @ at
            before = hiding & (shares >= 0.0).all(axis=1) & (shares.sum(axis=1) > 1.0 + 2e-3)
            before[solid.edge_faces[e]] = False
            if not before.any():
                points.append((
                    (at - T[:3, 3]) @ T[:3, :3], at[:2] / at[2], pixel, normal,
                    normal * np.diag(K)[:2],
                    room(uv, edges, solid.edges[e], pixel, int(abs(way[0]) > abs(way[1]))), e,
                    front[solid.edge_faces[e]]))
        due = 0.5 * spacing if length > 16.0 else due + spacing * count - length
    return points


@pytest.mark.parametrize(("corners", "place", "turn", "spacing"), [
    (corners_of("bracket"), (0.02, -0.01, 0.3), (np.pi - 0.6, 0.4, 0.5), 3.0),
    (corners_of("bracket"), (-0.03, 0.03, 0.15), (1.9, -0.5, 2.5), 5.5),
    (corners_of("bracket"), (0.01, 0.005, 0.03), (0.4, 1.3, 0.2), 4.0),  # beside the camera
    (corners_of("bracket") * (1.0, 1.0, 0.04), (0.02, -0.01, 1.0), (2.6, 0.3, 0.4), 2.0),  # flat
    (corners_of("box"), (-0.1, 0.08, 0.35), (np.pi - 0.4, 0.2, 1.5), 2.5),
    (drum(), (0.03, 0.02, 0.35), (np.pi - 0.9, 0.1, 0.0), 4.0),
    (drum(), (0.0, 0.0, 1.1), (np.pi - 0.7, 0.2, 0.0), 2.0),
])
def test_edge_points_are_those_that_are_seen_each_by_itself(corners, place, turn, spacing):
    solid, T = Solid.from_triangles(corners), matrix_from_xyz_rpy(place, turn)
    found, wanted = sample_visible_edges(solid, CAMERA, T, spacing), expected(solid, T, spacing)
    assert len(found.solid_points) == len(wanted) > 20
    for field, values in zip(found, map(np.array, zip(*wanted, strict=True)), strict=True):
        np.testing.assert_allclose(field, values, atol=1e-6)


@pytest.mark.parametrize("name", ["box", "bracket", "cylinder"])
def test_outermost_are_faces_before_which_nothing_of_the_solid_lies(name):
    solid = Solid.from_triangles(corners_of(name) + (0.3, -0.2, 0.1))
    before = solid.normals @ solid.vertices.T - (
        solid.normals * solid.vertices[solid.faces[:, 0]]).sum(axis=1)[:, None]
    assert (solid.is_outermost == (before.max(axis=1) < 1e-7)).all() and solid.is_outermost.any()
    assert solid.is_outermost.all() == (name != "bracket")


def test_there_are_no_more_points_than_there_is_room_for():
    solid = Solid.from_triangles(corners_of("bracket"))
    T = matrix_from_xyz_rpy((0.02, -0.01, 0.3), (2.5, 0.4, 0.5))
    found, some = (sample_visible_edges(solid, CAMERA, T, spacing) for spacing in (0.3, 3.0))
    assert len(found.solid_points) == MAX_POINTS > len(some.solid_points)
