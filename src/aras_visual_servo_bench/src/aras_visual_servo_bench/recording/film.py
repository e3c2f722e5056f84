"""Images of a run, and its film: up to 600 JPEG images with a total size of at most 8 MB."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import cv2
import numpy as np

from aras_visual_servo_camera.camera_model import CameraModel, normalise_pixels
from aras_visual_servo_controller.observation.frame import Frame
from aras_visual_servo_controller.observation.observation import CAMERA

from ..experiment import cameras
from .camera_record import Film
from .run import Run

MAX_FRAMES = 600
# maximum size of all frames of a film, bytes; base64 makes them a third larger on a report page
MAX_BYTES = 8_000_000
# Pairs of the longest side of a frame (px) and its JPEG quality, largest first. When a frame would
# make the film too large, the next pair is used for this and all later frames.
SIZES_AND_QUALITIES = ((640, 85), (480, 75), (400, 65), (320, 50), (240, 40), (160, 30))
SMALL_SIZE_AND_QUALITY = (320, 65)


def select_frames(
    stamps: np.ndarray, start_stamp: float, max_frames: int = MAX_FRAMES
) -> np.ndarray:
    """Select the images of a film, evenly spaced from `start_stamp` to the last image.

    Args:
        stamps: stamps (n,) of all images, s.
        start_stamp: stamp of the first image of the film, s.
        max_frames: maximum number of images of the film.

    Returns:
        Stamps of the selected images, s.
    """
    after = stamps[stamps >= start_stamp - 1e-6]
    if not len(after):
        return after
    indices = np.linspace(0, len(after) - 1, min(max_frames, len(after)))
    return after[np.unique(np.rint(indices).astype(int))]


def encode_film(images: Iterable[tuple[float, np.ndarray]], count: int) -> Film:
    """Encode images as JPEG for a film of at most MAX_BYTES.

    Size and quality are reduced, as listed in SIZES_AND_QUALITIES, when an image would make the
    film too large.

    Args:
        images: stamp (s) and rgb image of each frame.
        count: number of images.
    """
    remaining, level, frames = MAX_BYTES, 0, []
    for number, (stamp, image) in enumerate(images):
        # Largest size of this image, bytes, if all remaining images of the film have the same size.
        share = remaining / max(count - number, 1)
        while (
            len(frame := _encode_jpeg(image, *SIZES_AND_QUALITIES[level])) > share
            and level < len(SIZES_AND_QUALITIES) - 1
        ):
            # this image and all later ones are encoded with the next smaller size and quality
            level += 1
        remaining -= len(frame)
        frames.append((stamp, frame))
    return tuple(frames)


def encode_frame(image: np.ndarray) -> bytes:
    """Encode one image (rows, columns, 3), rgb, as JPEG."""
    return _encode_jpeg(image, *SIZES_AND_QUALITIES[0])


def encode_small_frame(image: np.ndarray) -> bytes:
    """Encode one image (rows, columns, 3), rgb, as a JPEG of at most 320 pixels and about 10 kB."""
    return _encode_jpeg(image, *SMALL_SIZE_AND_QUALITY)


def decode_frame(frame: bytes) -> np.ndarray:
    """Decode a JPEG to an image (rows, columns, 3), rgb."""
    return cv2.imdecode(np.frombuffer(frame, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]


def _encode_jpeg(image: np.ndarray, max_side: int, quality: int) -> bytes:
    factor = max_side / max(image.shape[:2])
    if factor < 1.0:
        image = cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    encoded = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return encoded.tobytes()


def make_image(reading: Frame, model: CameraModel) -> np.ndarray:
    """Return the rgb image (rows, columns, 3) of a frame; if it has exact features, draw them."""
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
    """Return a copy of the run with these images and this film of the control camera.

    Args:
        run: record of a run.
        images: stamp (s) and rgb image (rows, columns, 3) of each image.
        film: stamp (s) and JPEG of each frame."""
    record = replace(run.control_record, images=tuple(images), film=film)
    name = next(iter(run.cameras), CAMERA)
    return replace(run, cameras={**run.cameras, name: record})
