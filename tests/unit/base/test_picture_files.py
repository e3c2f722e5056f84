"""Image sizes read from file headers."""

import struct
import zlib

import cv2
import numpy as np
import pytest

from aras_visual_servo_base.errors import DescriptionError
from aras_visual_servo_base.image_files import LARGEST_IMAGE, read_image_size


def png_header(width, height):
    """The first bytes of a PNG: who decoded it would say that it cannot be read."""
    header = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + header
        + struct.pack(">I", zlib.crc32(header)) + struct.pack(">I", 9) + b"IDAT"
    )  # fmt: skip


def test_the_largest_is_read_and_one_row_more_is_refused(tmp_path):
    file = tmp_path / "a.png"
    file.write_bytes(png_header(LARGEST_IMAGE // 8, 8))
    assert read_image_size(file) == (LARGEST_IMAGE // 8, 8)
    for side in (LARGEST_IMAGE // 8 + 1, 9_000_000, 40_000_000):
        file.write_bytes(png_header(side, 8))
        with pytest.raises(DescriptionError, match="more than 64000000 pixels: make it smaller"):
            read_image_size(file)


def test_width_comes_before_height_and_what_is_no_picture_has_no_size(tmp_path):
    for kind in ("png", "jpg", "bmp"):
        cv2.imwrite(str(tmp_path / f"a.{kind}"), np.zeros((20, 30, 3), np.uint8))
        assert read_image_size(tmp_path / f"a.{kind}") == (30, 20)
    (tmp_path / "a.png").write_text("no picture")
    assert read_image_size(tmp_path / "a.png") is read_image_size(tmp_path / "none.png") is None
