"""What is known of one image: one immutable record, made by `observe`.

A feature reads it and stores nothing itself. Frames: the camera's optical frame has z forward,
x right, y down; `a_T_b` (4, 4) maps b to a.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property

import numpy as np

from aras_visual_servo_base.poses import logarithm
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.moments import Moments
from aras_visual_servo_camera.undistortion import CameraModel

from ..kinematics.joint_sample import JointSample

CAMERA = "camera"  # name of the one camera of an experiment or a node that names none


class Need(Enum):
    """What a feature or a scheme needs of an image; nothing else is measured for it."""

    MOMENTS = "moments"
    CONTOUR = "contour"
    CORNERS = "corners"
    IMAGE = "image"
    DEPTH = "depth"
    KERNEL = "kernel"


# Needs that the segmented target answers: without it such an observation is not valid.
SEGMENTED = frozenset((Need.MOMENTS, Need.CONTOUR, Need.CORNERS, Need.KERNEL))


@dataclass(frozen=True, eq=False)
class Observation:
    """Everything that is known of one image; what no scheme needs is None, arrays are read-only.

    Made by `observe` from a frame. It has what the scheme declares in `needs`; features and schemes
    read nothing else.

    Lengths are in m, angles in rad, times in s; image coordinates are normalised, x = X/Z to the
    right and y = Y/Z downwards. `a_T_b` (4, 4) maps b to a.

    Attributes:
        stamp: time of the exposure, s of simulated time.
        dt: time since the previous observation, s; 0.0 for the first.
        valid, reason: whether the segmentation found the target, and why not. A scheme with its
            own image processing decides for itself.
        camera: K, D and lens; `normalise` and `project` convert between pixels and rays.
        joints: at the exposure, interpolated by stamp.
        world_T_camera: (4, 4) at the exposure, by kinematics ("world" is the arm's base).
        moments: image moments of the segmented target, in normalised coordinates.
        contour: (n, 2) outline of the target, normalised, to a part of a pixel.
        corners: (n, 2) corners of that outline, in its order, normalised.
        corner_accuracy: error of the corners without noise, rms, normalised; 0: exact.
        corner_spread: (2n, m) effects on x_0, y_0, x_1, ... of independent errors, one standard
            deviation each, by how edges scatter about the lines that meet in the corners. They
            shrink with the distance from a goal shown by the same camera. None: not known.
        corner_unshared: the part of it that a goal shown by the same camera does not share.
        corner_noise: standard deviation of noise in corners and contour, normalised, where their
            source declares it.
        numbered: whether each corner is identified by itself, as a marker's is; None: the corners
            are exact, and a scheme uses them as it needs.
        marker: `DICTIONARY:number` of the marker whose corners they are; empty if there is none.
        pixel_count: number of pixels of the target; 0 where not known.
        touches: borders of the image that the target touches: left, right, top, bottom.
        image: (rows, columns) or (rows, columns, 3) RGB, uint8.
        depth: (rows, columns) float32, m along the optical axis.
        plane: of the target, from the depth image if it is needed, otherwise from goal and
            kinematics; None where neither is known.
        plane_measured: whether the plane comes from the depth image. That from goal and kinematics
            is wrong if the camera is not as assumed, or the target is elsewhere.
        kernel: (20,) numbers of the original's camera/data of this image.
        previous_T_camera: (4, 4) motion since the previous observation, from the joints; None at
            the first, and where the joints at one of the two are guessed.
        commands: joint commands sent since the exposure.
        name: of the camera.
        others: observations of the other cameras of a scheme of several, by name.
        of_control: (6, 6) of a camera other than the control camera, which is the first of the
            scheme: its twist, relative to its target, is of_control @ that of the control camera,
            each in its own frame. Zero where the arm moves neither; None: it is the control camera.
        moved: (6,) motion of such a camera from its own exposure to that of the control camera, in
            its own frame, as the twist that makes it in one second; None where that is not known,
            or for the control camera.
        apart: whether the arm carries the target of such a camera but not that of the control
            camera, or the reverse: world_T_camera and plane are then those of another target.
    """

    stamp: float
    dt: float
    valid: bool
    reason: str
    camera: CameraModel
    joints: JointSample | None = None
    world_T_camera: np.ndarray | None = None
    moments: Moments | None = None
    contour: np.ndarray | None = None
    corners: np.ndarray | None = None
    corner_accuracy: float = 0.0
    corner_spread: np.ndarray | None = None
    corner_repeatability: float = 0.0
    corner_noise: float = 0.0
    is_numbered: bool | None = None
    marker: str = ""
    pixel_count: int = 0
    touched_borders: tuple[str, ...] = ()
    image: np.ndarray | None = None
    depth: np.ndarray | None = None
    plane: Plane | None = None
    is_plane_measured: bool = False
    kernel: np.ndarray | None = None
    previous_T_camera: np.ndarray | None = None
    commands: tuple[JointSample, ...] = ()
    name: str = CAMERA
    other_cameras: Mapping[str, Observation] = field(default_factory=dict)
    twist_from_control: np.ndarray | None = None
    motion_since_exposure: np.ndarray | None = None
    has_other_target: bool = False

    @property
    def cameras(self) -> dict[str, Observation]:
        """What each camera of the scheme saw, by name; the first, this one, is the control camera.

        Their stamps are the same where they were exposed together.
        """
        return {self.name: self, **self.other_cameras}

    @property
    def is_from_image(self) -> bool:
        """Whether what is seen comes from a picture, and not from exact geometry."""
        return self.image is not None or self.depth is not None or self.pixel_count > 0

    def without_pixels(self) -> Observation:
        """The same without images and depth images, as a record of a run keeps it."""
        others = {name: view.without_pixels() for name, view in self.other_cameras.items()}
        if self.image is None and self.depth is None and not others:
            return self
        return replace(self, image=None, depth=None, other_cameras=others)

    def with_noise(self) -> Observation:
        """The same with noise as a part of the accuracy that the corners have in each image."""
        if not self.corner_noise:
            return self
        return replace(
            self, corner_accuracy=float(np.hypot(self.corner_accuracy, self.corner_noise)),
            corner_repeatability=max(self.corner_repeatability, self.corner_noise),
            other_cameras={name: view.with_noise() for name, view in self.other_cameras.items()},
        )  # fmt: skip

    def transform_to_control(self, L: np.ndarray) -> np.ndarray:
        """L (k, 6) of features of this camera, for the twist of the control camera."""
        return L if self.twist_from_control is None else L @ self.twist_from_control

    def compute_change_since_exposure(self, L: np.ndarray) -> np.ndarray | float:
        """What features of this camera with L (k, 6) have changed by since its exposure up to the
        control camera's, to first order; 0 where the two were exposed together."""
        return 0.0 if self.motion_since_exposure is None else L @ self.motion_since_exposure

    @cached_property
    def motion(self) -> np.ndarray | None:
        """(6,) previous_T_camera as the twist that makes it in one second."""
        return None if self.previous_T_camera is None else logarithm(self.previous_T_camera)
