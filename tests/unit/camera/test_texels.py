"""Preparation of textures: reduced sizes, and sample positions in a pixel."""

import cv2
import numpy as np

from aras_sim_bridge.rendering.textures import Textures


def test_textures_lie_one_after_the_other_with_all_their_halves(tmp_path):
    rng, files = np.random.default_rng(2), {}
    for name, shape, size in (("a", (30, 41), 512), ("b", (20, 700), 512), ("d", (1500, 20), 1024)):
        file = str(tmp_path / f"{name}.png")
        cv2.imwrite(file, rng.integers(0, 256, (*shape, 3)).astype(np.uint8))
        files[file] = (cv2.resize(cv2.imread(file), (size, size), interpolation=cv2.INTER_AREA))
    files[str(tmp_path / "missing.png")] = np.full((512, 512, 3), 255, np.uint8)
    made, end = Textures(set(files)), 0
    for file, bgr in files.items():
        at = made.find_layer(file)
        assert at == end and made.texels[at] == len(bgr)
        half, at = bgr[::-1, :, ::-1].astype(float), at + 1
        while True:
            one = made.texels[at:at + half.shape[0]**2].reshape(half.shape[:2])
            for k in range(3):
                assert (one >> np.uint64(21 * k) & np.uint64(2**21 - 1) == half[..., k]).all()
            at += half.shape[0]**2
            if len(half) == 1:
                break
            # The mean of two by two, to the nearest even number.
            half = np.rint((half[::2, ::2] + half[1::2, ::2] + half[::2, 1::2]
                            + half[1::2, 1::2]) / 4)
        end = at
    assert len(made.texels) == end


