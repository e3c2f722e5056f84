"""Files that users bring, damaged, are read or refused in one line (robots, worlds and meshes: in
unit/properties/test_texts.py; hand-eye files: in unit/base/test_hand_eye.py)."""

import random
import re

import cv2
import numpy as np
import pytest

from aras_sim_bridge.camera.camera_file import read_camera
from aras_sim_bridge.camera.config import CameraConfig
from aras_visual_servo_base.errors import SimError
from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.targets.svg_outlines import read_svg
from aras_visual_servo_bench.targets.target_factory import make_target

NUMBER = re.compile(rb"(?<![\w.])-?\d+\.?\d*(?:[eE][-+]?\d+)?(?![\w.])")
WORDS = (b"nan", b"inf", b"1e300", b"-1", b"0", b"abc", b"", b"[1, 2]")
K = np.array([[620.0, 0.0, 319.0], [0.0, 622.0, 241.0], [0.0, 0.0, 1.0]])
CALIBRATION = {"camera_matrix": K, "image_width": 640, "image_height": 480,
               "distortion_coefficients": np.array([[-0.21, 0.11, 0.001, -0.0008, 0.02]])}


def storage(suffix, **entries):
    store = cv2.FileStorage(f"made{suffix}", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    for name, value in entries.items():
        store.write(name, value)
    return store.releaseAndGetString()


def camera(path):
    made = CameraConfig.from_mapping({"name": "c", **read_camera(path)}).make_intrinsics()
    return [*np.ravel(made.K), *made.D, made.width, made.height]


SAMPLES = {
    "ros": (camera, ".yaml", "image_width: 640\nimage_height: 480\ncamera_name: eye\n"
            "camera_matrix:\n  rows: 3\n  cols: 3\n  data: [620, 0, 319, 0, 622, 241, 0, 0, 1]\n"
            "distortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n"
            "  data: [-0.21, 0.11, 0.001, -0.0008, 0.02]\n"),
    "opencv yaml": (camera, ".yaml", storage(".yaml", **CALIBRATION)),
    "opencv xml": (camera, ".xml", storage(".xml", **CALIBRATION)),
    "kalibr": (camera, ".yaml", "cam0:\n  camera_model: pinhole\n  intrinsics: [620, 622, 319, 241]"
               "\n  distortion_model: radtan\n  distortion_coeffs: [-0.21, 0.11, 0.001, -0.0008]\n"
               "  resolution: [640, 480]\n"),
    "svg": (lambda path: read_svg(path).corners, ".svg",
            '<svg xmlns="http://www.w3.org/2000/svg"\n width="60mm" height="100mm"\n'
            ' viewBox="0 0 60 100">\n<path d="M 0 0 L 60 0 L 60 20 L 20 20 L 20 100 L 0 100 Z"/>\n'
            "</svg>\n"),
    "tag": (lambda path: [make_target(str(path), (0.1, 0.1)).size], ".png", bytes(cv2.imencode(
        ".png", cv2.copyMakeBorder(
            np.kron(np.eye(6, dtype=np.uint8) * 255, np.ones((8, 8), np.uint8)), 8, 8, 8, 8,
            cv2.BORDER_CONSTANT, value=255))[1])),
}


def damaged(data):
    """Cut off, without lines or bytes, with lines swapped, and with other words for numbers."""
    chance, lines = random.Random(4), data.split(b"\n")
    for part in range(1, 10):
        yield data[: len(data) * part // 10]
    for k in range(0, len(lines), 1 + len(lines) // 12):
        yield b"\n".join([*lines[:k], *lines[k + 1 :]])
        other, swapped = chance.randrange(len(lines)), list(lines)
        swapped[k], swapped[other] = swapped[other], swapped[k]
        yield b"\n".join(swapped)
    for _ in range(10):
        k = chance.randrange(len(data))
        yield data[:k] + data[k + 7 :]
        yield data[:k] + b"\xff" + data[k + 1 :]
    numbers = list(NUMBER.finditer(data)) if b"\0" not in data else []
    for found in numbers[:: 1 + len(numbers) // 12]:
        for word in WORDS:
            yield data[: found.start()] + word + data[found.end() :]


@pytest.mark.parametrize("kind", SAMPLES)
def test_a_damaged_file_is_read_or_refused_in_one_line(tmp_path, kind):
    read, suffix, sample = SAMPLES[kind]
    data = sample if isinstance(sample, bytes) else sample.encode()
    whole = tmp_path / f"whole{suffix}"
    whole.write_bytes(data)
    read(whole)
    refused = 0
    for count, content in enumerate(damaged(data)):
        path = tmp_path / f"x{count}{suffix}"  # what was read from a path is cached
        path.write_bytes(content)
        try:
            assert all(np.isfinite(one).all() for one in read(path)), content
        except (SimError, ExperimentError) as error:
            refused += 1
            assert "\n" not in str(error), content
    assert refused > 10
