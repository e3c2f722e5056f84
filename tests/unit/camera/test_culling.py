"""Culling: objects outside the image are left out, and no visible object is."""

import numpy as np
import pytest

from aras_sim_bridge.rendering.tiles import Tiles


@pytest.mark.parametrize("focal", [1e3, 1e5, 1e8])
def test_cones_are_known_however_narrow_they_are(focal):
    K = np.array([[focal, 0, 1e7], [0, focal / 2, -1e7], [0, 0, 1]])
    assert np.isfinite(Tiles.of_pinhole(320, 240, K).nodes).all()
