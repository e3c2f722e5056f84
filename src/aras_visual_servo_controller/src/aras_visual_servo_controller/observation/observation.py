"""Observation: one immutable record of all that is known of one image, made by `observe`.

Features read observations and store nothing themselves. The camera's optical frame has z forward, x
right, y down; `a_T_b` (4, 4) maps b to a.
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

CAMERA = "camera"  # default name of the only camera of an experiment or a node


class Need(Enum):
    """Quantity that a scheme needs from an image; other quantities are not measured."""

    MOMENTS = "moments"
    CONTOUR = "contour"
    CORNERS = "corners"
    IMAGE = "image"
    DEPTH = "depth"
    KERNEL = "kernel"


# Quantities measured on the segmented target; without a target the observation is not valid.
SEGMENTED = frozenset((Need.MOMENTS, Need.CONTOUR, Need.CORNERS, Need.KERNEL))


@dataclass(frozen=True, eq=False)
class Observation:
    """Everything that is known of one image; quantities that no scheme needs are None.

    An observation is made by `observe` from a frame. It contains what the scheme declares in
    `needs`; features and schemes read nothing else. Arrays are read-only.

    Lengths are in m, angles in rad, times in s; image coordinates are normalised, x = X/Z to the
    right and y = Y/Z downwards. `a_T_b` (4, 4) maps b to a.

    Attributes:
        stamp: time of the exposure, s of simulated time.
        dt: time since the previous observation, s; 0.0 for the first.
        valid, reason: whether the segmentation found the target, and why not. A scheme with its own
            image processing decides for itself.
        camera: K, D and lens; `normalise` and `project` convert between pixels and rays.
        joints: at the exposure, interpolated by stamp.
        world_T_camera: (4, 4) at the exposure, by kinematics ("world" is the arm's base).
        moments: image moments of the segmented target, in normalised coordinates.
        contour: (n, 2) outline of the target, normalised, with subpixel accuracy.
        corners: (n, 2) corners of the outline, in its order, normalised.
        corner_accuracy: rms error of the corners without noise, normalised; 0: exact.
        corner_spread: (2n, m) effects on x_0, y_0, x_1, ... of independent errors, one standard
            deviation each, estimated from the scatter of edge points about their fitted lines. The
            errors decrease towards a goal taught with the same camera. None: unknown.
        corner_repeatability: the part of this error that differs between a goal and an image of the
            same camera, normalised.
        corner_noise: standard deviation of noise in corners and contour, normalised, if their
            source declares it.
        is_numbered: whether each corner is identified individually, as those of a marker are; None:
            the corners are exact, and a scheme uses them as it needs.
        marker: `DICTIONARY:number` of the marker that has these corners; empty if there is none.
        pixel_count: number of pixels of the target; 0 if unknown.
        touched_borders: borders of the image that the target touches: left, right, top, bottom.
        image: (rows, columns) or (rows, columns, 3) RGB, uint8.
        depth: (rows, columns) float32, m along the optical axis.
        plane: of the target, from the depth image if it is needed, otherwise from goal and
            kinematics; None if both are unknown.
        is_plane_measured: whether the plane comes from the depth image. A plane from goal and
            kinematics is wrong if the camera model is wrong or the target was moved.
        kernel: (20,) camera/data of the original package for this image.
        previous_T_camera: (4, 4) motion since the previous observation, from the joints; None for
            the first, and if the joints at one of the two are extrapolated too far.
        commands: joint commands sent since the exposure.
        name: of the camera.
        other_cameras: observations of the other cameras of a scheme of several, by name.
        twist_from_control: (6, 6) matrix of a camera other than the control camera, which is the
            first of the scheme. The camera's twist relative to its target is this matrix times the
            twist of the control camera, each in its own frame. It is zero if the arm moves neither
            the camera nor its target; None: this is the control camera.
        motion_since_exposure: (6,) motion of such a camera from its own exposure to that of the
            control camera, in its own frame, as the twist that causes it in one second; None if it
            is unknown, or for the control camera.
        has_other_target: whether the arm carries only one of the targets of this camera and of the
            control camera; world_T_camera and plane then refer to the target of this camera.
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
        """Return the observation of each camera by name; the first is this one.

        Their stamps are equal if the images were exposed together.
        """
        return {self.name: self, **self.other_cameras}

    @property
    def is_from_image(self) -> bool:
        """Return whether the observation comes from an image and not from exact geometry."""
        return self.image is not None or self.depth is not None or self.pixel_count > 0

    def without_pixels(self) -> Observation:
        """Return the observation without images and depth images, as a run record stores it."""
        others = {name: view.without_pixels() for name, view in self.other_cameras.items()}
        if self.image is None and self.depth is None and not others:
            return self
        return replace(self, image=None, depth=None, other_cameras=others)

    def with_noise(self) -> Observation:
        """Return the observation with the declared noise included in the corners' accuracy."""
        if not self.corner_noise:
            return self
        return replace(
            self, corner_accuracy=float(np.hypot(self.corner_accuracy, self.corner_noise)),
            corner_repeatability=max(self.corner_repeatability, self.corner_noise),
            other_cameras={name: view.with_noise() for name, view in self.other_cameras.items()},
        )  # fmt: skip

    def transform_to_control(self, L: np.ndarray) -> np.ndarray:
        """Transform L (k, 6) of features of this camera to the twist of the control camera."""
        return L if self.twist_from_control is None else L @ self.twist_from_control

    def compute_change_since_exposure(self, L: np.ndarray) -> np.ndarray | float:
        """Return the change of features between this exposure and the control camera's.

        It is a first-order approximation by L (k, 6), and 0 if both images were exposed together.
        """
        return 0.0 if self.motion_since_exposure is None else L @ self.motion_since_exposure

    @cached_property
    def motion(self) -> np.ndarray | None:
        """The motion previous_T_camera as the twist (6,) that causes it in one second."""
        return None if self.previous_T_camera is None else logarithm(self.previous_T_camera)
