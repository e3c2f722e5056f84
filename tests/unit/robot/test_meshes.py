"""Meshes: size of the original links, closed, outward normals, small, reproducible."""

import sys
from collections import Counter

import make_meshes
import numpy as np
import pytest
from robot_figures import BOUNDS, PACKAGE

LINKS = list(make_meshes.LINKS)


def signed_volume(part: np.ndarray) -> float:
    """Volume enclosed by a part in m^3; negative when its faces point inwards."""
    return float(np.einsum("ij,ij->i", part[:, 0], np.cross(part[:, 1], part[:, 2])).sum() / 6)


def read_stl(link: str) -> tuple[np.ndarray, np.ndarray]:
    """Normals (n, 3) and corners (n, 3, 3) of a mesh file."""
    data = (PACKAGE / "meshes" / f"{link}.stl").read_bytes()
    (count,) = np.frombuffer(data, "<u4", 1, 80)
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("colour", "<u2")])
    records = np.frombuffer(data, record, count, 84)
    assert len(data) == 84 + 50 * count
    return records["normal"].astype(float), records["corners"].astype(float)


def test_the_script_writes_all_of_them_and_says_how_many_triangles(tmp_path, monkeypatch, capsys):
    folder = tmp_path / "new" / "meshes"
    monkeypatch.setattr(sys, "argv", ["make_meshes.py", "--out", str(folder)])
    for _ in range(2):  # once more into the same folder
        assert make_meshes.main() == 0
    shipped = {path.name: path.read_bytes() for path in (PACKAGE / "meshes").glob("*.stl")}
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == shipped
    counts = [len(read_stl(link)[0]) for link in LINKS]
    lines = [f"{link}.stl: {n} triangles" for link, n in zip(LINKS, counts, strict=True)]
    assert capsys.readouterr().out.splitlines() == 2 * [*lines, f"total: {sum(counts)} triangles"]


@pytest.mark.parametrize("link", LINKS)
def test_parts_are_closed_and_face_outwards(link):
    for number, part in enumerate(make_meshes.link_parts(link)):
        edges = Counter()
        for triangle in part:
            a, b, c = map(tuple, triangle)
            edges.update([(a, b), (b, c), (c, a)])
        lone = [e for e, uses in edges.items() if uses != 1 or edges[e[::-1]] != 1]
        assert not lone, f"part {number} of {link} is open at {lone[0]}"
        assert signed_volume(part) > 0, f"part {number} of {link} is inside out"


@pytest.mark.parametrize("link", LINKS)
def test_files_have_the_original_bounds_and_normals_that_agree_with_the_winding(link):
    normals, corners = read_stl(link)
    points = corners.reshape(-1, 3)
    bounds = np.stack([points.min(axis=0), points.max(axis=0)], axis=1)
    np.testing.assert_allclose(bounds, BOUNDS[link], atol=1e-3)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(cross, axis=1)
    assert area.min() > 0
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-5)
    assert np.einsum("ij,ij->i", normals, cross / area[:, None]).min() > 0.99


def test_table_top_is_the_plane_of_the_target_and_nothing_is_between_it_and_the_camera():
    """At the zero pose the camera at z = 0.782 sees the table within 0.35 m of the origin."""
    corners = read_stl("base_link")[1]
    flat = corners[np.ptp(corners[:, :, 2], axis=1) == 0]
    table = flat[np.abs(flat[:, 0, 2] - 0.59) < 1e-6].reshape(-1, 3)
    assert (table[:, :2].min(axis=0) < (-1, -0.5)).all()
    assert (table[:, :2].max(axis=0) > (1, 0.5)).all()
    low, high = corners.min(axis=1), corners.max(axis=1)
    near = (low[:, :2] < 0.35).all(axis=1) & (high[:, :2] > -0.35).all(axis=1)
    assert not (near & (high[:, 2] > 0.5901) & (low[:, 2] < 0.78)).any()
