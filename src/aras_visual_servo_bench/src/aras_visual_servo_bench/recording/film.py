"""Pictures of a run, and a film of it for a page: a few hundred as JPEG, in so many bytes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import cv2
import numpy as np

from aras_visual_servo_camera.undistortion import CameraModel, normalise_pixels
from aras_visual_servo_controller.observation.frame import Frame
from aras_visual_servo_controller.observation.observation import CAMERA

from ..experiment import cameras
from .run import Film, Run

MAX_FRAMES = 600  # at most; a minute at 10 Hz
MAX_BYTES = 8_000_000  # of all frames; on a page they take a third more
# Longest side, pixels, and quality: the first with which a film is small enough.
SIZES_AND_QUALITIES = ((640, 85), (480, 75), (400, 65), (320, 50), (240, 40), (160, 30))


def select_frames(
    stamps: np.ndarray, start_stamp: float, max_frames: int = MAX_FRAMES
) -> np.ndarray:
    """Of the stamps (n,) of images those of a film: from `start_stamp` on, evenly, first and last.
    """
    shown = stamps[stamps >= start_stamp - 1e-6]
    if not len(shown):
        return shown
    at = np.linspace(0, len(shown) - 1, min(max_frames, len(shown)))
    return shown[np.unique(np.rint(at).astype(int))]


def encode_film(images: Iterable[tuple[float, np.ndarray]], count: int) -> Film:
    """JPEGs of `count` pictures (stamp, rgb), as large and as good as BYTES allow."""
    left, level, frames = MAX_BYTES, 0, []
    for number, (stamp, picture) in enumerate(images):
        room = left / max(count - number, 1)  # what is left for this one
        while (
            len(frame := _encode_jpeg(picture, *SIZES_AND_QUALITIES[level])) > room
            and level < len(SIZES_AND_QUALITIES) - 1
        ):
            level += 1  # and for all that follow
        left -= len(frame)
        frames.append((stamp, frame))
    return tuple(frames)


def encode_frame(image: np.ndarray) -> bytes:
    """JPEG of one picture (rows, columns, 3) rgb."""
    return _encode_jpeg(image, *SIZES_AND_QUALITIES[0])


def shot(reading: Frame, model: CameraModel) -> bytes:
    """JPEG of what a camera saw."""
    return encode_frame(make_image(reading, model))


def _encode_jpeg(image: np.ndarray, max_side: int, quality: int) -> bytes:
    factor = max_side / max(image.shape[:2])
    if factor < 1.0:
        image = cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    encoded = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return encoded.tobytes()


def make_image(reading: Frame, model: CameraModel) -> np.ndarray:
    """What a camera saw, (rows, columns, 3) rgb; drawn where it sees exactly."""
    image = reading.image
    if image is None:
        outline = reading.outline
        if outline is not None:
            outline = normalise_pixels(outline, model, model)
        image = cameras.draw_outline(outline, model)
    if image.ndim == 2 or image.shape[2] == 1:
        return cv2.cvtColor(image, cv2.COLOR_GRAY2RGB)
    return image[..., ::-1].copy() if reading.encoding.startswith("bgr") else image


def with_images(
    run: Run, images: Sequence[tuple[float, np.ndarray]], film: Film = ()
) -> Run:
    """The run with pictures (stamp, rgb) of the control camera, and a film of it."""
    seen = replace(run.control_record, images=tuple(images), film=film)
    name = next(iter(run.cameras), CAMERA)
    return replace(run, cameras={**run.cameras, name: seen})
