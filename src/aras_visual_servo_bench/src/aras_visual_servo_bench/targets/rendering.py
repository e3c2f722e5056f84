"""Render images of a target on a white background, with the renderer of the arm's cameras."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np

from aras_sim_bridge.description import RobotDescription, parse_urdf
from aras_sim_bridge.rendering import Lighting, View, create_renderer
from aras_sim_bridge.rendering.renderer import Renderer
from aras_sim_bridge.rendering.tiles import Tiles, get_shared_tiles
from aras_visual_servo_base.poses import IDENTITY, Pose
from aras_visual_servo_camera.camera_model import CameraModel

from .geometry import MIN_DEPTH, Target
from .target_files import write_target
from .target_spec import Vector2
from .temporary_folders import make_scratch_folder

MAX_DEPTH = 1e3  # m
# Light without direction, so that the colours of a flat target are those of its texture.
FLAT_LIGHT = Lighting(ambient=1.0, diffuse=0.0, background=(1.0, 1.0, 1.0, 1.0))
# Light with a direction, so that differences in brightness make the faces of a solid visible.
SHADED_LIGHT = Lighting(background=(1.0, 1.0, 1.0, 1.0))
CACHED_TARGETS = 2  # number of cached renderers; the texture of one target can need 11 MB
CANVAS_BYTES = 1 << 22  # size of the cached camera buffers of a renderer, bytes


class _StaticWorld:
    """World with one model at the origin, with the methods that a renderer calls."""

    revision, name, body_id = 0, "target", 0

    def __init__(self, description: RobotDescription) -> None:
        self.description = description
        self.models = {self.name: self}

    def link_index(self, _: str) -> int:
        """Return the index of the root link, which is the only link."""
        return -1

    def pose(self) -> Pose:
        """Return the pose of the model, which defines the frame of the world."""
        return IDENTITY

    def get_scoped_name(self, link: str) -> str:
        """Return the name 'model::link'."""
        return f"{self.name}::{link}"


def render_target(
    target: Target, camera: CameraModel, target_T_camera: np.ndarray,
    occluder: tuple[Vector2, Vector2] | None = None,
) -> np.ndarray:
    """Render the grey image (rows, columns), uint8, of a target.

    Args:
        target: geometry of the target.
        camera: intrinsics of the camera.
        target_T_camera: pose (4, 4) of the camera in the target frame.
        occluder: lower and upper corner (x, y), m, of a white rectangle on a flat target.
    """
    return _make_renderer(target, occluder).render(_make_view(camera, target_T_camera))[..., 0]


def render_mask(target: Target, camera: CameraModel, target_T_camera: np.ndarray) -> np.ndarray:
    """Render the mask (rows, columns), uint8, of a target; pixels of the target are 255."""
    label = _make_renderer(target, None).measure(_make_view(camera, target_T_camera))[1]
    return (label >= 0).view(np.uint8) * 255


def _make_view(camera: CameraModel, target_T_camera: np.ndarray) -> View:
    size, K = (camera.width, camera.height), np.reshape(camera.K, (3, 3))
    lens = None
    if camera.is_distorted:
        lens = get_shared_tiles(
            *size,
            camera,
            lambda: Tiles.of_lens(*size, lambda pixels: _compute_rays(camera, pixels)),
        )
    return View(*size, target_T_camera, K, MIN_DEPTH, MAX_DEPTH, lens)


def _compute_rays(camera: CameraModel, pixels: np.ndarray) -> np.ndarray:
    """Compute the directions (n, 3) of the rays of pixels (n, 2); NaN for pixels without a ray."""
    x, y, valid = camera.normalise(*pixels.T)
    rays = np.stack([x, y, np.ones_like(x)], axis=1)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    rays[~valid] = np.nan
    return rays


@lru_cache(maxsize=CACHED_TARGETS)
def _make_renderer(target: Target, occluder: tuple[Vector2, Vector2] | None) -> Renderer:
    urdf: Path = write_target(target, make_scratch_folder(), occluder=occluder)
    light = SHADED_LIGHT if target.is_solid else FLAT_LIGHT
    return create_renderer("exact", _StaticWorld(parse_urdf(urdf.read_text())), light, CANVAS_BYTES)
