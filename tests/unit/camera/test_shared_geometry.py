"""A scene that comes again is not prepared again, and one that differs in anything is."""

import os
from dataclasses import replace

import cv2
import numpy as np
import pytest

from aras_sim_bridge.description.mesh import from_corners
from aras_sim_bridge.rendering.geometry import Geometry
from aras_sim_bridge.rendering.scene import Part

CORNERS = np.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 0, 1], [1, 0, 1], [0, 1, 1]]])


def part(**changes):
    mesh = from_corners(CORNERS)
    return Part(0, replace(mesh, **changes), (1.0, 0.0, 0.0, 1.0))


def test_the_same_parts_are_prepared_once():
    assert Geometry.of([part()]) is Geometry.of([part()])


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
    assert Geometry.of(other()) is not Geometry.of([part()])


def test_a_texture_that_was_painted_over_is_read_again(tmp_path):
    file = tmp_path / "texture.png"
    cv2.imwrite(str(file), np.zeros((4, 4, 3), np.uint8))
    textured = [part(texture=str(file), uv=np.zeros((6, 2), np.float32))]
    assert Geometry.of(textured).textures.texels.max() == 0
    cv2.imwrite(str(file), np.full((4, 4, 3), 200, np.uint8))
    os.utime(file, ns=(1, 1))
    assert Geometry.of(textured).textures.texels.min() == 200
