"""glTF files: contents are drawn, and an error is a one-line message."""

import json

import cv2
import numpy as np
import pytest
import trimesh
from PIL import Image
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from aras_visual_servo_base.errors import DescriptionError
from aras_visual_servo_base.meshes.files import read
from aras_visual_servo_base.poses import matrix_from_xyz_rpy

PLACED = matrix_from_xyz_rpy((0.1, -0.2, 0.3), (0.4, 0.1, -0.6))
PIXELS = np.random.default_rng(3).integers(0, 255, (6, 9, 3), np.uint8)


def box(**material):
    shape = trimesh.creation.box((0.2, 0.3, 0.5))
    uv = shape.vertices[:, :2] + (0.4, 0.3)
    shape.visual = TextureVisuals(uv=uv, material=PBRMaterial(name="face", **material))
    return shape


def scene(*shapes):
    made = trimesh.Scene()
    for number, shape in enumerate(shapes):
        made.add_geometry(shape, node_name=f"n{number}", transform=PLACED)
    return made


def glb(folder, *shapes):
    path = folder / "part.glb"
    path.write_bytes(scene(*shapes).export(file_type="glb"))
    return path


def changed(path, change):
    """The file with its JSON changed."""
    data = path.read_bytes()
    length = int.from_bytes(data[12:16], "little")
    tree = json.loads(data[20 : 20 + length])
    change(tree)
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    body = len(text).to_bytes(4, "little") + data[16:20] + text + data[20 + length :]
    path.write_bytes(data[:8] + (12 + len(body)).to_bytes(4, "little") + body)
    return path


def test_triangles_and_colours_of_a_scene(tmp_path):
    """A factor of a half of the light is level 188 of 255; a picture's levels stay."""
    (mesh,) = read(str(glb(tmp_path, box(baseColorFactor=[255, 64, 0, 255]))))
    own = mesh.positions @ PLACED[:3, :3] - PLACED[:3, 3] @ PLACED[:3, :3]
    np.testing.assert_allclose(np.abs(own).max(axis=0), (0.1, 0.15, 0.25), atol=1e-6)
    assert len(mesh.triangles) == 12
    corners = mesh.positions[mesh.triangles].astype(float)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outwards = corners.mean(axis=1) - PLACED[:3, 3]
    assert ((normal * outwards).sum(axis=1) > 0.0).all()
    red = read(str(glb(tmp_path, box(baseColorFactor=[128, 255, 0, 255]))))[0]
    np.testing.assert_allclose(red.rgba, (188.0 / 255.0, 1.0, 0.0, 1.0), atol=2e-3)
    textured = read(str(glb(tmp_path, box(baseColorTexture=Image.fromarray(PIXELS)))))[0]
    kept = cv2.imread(textured.texture)[..., ::-1]
    np.testing.assert_array_equal(kept, PIXELS)
    at = textured.positions @ PLACED[:3, :3] - PLACED[:3, 3] @ PLACED[:3, :3]
    np.testing.assert_allclose(textured.uv, at[:, :2] + (0.4, 0.3), atol=1e-6)


def test_a_file_with_its_bytes_beside_it_is_read_and_no_other(tmp_path):
    files = scene(box(baseColorFactor=[255, 255, 255, 255])).export(file_type="gltf")
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
    (path,) = tmp_path.glob("*.gltf")
    first = read(str(path))[0]
    assert len(first.triangles) == 12
    tree = json.loads(path.read_text())
    away = tmp_path / "away"
    away.mkdir()
    for buffer in tree["buffers"]:
        (tmp_path / buffer["uri"]).rename(away / buffer["uri"])
    with pytest.raises(DescriptionError, match="No such file"):
        read(str(path))
    inside = away / "in"
    inside.mkdir()
    for buffer in tree["buffers"]:
        buffer["uri"] = f"../{buffer['uri']}"
    (inside / "part.gltf").write_text(json.dumps(tree))
    with pytest.raises(DescriptionError, match="is not in its folder"):
        read(str(inside / "part.gltf"))


def _many(tree):
    for accessor in tree["accessors"]:
        accessor["count"] = 4_000_000


@pytest.mark.parametrize(("change", "complaint"), [
    (lambda tree: tree.update(extensionsRequired=["KHR_draco_mesh_compression"]),
     "KHR_draco_mesh_compression, which is not supported"),
    (lambda tree: tree["asset"].update(version="1.0"), "the file is not glTF 2"),
    (lambda tree: tree.pop("asset"), "it has no asset"),
    (lambda tree: tree.update(scenes=[{"nodes": []}], nodes=[]), "no triangles|do not match"),
    (lambda tree: tree["meshes"][0]["primitives"][0].update(indices=99), "missing data"),
    (_many, "triangles, more than the limit"),
    (lambda tree: tree["bufferViews"][0].update(byteLength=3), "do not match|reach"),
])  # fmt: skip
def test_what_is_wrong_is_one_line_that_names_the_file(tmp_path, change, complaint):
    path = changed(glb(tmp_path, box()), change)
    with pytest.raises(DescriptionError, match=complaint) as told:
        read(str(path))
    assert "part.glb cannot be used" in str(told.value) and "\n" not in str(told.value)


@pytest.mark.parametrize("data", [b"", b"glTF", b"{}", b"glTF" + bytes(40), b"[" * 100_000])
def test_what_is_no_gltf_is_said(tmp_path, data):
    (tmp_path / "part.glb").write_bytes(data)
    with pytest.raises(DescriptionError, match="cannot be used: the file (does not start|is no)"):
        read(str(tmp_path / "part.glb"))
